"""The fruit model: a network (ONNX, benchmarks/fruit_model_train.py) that tells which pixels are fruit."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from onnxruntime import InferenceSession

from recon.learned.onnx_file import bad_model
from recon.learned.onnx_session import INPUT, opened, ran
from recon.picture_values import Picture, Pictures
from recon.silhouettes.mask import Window

SHIPPED = Path(__file__).parent / "models" / "fruit.onnx"
SIDE_PX = 192
"""Side of the square pictures that trained the shipped model (benchmarks/fruit_model_train.py)."""
OUTPUT, SIGNATURE = "fruit_log_odds", "(n, 3, 192, 192)"
CPU = ("CPUExecutionProvider",)
AT_ONCE = 4
"""Pictures per run: 36 in one run take 680 MiB more memory, and no less time."""
MOST_BYTES = 2_000_000_000
"""Memory limit of one run, for the shipped model and the user's own."""


@dataclass(frozen=True)
class FruitModel:
    """An open model, images (n, 3, 192, 192), RGB in [0, 1] -> fruit_log_odds (n, 1, h, w)."""

    path: Path
    session: Any

    def log_odds(self, images: Pictures, windows: Sequence[Window]) -> list[Float[np.ndarray, "_ _"]]:
        """Log odds of fruit over shrunk windows of BGR photos.

        The model receives the square around a window; beyond the photo its edge is repeated. Raises
        ReconFailure (bad-geometry-model) if the model fails, or returns another shape or non-finite numbers.
        """
        extents = [_extent(window) for window in windows]
        squares = [_square(image, *extent) for image, extent in zip(images, extents, strict=True)]
        made = np.concatenate(
            [self._run(squares[first : first + AT_ONCE]) for first in range(0, len(squares), AT_ONCE)]
        )
        how = {"flags": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_REPLICATE}
        out = []
        for logits, (start, side), window in zip(made, extents, windows, strict=True):
            cell = side / logits.shape[1]  # px of the photo; pixel centres are integers
            corner = window.into_small((start + (cell - 1) / 2)[None])[0]
            M = np.column_stack([np.eye(2) * cell / window.shrink, corner])
            out.append(np.asarray(cv2.warpAffine(logits, M, window.small_size_px, **how)))
        return out

    def _run(self, squares: list[UInt8[np.ndarray, "s s 3"]]) -> Float[np.ndarray, "n h w"]:
        """The model's log odds for squares of photos; raises ReconFailure (bad-geometry-model)."""
        batch = np.stack([s[:, :, ::-1].transpose(2, 0, 1) for s in squares]).astype(np.float32) / 255
        (answer,) = ran(self.path, self.session, [OUTPUT], batch, signature=SIGNATURE, most_bytes=MOST_BYTES)
        made = np.asarray(answer, np.float32)
        if made.ndim != 4 or made.shape[:2] != (len(squares), 1) or not np.isfinite(made).all():
            raise bad_model(
                self.path, f'gives "{OUTPUT}" of shape {made.shape}', f"finite ({len(squares)}, 1, h, w)"
            )
        return made[:, 0]


def fruit_model(path: Path = SHIPPED, *, providers: Sequence[str] = CPU) -> FruitModel:
    """Open a fruit model. Raises ReconFailure (bad-geometry-model) that names the file and its fault."""
    return fruit_model_of(path, opened(path, providers))


def fruit_model_of(path: Path, session: InferenceSession) -> FruitModel:
    """The fruit model of an open session. Raises ReconFailure (bad-geometry-model) for other inputs."""
    inputs = {i.name: i.shape for i in session.get_inputs()}
    wanted = [3, SIDE_PX, SIDE_PX]
    if list(inputs) != [INPUT] or list(inputs[INPUT][1:]) != wanted:
        raise bad_model(path, f"takes the inputs {inputs}", f'one input "{INPUT}" of shape {SIGNATURE}')
    return FruitModel(path, session)


def is_fruit_model(path: Path, *, providers: Sequence[str] = CPU) -> bool:
    """Whether an ONNX file has the output of a fruit model. Raises ReconFailure if it cannot be opened."""
    return has_fruit_output(opened(path, providers))


def has_fruit_output(session: InferenceSession) -> bool:
    """Whether an open model has the output of a fruit model."""
    return OUTPUT in {o.name for o in session.get_outputs()}


def _extent(window: Window) -> tuple[Int[np.ndarray, "2"], int]:
    """First pixel (column, row) and side of the square round a window."""
    size = np.array(window.small_size_px) * window.shrink
    side = int(size.max())
    return np.floor(np.array(window.corner_px) + size / 2 - side / 2).astype(int), side


def _square(image: Picture, start: np.ndarray, side: int) -> UInt8[np.ndarray, "s s 3"]:
    """The photo's square from `start` (column, row), resized to the model's input."""
    x0, y0 = int(start[0]), int(start[1])
    rows, columns = image.shape[:2]
    part = image[max(y0, 0) : min(y0 + side, rows), max(x0, 0) : min(x0 + side, columns)]
    reach = [max(-y0, 0), max(y0 + side - rows, 0), max(-x0, 0), max(x0 + side - columns, 0)]
    if any(reach):
        above, below, left, right = reach
        part = cv2.copyMakeBorder(part, above, below, left, right, cv2.BORDER_REPLICATE)
    how = cv2.INTER_AREA if side > SIDE_PX else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(part, (SIDE_PX, SIDE_PX), interpolation=how), np.uint8)
