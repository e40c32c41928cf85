"""Train the fruit model (recon/learned/fruit_model.py) and write it as ONNX.

    python -m venv ENV && ENV/bin/pip install torch onnx numpy opencv-python-headless trimesh typer
    ENV/bin/python benchmarks/fruit_model_train.py OUT.onnx --close-ups FOLDER [--bank BANK]
        [--epochs 24] [--minutes 60] [--seed 1] [--threads 1]

Close-ups come from benchmarks/fruit_model_photos.py, more from the work half of benchmarks/photo_bank.py.
Every eighth close-up scene, and the sets of the bank whose number leaves 6 when divided by 8, are kept back:
the table tells cross entropy (nats a pixel) and overlap (intersection over union) on them. Training stops
after the epochs or the minutes; its rate falls with whichever is nearer its end. PyTorch is needed here
alone; nothing of it is in the product.
"""

import json
import time
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import torch
import trimesh
import typer
from script import run
from torch import nn
from torch.nn import functional

SIDE_PX, OUT_PX = 192, 96
WIDTHS = (24, 48, 80, 112)
BATCH = 32


class ConvBlock(nn.Module):
    """Two 3 x 3 convolutions with a way round them."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.body = nn.Sequential(convolved(width, width), convolved(width, width, active=False))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Same shape."""
        return functional.relu(x + self.body(x))


def convolved(inside: int, out: int, *, stride: int = 1, active: bool = True) -> nn.Sequential:
    """Convolution, batch norm, and ReLU unless not `active`."""
    layers: list[nn.Module] = [
        nn.Conv2d(inside, out, 3, stride=stride, padding=1, bias=False),
        nn.BatchNorm2d(out),
    ]
    return nn.Sequential(*layers, *([nn.ReLU()] if active else []))


class UNet(nn.Module):
    """A U-Net: (n, 3, 192, 192) RGB in [0, 1] to the log odds (n, 1, 96, 96) of fruit."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = WIDTHS
        self.stem = convolved(3, a, stride=2)
        self.block_one = ConvBlock(a)
        self.down_two = convolved(a, b, stride=2)
        self.block_two = ConvBlock(b)
        self.down_three = convolved(b, c, stride=2)
        self.block_three = nn.Sequential(ConvBlock(c), ConvBlock(c))
        self.down_four = convolved(c, d, stride=2)
        self.block_four = nn.Sequential(ConvBlock(d), ConvBlock(d))
        self.up_three = convolved(c + d, c)
        self.up_two = convolved(b + c, b)
        self.up_one = convolved(a + b, a)
        self.last = nn.Conv2d(a, 1, 1)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Log odds."""
        x1 = self.block_one(self.stem(2 * images - 1))
        x2 = self.block_two(self.down_two(x1))
        x3 = self.block_three(self.down_three(x2))
        x4 = self.block_four(self.down_four(x3))
        y = self.up_three(torch.cat([x3, enlarged(x4)], 1))
        y = self.up_two(torch.cat([x2, enlarged(y)], 1))
        y = self.up_one(torch.cat([x1, enlarged(y)], 1))
        made: torch.Tensor = self.last(y)
        return made


def enlarged(x: torch.Tensor) -> torch.Tensor:
    """Twice the height and width."""
    return functional.interpolate(x, scale_factor=2.0, mode="nearest")


def pictures(folder: Path) -> tuple[list[np.ndarray], list[np.ndarray], list[bool]]:
    """Images, cover, and which are kept back."""
    images, cover, kept = [], [], []
    for path in sorted(folder.glob("[0-9]*.npz")):
        if path.name.endswith(".part.npz"):
            continue
        with np.load(path) as made:
            images += list(made["images"])
            cover += list(made["cover"])
            kept += [int(path.stem) % 8 == 0] * len(made["images"])
    return images, cover, kept


def bank_crops(bank: Path, rng: np.random.Generator) -> tuple[list[np.ndarray], list[np.ndarray], list[bool]]:
    """The same from every photo of the bank's work half: a square round the fruit."""
    images, cover, kept = [], [], []
    for folder in sorted(bank.glob("*-*")):
        scene = json.loads((folder / "scene.json").read_text())
        if scene["half"] != "work":
            continue
        truth = json.loads((folder / "cameras_truth.json").read_text())
        truth_mesh = trimesh.load_mesh(folder / "fruit_truth.ply", process=False)
        vertices, faces = np.asarray(truth_mesh.vertices), np.asarray(truth_mesh.faces)
        for view in truth["views"]:
            photo = cv2.imread(str(folder / "photos" / view["name"]), cv2.IMREAD_COLOR)
            local = vertices @ np.array(view["R"]).T + np.array(view["t"])
            xy = local[:, :2] / local[:, 2:]
            xy = xy * (1 + truth["k1"] * np.sum(xy**2, axis=1, keepdims=True))
            pixels = xy * view["f"] + np.array([truth["width"] - 1, truth["height"] - 1]) / 2
            low, high = pixels.min(0), pixels.max(0)
            extent = float((high - low).max())
            wide = extent * 1.15 * (3.2 / 1.15) ** rng.uniform()
            corner = (low + high) / 2 + 0.55 * (wide - extent) * rng.uniform(-1, 1, 2) - wide / 2
            images.append(cropped(photo, corner, wide))
            picture = np.zeros((3 * SIDE_PX, 3 * SIDE_PX), np.uint8)
            corners = np.rint((pixels - corner) * (3 * SIDE_PX / wide) * 16).astype(np.int32)
            for triangle in corners[faces]:
                cv2.fillConvexPoly(picture, triangle, 255, shift=4)
            cover.append(cv2.resize(picture, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA))
            kept.append(scene["index"] % 8 == 6)
    return images, cover, kept


