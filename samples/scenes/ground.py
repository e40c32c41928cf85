"""The ground under mat or fruit: wood, cloth, brushed steel, stone, a white table."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from samples.appearance import linear_rgb

GROUNDS = ("cloth", "steel", "stone", "white-table", "wood")
TILE_MM = 560.0  # side of the textured square; beyond it the texture is mirrored
TILE_PX = 2048
"""Side of a texture tile (TILE_MM), px: set by hand, finer than photos of the scene resolve."""

_WOODS = ((0.62, 0.45, 0.28), (0.38, 0.25, 0.16), (0.74, 0.60, 0.42), (0.52, 0.34, 0.20))
"""sRGB (0 to 1) of woods; a scene has one of them (by eye)."""
_CLOTHS = ((0.76, 0.71, 0.62), (0.18, 0.22, 0.36), (0.55, 0.14, 0.14), (0.50, 0.52, 0.52), (0.30, 0.42, 0.30))
"""sRGB (0 to 1) of cloths."""
_STONES = ((0.45, 0.44, 0.43), (0.62, 0.58, 0.53), (0.25, 0.26, 0.28), (0.72, 0.71, 0.69))
"""sRGB (0 to 1) of stones."""


@dataclass(frozen=True, kw_only=True)
class SceneGround:
    """Kind, sRGB colour, pattern (cloth: plain, stripes, check; wood: planks, board), roughness, rotation
    about z, half width of the table top.
    """

    kind: str
    srgb: tuple[float, float, float]
    pattern: str
    roughness: float
    turn_deg: float
    half_mm: float
    texture_seed: int


def draw_ground(rng: np.random.Generator, *, kinds: tuple[str, ...] = GROUNDS) -> SceneGround:
    """A ground of one of `kinds`."""
    kind = str(rng.choice(sorted(kinds)))
    palette = {
        "wood": _WOODS, "cloth": _CLOTHS, "stone": _STONES, "steel": ((0.80, 0.80, 0.81),),
        "white-table": ((0.90, 0.90, 0.88),),
    }[kind]  # fmt: skip
    srgb = np.clip(np.array(palette[rng.integers(len(palette))]) * rng.normal(1.0, 0.05, 3), 0.05, 0.95)
    patterns = {"cloth": ("plain", "stripes", "check"), "wood": ("planks", "board")}.get(kind, ("plain",))
    return SceneGround(
        kind=kind,
        srgb=(float(srgb[0]), float(srgb[1]), float(srgb[2])),
        pattern=str(rng.choice(patterns)),
        roughness=float(rng.uniform(0.28, 0.42) if kind == "steel" else rng.uniform(0.45, 0.9)),
        turn_deg=float(rng.uniform(0, 360)),
        half_mm=float(rng.uniform(450, 900)),
        texture_seed=int(rng.integers(1 << 30)),
    )


def ground_shape(mi: Any, ground: SceneGround, *, z_mm: float) -> dict[str, Any]:
    """The table top as a shape of the renderer, at height z_mm."""
    repeat = 2 * ground.half_mm / TILE_MM
    to = mi.ScalarTransform4f
    texture = {
        "type": "bitmap", "raw": True, "wrap_mode": "mirror",
        "bitmap": mi.Bitmap(ground_texture(ground)),
        # centres a tile on the table
        "to_uv": mi.ScalarTransform3f()
        .translate([0.5 - 0.5 * repeat, 0.5 - 0.5 * repeat])
        .scale([repeat, repeat]),
    }  # fmt: skip
    if ground.kind == "cloth":
        bsdf: dict[str, Any] = {"type": "diffuse", "reflectance": texture}
    elif ground.kind == "steel":
        bsdf = {
            "type": "principled", "base_color": texture, "metallic": 1.0, "roughness": ground.roughness,
            "anisotropic": 0.8,
        }  # fmt: skip
    else:
        bsdf = {
            "type": "principled", "base_color": texture, "roughness": ground.roughness, "specular": 0.4,
        }  # fmt: skip
    frame = to().translate([0, 0, z_mm]).rotate([0, 0, 1], ground.turn_deg)
    return {
        "type": "rectangle",
        "to_world": frame @ to().scale([ground.half_mm, ground.half_mm, 1]),
        "bsdf": bsdf,
    }


def ground_texture(ground: SceneGround, *, side_px: int = TILE_PX) -> Float[np.ndarray, "s s 3"]:
    """Linear RGB of one tile; features down to a quarter of a millimetre at the full size."""
    rng = np.random.default_rng([ground.texture_seed, 1])
    make = {"wood": _wood, "cloth": _cloth, "steel": _steel, "stone": _stone, "white-table": _white}
    srgb = make[ground.kind](ground, rng, side_px)
    return linear_rgb(np.clip(srgb, 0.02, 0.97)).astype(np.float32)


def _wood(ground: SceneGround, rng: np.random.Generator, side: int) -> np.ndarray:
    """Texture of wood: grain along the columns, pores, and planks if the pattern has them."""
    tone = _tone(rng, side, (0.09, 5, 100), (0.07, 14, 400), (0.04, 40, 900), (0.05, 3, 4))
    pores = _noise(rng, side, 120, 1400) > 2.0
    tone = np.where(pores, tone - 0.18, tone)
    if ground.pattern == "planks":
        width = int(side * rng.uniform(0.12, 0.25))
        plank = np.arange(side) // width
        tone += (0.10 * rng.normal(size=plank.max() + 1))[plank][None, :]
        seam = np.abs(np.arange(side) % width) < max(2, side // 700)
        tone = np.where(seam[None, :], tone - 0.45, tone)
    return np.asarray(np.array(ground.srgb) * (1 + tone[..., None]))


def _cloth(ground: SceneGround, rng: np.random.Generator, side: int) -> np.ndarray:
    """Texture of woven cloth: warp and weft, and stripes or checks if the pattern has them."""
    threads = int(TILE_MM / rng.uniform(0.9, 1.8))
    along = np.arange(side) * threads / side
    which = along.astype(int)
    warp = (0.08 * rng.normal(size=threads + 1))[which][None, :]
    weft = (0.08 * rng.normal(size=threads + 1))[which][:, None]
    profile = np.abs(np.sin(np.pi * along))
    over = (which[:, None] + which[None, :]) % 2 == 0
    tone = np.where(over, warp + 0.22 * profile[None, :], weft + 0.22 * profile[:, None]) - 0.15
    tone = tone + 0.06 * _noise(rng, side, 300, 300) + 0.05 * _noise(rng, side, 8, 8)
    base = np.broadcast_to(np.array(ground.srgb), (side, side, 3))
    if ground.pattern != "plain":
        other = np.clip(np.array(ground.srgb) * rng.uniform(0.35, 0.6) + rng.uniform(0, 0.45), 0.05, 0.92)
        period = TILE_MM / rng.integers(8, 26)
        band = ((np.arange(side) * TILE_MM / side / period) % 1.0) < rng.uniform(0.25, 0.6)
        share = 0.5 * (band[None, :].astype(float) + band[:, None]) if ground.pattern == "check" else (
            np.broadcast_to(band[None, :].astype(float), (side, side))
        )  # fmt: skip
        base = base * (1 - share[..., None]) + other * share[..., None]
    return np.asarray(base * (1 + tone[..., None]))


def _steel(ground: SceneGround, rng: np.random.Generator, side: int) -> np.ndarray:
    tone = _tone(rng, side, (0.05, 6, 1600), (0.04, 20, 700), (0.03, 3, 3))
    return np.asarray(np.array(ground.srgb) * (1 + tone[..., None]))


def _stone(ground: SceneGround, rng: np.random.Generator, side: int) -> np.ndarray:
    tone = _tone(rng, side, (0.10, 6, 6), (0.10, 180, 180), (0.08, 600, 600))
    dark, pale = _noise(rng, side, 320, 320) > 1.5, _noise(rng, side, 260, 260) > 1.7
    tone = np.where(dark, tone - 0.45, np.where(pale, tone + 0.35, tone))
    return np.asarray(np.array(ground.srgb) * (1 + tone[..., None]))


def _white(ground: SceneGround, rng: np.random.Generator, side: int) -> np.ndarray:
    tone = _tone(rng, side, (0.012, 5, 5), (0.008, 400, 400))
    scratches = _noise(rng, side, 30, 1200) > 3.2
    return np.asarray(np.array(ground.srgb) * (1 + np.where(scratches, tone - 0.12, tone)[..., None]))


def _tone(rng: np.random.Generator, side: int, *waves: tuple[float, int, int]) -> np.ndarray:
    """Sum of noises, each with its amplitude and its number of cells down and across."""
    noises = [share * _noise(rng, side, rows, columns) for share, rows, columns in waves]
    return np.asarray(np.sum(noises, axis=0))


def _noise(rng: np.random.Generator, side: int, rows: int, columns: int) -> np.ndarray:
    """Smooth noise of about unit variance with `rows` cells down and `columns` cells across."""
    cells = rng.normal(size=(min(rows, side), min(columns, side))).astype(np.float32)
    grown = cv2.resize(cells, (side, side), interpolation=cv2.INTER_CUBIC)
    return np.asarray(grown / grown.std())
