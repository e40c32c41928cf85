"""The printed mat in use: clean, dirty (stains, juice, crumbs) or creased (folds and waves)."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int

from recon.cameras.printed_mat import Mat, standard_mat
from samples.appearance import mat_texture

STATES = ("clean", "creased", "dirty")
_FADE_MM = 12.0  # distance from the blank centre over which the paper starts to lift


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """`size`: big (standard_mat()) or small (9 mm tags, for cherries). Folds lift the paper by `fold_mm`,
    waves by up to `wave_mm`; stains and crumbs are numbers.
    """

    size: str
    state: str
    stains: int
    crumbs: int
    folds: int
    fold_mm: float
    wave_mm: float
    pattern_seed: int


CLEAN_SHEET = Sheet(
    size="big", state="clean", stains=0, crumbs=0, folds=0, fold_mm=0.0, wave_mm=0.0, pattern_seed=0
)
"""The sheet of the sample batch: flat and without dirt."""


def draw_sheet(rng: np.random.Generator, *, fruit_kind: str) -> Sheet:
    """A mat in a random state; the mat is small for two of three cherries and big for all other fruit."""
    small = bool(rng.uniform() < 0.67) and fruit_kind == "cherry"
    state = str(rng.choice(STATES))
    dirty, creased = state == "dirty", state == "creased"
    stains, crumbs, folds = (int(rng.integers(low, high)) for low, high in ((4, 13), (10, 60), (1, 4)))
    fold_mm, wave_mm = float(rng.uniform(0.25, 0.55)), float(rng.uniform(0.1, 0.3))
    return Sheet(
        size="small" if small else "big",
        state=state,
        stains=stains if dirty else 0,
        crumbs=crumbs if dirty else 0,
        folds=folds if creased else 0,
        fold_mm=fold_mm if creased else 0.0,
        wave_mm=wave_mm if creased else 0.0,
        pattern_seed=int(rng.integers(1 << 30)),
    )


def sheet_mat(sheet: Sheet) -> Mat:
    """The mat that is printed on the sheet."""
    return standard_mat() if sheet.size == "big" else standard_mat(tag_mm=9.0, gap_mm=2.5, margin_mm=8.5)


def sheet_texture(sheet: Sheet, mat: Mat) -> Float[np.ndarray, "h w 3"]:
    """Linear RGB of the printed sheet with its dirt and worn folds, seen from above, +y up the picture."""
    per_mm = max(8.0, 144.0 / mat.tag_mm)
    print_rgb = mat_texture(mat, pixels_per_mm=per_mm)
    rng = np.random.default_rng([sheet.pattern_seed, 0])
    high, wide = print_rgb.shape[:2]
    x, y = np.meshgrid(
        (np.arange(wide) + 0.5) / per_mm - mat.width_mm / 2,
        mat.height_mm / 2 - (np.arange(high) + 0.5) / per_mm,
    )
    for angle, offset, _ in _folds(sheet, mat):
        from_fold = np.cos(angle) * x + np.sin(angle) * y - offset
        worn = 0.20 * np.exp(-((from_fold / 0.4) ** 2))[..., None]
        print_rgb = print_rgb * (1 - worn) + 0.55 * worn
    for _ in range(sheet.stains):
        print_rgb = _stained(print_rgb, x, y, mat, rng)
    for _ in range(sheet.crumbs):
        at = rng.uniform(-0.5, 0.5, 2) * (mat.width_mm, mat.height_mm)
        centre = (int((at[0] + mat.width_mm / 2) * per_mm), int((mat.height_mm / 2 - at[1]) * per_mm))
        axes = (int(per_mm * rng.uniform(0.25, 1.1)), int(per_mm * rng.uniform(0.25, 0.8)))
        colour = np.array([0.30, 0.16, 0.06]) * rng.uniform(0.5, 1.6)
        print_rgb = np.ascontiguousarray(print_rgb, dtype=np.float32)
        cv2.ellipse(
            print_rgb, centre, axes, float(rng.uniform(0, 180)), 0, 360, colour.tolist(), -1, cv2.LINE_AA
        )
    return np.asarray(print_rgb, dtype=np.float32)


def sheet_height_mm(
    sheet: Sheet, mat: Mat, x: Float[np.ndarray, "..."], y: Float[np.ndarray, "..."]
) -> Float[np.ndarray, "..."]:
    """Height of the paper above the plane z = 0, mm: zero in the blank centre, never negative."""
    height = np.zeros(np.shape(x))
    for angle, offset, width in _folds(sheet, mat):
        from_fold = np.cos(angle) * x + np.sin(angle) * y - offset
        height += sheet.fold_mm * np.exp(-np.abs(from_fold) / width)
    rng = np.random.default_rng([sheet.pattern_seed, 2])
    for _ in range(3):
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        wave = 2 * np.pi / (rng.uniform(0.35, 0.7) * mat.width_mm)
        lift = 0.5 + 0.5 * np.cos(wave * (np.cos(angle) * x + np.sin(angle) * y) + phase)
        height += sheet.wave_mm / 3 * lift
    blank = min(np.abs(corners[:, :2]).max(axis=1).min() for corners in mat.corners_mm.values())
    out = np.clip((np.maximum(np.abs(x), np.abs(y)) - blank) / _FADE_MM, 0, 1)
    return np.asarray(height * out**2 * (3 - 2 * out))


def sheet_mesh(
    sheet: Sheet, mat: Mat, *, cells: int = 190
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"], Float[np.ndarray, "n 2"]]:
    """Vertices, upward triangles and texture coordinates (v up) of the paper; one cell if it is flat."""
    count = cells if sheet.state == "creased" else 1
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(0, 1, count + 1), np.linspace(0, 1, count + 1)))
    x, y = (u - 0.5) * mat.width_mm, (v - 0.5) * mat.height_mm
    points = np.stack([x, y, sheet_height_mm(sheet, mat, x, y)], axis=1)
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    a, b, c, d = corner, corner + 1, corner + count + 2, corner + count + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return points, triangles, np.stack([u, v], axis=1)


def _folds(sheet: Sheet, mat: Mat) -> list[tuple[float, float, float]]:
    """Direction (radians), distance from the centre (mm) and width (mm) of each fold line."""
    rng = np.random.default_rng([sheet.pattern_seed, 1])
    turns = (0.0, np.pi / 2, rng.uniform(0, np.pi))
    offsets = (0.0, 0.0, 0.3 * mat.width_mm * rng.uniform(-1, 1))
    return [
        (turn + rng.normal(0, 0.02), offset + rng.normal(0, 1.5), float(rng.uniform(1.2, 3.0)))
        for turn, offset, _ in zip(turns, offsets, range(sheet.folds), strict=False)
    ]


def _stained(
    print_rgb: np.ndarray, x: np.ndarray, y: np.ndarray, mat: Mat, rng: np.random.Generator
) -> np.ndarray:
    """The sheet's texture with one random stain: a tinted blot with a dried edge."""
    at = rng.uniform(-0.5, 0.5, 2) * (mat.width_mm, mat.height_mm)
    radius = mat.width_mm * rng.uniform(0.015, 0.09)
    angle = np.arctan2(y - at[1], x - at[0])
    rim = 1 + sum(
        rng.normal(0, 0.12 / k) * np.cos(k * angle + rng.uniform(0, 2 * np.pi)) for k in range(1, 7)
    )
    inside = radius * rim - np.hypot(x - at[0], y - at[1])
    cover = 1 / (1 + np.exp(-np.clip(inside / 0.25, -30, 30)))
    dried_edge = np.exp(-((inside / (0.06 * radius + 0.2)) ** 2))
    tint = np.array(
        ((0.80, 0.35, 0.22), (0.85, 0.68, 0.35), (0.45, 0.32, 0.22), (0.55, 0.15, 0.25))[rng.integers(4)]
    )
    dirt = rng.uniform(0.35, 1.0) * (0.6 * cover + 0.4 * dried_edge)[..., None]
    return np.asarray(print_rgb * (1 - dirt * (1 - tint)))