def cropped(photo: np.ndarray, corner: np.ndarray, wide: float) -> np.ndarray:
    """A square of the photo, averaged down; beyond the photo its edge goes on."""
    x0, y0 = np.floor(corner).astype(int)
    side = round(wide)
    reach = max(0, -x0, -y0, x0 + side - photo.shape[1], y0 + side - photo.shape[0])
    padded = cv2.copyMakeBorder(photo, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
    part = padded[y0 + reach : y0 + reach + side, x0 + reach : x0 + reach + side]
    how = cv2.INTER_AREA if side > SIDE_PX else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(part, (SIDE_PX, SIDE_PX), interpolation=how))


def altered(images: torch.Tensor, cover: torch.Tensor, rng: np.random.Generator) -> list[torch.Tensor]:
    """Mirrored, turned, other colours of fruit and ground, other light, shadows, blur, noise."""
    n = len(images)
    if rng.uniform() < 0.5:
        images, cover = images.flip(3), cover.flip(3)
    turn = int(rng.choice([0, 0, 1, 2, 3]))
    images, cover = torch.rot90(images, turn, (2, 3)), torch.rot90(cover, turn, (2, 3))
    light = images.clamp(1e-4, 1) ** 2.2
    for part in (cover, 1 - cover):
        mixed = torch.eye(3) + torch.tensor(rng.normal(0, 0.10, (n, 3, 3)), dtype=torch.float32)
        order = torch.stack([torch.tensor(rng.permutation(3)) for _ in range(n)])
        some = torch.tensor(rng.uniform(size=n) < 0.35)[:, None, None, None]
        swapped = torch.gather(light, 1, order[:, :, None, None].expand_as(light))
        other = torch.einsum("nij,njhw->nihw", mixed, torch.where(some, swapped, light)).clamp(1e-4)
        grey = other.mean(1, keepdim=True)
        pale = torch.tensor(rng.beta(1, 4, (n, 1, 1, 1)), dtype=torch.float32)
        other = (1 - pale) * other + pale * grey
        other = other * torch.tensor(np.exp(rng.normal(0, 0.25, (n, 1, 1, 1))), dtype=torch.float32)
        light = part * other + (1 - part) * light
    light = light * shadows(n, rng)
    light = light * torch.tensor(np.exp(rng.normal(0, 0.3, (n, 1, 1, 1))), dtype=torch.float32)
    light = light * torch.tensor(np.exp(rng.normal(0, 0.08, (n, 3, 1, 1))), dtype=torch.float32)
    gamma = torch.tensor(np.exp(rng.normal(0, 0.2, (n, 1, 1, 1))), dtype=torch.float32) / 2.2
    images = light.clamp(1e-4, 1) ** gamma
    if rng.uniform() < 0.3:
        images = functional.avg_pool2d(images, 3, stride=1, padding=1, count_include_pad=False)
    images = images + float(rng.uniform(0, 0.03)) * torch.randn_like(images)
    return [images.clamp(0, 1), cover]


def shadows(n: int, rng: np.random.Generator) -> torch.Tensor:
    """A soft or hard half-plane of shadow on two of five pictures: factors (n, 1, 192, 192)."""
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX] / SIDE_PX - 0.5
    out = np.ones((n, 1, SIDE_PX, SIDE_PX), np.float32)
    for k in np.flatnonzero(rng.uniform(size=n) < 0.4):
        turn, where, soft = rng.uniform(0, 2 * np.pi), rng.uniform(-0.5, 0.5), rng.uniform(0.004, 0.1)
        bend = rng.uniform(-1.5, 1.5) * (np.sin(turn) * x - np.cos(turn) * y) ** 2
        side = np.clip((np.cos(turn) * x + np.sin(turn) * y + bend - where) / soft, -20, 20)
        out[k, 0] = 1 - (1 - rng.uniform(0.25, 0.85)) / (1 + np.exp(-side))
    return torch.from_numpy(out)


