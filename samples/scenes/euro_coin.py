"""A euro coin next to the fruit: 23.25 mm across, 2.33 mm thick, a brass ring around a silver centre."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int

DIAMETER_MM = 23.25  # 1 euro: Council Regulation (EU) No 729/2014, annex I
THICKNESS_MM = 2.33
"""Thickness of one euro (European Central Bank), mm."""
_CENTRE_MM = 8.3  # radius of the silver-coloured part, by eye
_RELIEF_MM = 0.12
"""Height of its relief above its field, mm (assumed)."""
_BRASS, _SILVER = (0.80, 0.62, 0.32), (0.78, 0.77, 0.74)
"""sRGB (0 to 1) of ring and centre (by eye)."""


@dataclass(frozen=True, kw_only=True)
class SceneCoin:
    """Position of its centre on the ground (mm; the ground is z = 0) and its rotation."""

    centre_mm: tuple[float, float]
    turn_deg: float
    diameter_mm: float = DIAMETER_MM


def draw_coin(rng: np.random.Generator, *, fruit_radius_mm: float) -> SceneCoin | None:
    """In half of the draws a coin whose rim is 15 to 40 mm from the fruit's side, otherwise None."""
    if rng.uniform() < 0.5:
        return None
    away = fruit_radius_mm + float(rng.uniform(15, 40)) + DIAMETER_MM / 2
    angle = float(rng.uniform(0, 2 * np.pi))
    return SceneCoin(
        centre_mm=(away * np.cos(angle), away * np.sin(angle)), turn_deg=float(rng.uniform(0, 360))
    )


def coin_mesh(
    coin: SceneCoin,
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"], Float[np.ndarray, "n 3"]]:
    """Vertices, outward triangles and linear RGB of the coin: top with its relief, and the edge."""
    rim = coin.diameter_mm / 2
    radii = np.concatenate([np.linspace(0.05, rim - 0.15, 90), [rim, rim]])
    turn = 2 * np.pi * np.arange(240) / 240
    r, t = np.meshgrid(radii, turn, indexing="ij")
    x, y = r * np.cos(t), r * np.sin(t)
    z = THICKNESS_MM - 0.15 + _RELIEF_MM * _relief(x, y, rim)
    z[-2], z[-1] = THICKNESS_MM - 0.15, 0.0
    colour = np.where((r < _CENTRE_MM)[..., None], _SILVER, _BRASS)
    angle = np.radians(coin.turn_deg)
    points = np.stack(
        [
            np.cos(angle) * x - np.sin(angle) * y + coin.centre_mm[0],
            np.sin(angle) * x + np.cos(angle) * y + coin.centre_mm[1],
            z,
        ],
        axis=-1,
    )
    index = np.arange(r.size).reshape(r.shape)
    a, b = index[:-1], index[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    sides = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return points.reshape(-1, 3), sides, colour.reshape(-1, 3)


def _relief(x: np.ndarray, y: np.ndarray, rim: float) -> np.ndarray:
    side = 512
    drawn = np.zeros((side, side), np.uint8)
    cv2.putText(drawn, "1", (150, 370), cv2.FONT_HERSHEY_SIMPLEX, 9.0, 255, 40, cv2.LINE_AA)
    for k in range(12):
        at = (int(256 + 205 * np.cos(k * np.pi / 6)), int(256 + 205 * np.sin(k * np.pi / 6)))
        cv2.circle(drawn, at, 12, 255, -1, cv2.LINE_AA)
    cv2.circle(drawn, (256, 256), 246, 255, 14, cv2.LINE_AA)
    stamp = cv2.GaussianBlur(drawn.astype(np.float32) / 255, (0, 0), 2.5)
    column, row = ((x / rim + 1) * side / 2).astype(np.float32), ((1 - y / rim) * side / 2).astype(np.float32)
    return np.asarray(cv2.remap(stamp, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