def loss_of(log_odds: torch.Tensor, cover: torch.Tensor) -> torch.Tensor:
    """Cross entropy at the model's resolution."""
    return functional.binary_cross_entropy_with_logits(log_odds.float(), functional.avg_pool2d(cover, 2))


def tensors(images: list[np.ndarray], cover: list[np.ndarray]) -> tuple[torch.Tensor, torch.Tensor]:
    """RGB and cover in [0, 1]."""
    rgb = np.ascontiguousarray(np.stack(images)[..., ::-1].transpose(0, 3, 1, 2))
    return torch.from_numpy(rgb).float() / 255, torch.from_numpy(np.stack(cover)[:, None]).float() / 255


def print_kept_back(
    model: nn.Module, images: list[np.ndarray], cover: list[np.ndarray], *, batch: int = 64
) -> None:
    """Cross entropy, mean overlap, and its lowest tenth."""
    model.eval()
    losses, overlaps = [], []
    with torch.no_grad(), torch.autocast("cpu", dtype=torch.bfloat16):
        for start in range(0, len(images), batch):
            x, y = tensors(images[start : start + batch], cover[start : start + batch])
            log_odds = model(x.contiguous(memory_format=torch.channels_last)).float()
            losses.append(float(loss_of(log_odds, y)) * len(x))
            predicted, true = log_odds > 0, functional.avg_pool2d(y, 2) > 0.5
            both = (predicted & true).sum((1, 2, 3)).float()
            overlaps += (both / (predicted | true).sum((1, 2, 3)).clamp(1)).tolist()
    entropy, lowest = sum(losses) / len(images), np.percentile(overlaps, 10)
    print(
        f"kept back: {entropy:.4f} nats, overlap {np.mean(overlaps):.4f}, lowest tenth {lowest:.4f}",
        flush=True,
    )


def main(
    out: Path,
    close_ups: Annotated[Path, typer.Option()],
    bank: list[Path] | None = None,
    epochs: float = 24,
    minutes: float = 60,
    seed: int = 1,
    threads: int = 1,
) -> None:
    """Trains and writes."""
    torch.manual_seed(seed)
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    rng = np.random.default_rng(seed)
    images, cover, kept = pictures(close_ups)
    for folder in bank or []:
        more = bank_crops(folder, rng)
        images, cover, kept = images + more[0], cover + more[1], kept + more[2]
    work = np.flatnonzero(~np.array(kept))
    held = np.flatnonzero(kept)
    print(f"{len(work)} pictures to train on, {len(held)} kept back", flush=True)
    model = UNet().to(memory_format=torch.channels_last)
    mean = torch.optim.swa_utils.AveragedModel(
        model, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(0.995), use_buffers=True
    )
    descent = torch.optim.AdamW(model.parameters(), lr=3e-3, weight_decay=0.01)
    steps = int(epochs * len(work) / BATCH)
    start, total = time.monotonic(), 0.0
    for step in range(steps):
        done = max(step / steps, (time.monotonic() - start) / (60 * minutes))
        if done >= 1:
            break
        for group in descent.param_groups:
            group["lr"] = 3e-3 * min(1.0, (step + 1) / 50) * 0.5 * (1 + np.cos(np.pi * done))
        chosen = rng.choice(work, BATCH)
        x, y = altered(*tensors([images[i] for i in chosen], [cover[i] for i in chosen]), rng)
        model.train()
        with torch.autocast("cpu", dtype=torch.bfloat16):
            log_odds = model(x.contiguous(memory_format=torch.channels_last))
        loss = loss_of(log_odds, y)
        descent.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        descent.step()
        mean.update_parameters(model)
        total += float(loss)
        if (step + 1) % 100 == 0:
            print(
                f"step {step + 1} of {steps}, {time.monotonic() - start:.0f} s: {total / 100:.4f} nats",
                flush=True,
            )
            total = 0.0
        if (step + 1) % 500 == 0:
            write(mean.module, out)
            print_kept_back(mean.module, [images[i] for i in held], [cover[i] for i in held])
    write(mean.module, out)
    print_kept_back(mean.module, [images[i] for i in held], [cover[i] for i in held])
    print(f"{sum(p.numel() for p in model.parameters())} weights, {out.stat().st_size / 2**20:.2f} MiB")


def write(model: nn.Module, path: Path) -> None:
    """The model as ONNX for any number of pictures."""
    model.eval()
    torch.onnx.export(
        model, (torch.zeros(2, 3, SIDE_PX, SIDE_PX),), str(path), input_names=["images"],
        output_names=["fruit_log_odds"], dynamic_axes={"images": {0: "n"}, "fruit_log_odds": {0: "n"}},
        opset_version=17, dynamo=False,
    )  # fmt: skip


if __name__ == "__main__":
    run(main)
