"""Photo-consistency of small patches: correlation between views, and its peak along the normals."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from recon.cameras.camera import Camera
from recon.picture_values import Pictures, sampled
from recon.triangle_mesh import facing

SIDE = 7
"""Samples along a patch's side: 49 numbers determine a correlation to a seventh."""
_RISES = np.indices((SIDE, SIDE)).reshape(2, -1)[::-1].T - (SIDE - 1) / 2
_GRADIENT = np.ascontiguousarray(_RISES / np.linalg.norm(_RISES, axis=0), np.float32)
"""These are patches that rise evenly along each side, in steps and of unit norm."""
PATCH_STEP_PX = 1.7
"""Distance between samples, px: as far as a photo's blur correlates neighbours."""
FACING = 0.35
"""Least cosine between normal and line of sight: beyond 70 degrees a patch shrinks to a third."""
FEWEST_VIEWS = 3
"""Least number of views that show a patch: two agree by chance."""
VIEW_COUNTS = (5, 8)
"""Views compared: few face the bottom of a narrow cavity; many average out a highlight that moves."""
LEAST_CONTRAST = (1.2, 0.8)
"""Least standard deviation of a patch (grey levels), with and without its gradient; photo noise is 0.5."""
LEAST_SCORE = (0.5, 0.4)
"""Least trusted correlation, with and without the gradient. Set by hand."""
DISTINCT, DISTINCT_STEPS = 0.1, 3
"""Lead of a peak over every depth more than this many steps away. Set by hand."""
HIGHLIGHT, MOST_HIGHLIGHT = 215.0, 0.05
"""Grey level (of 255) of a highlight, and largest share of a patch that may be one. Set by hand."""


@dataclass(frozen=True)
class GreyView:
    """A photo in grey levels, blurred to what the patches resolve, and its camera."""

    grey: Float[np.ndarray, "h w"]
    camera: Camera


@dataclass(frozen=True)
class Patches:
    """Surface points (mm), outward normals, and mean curvature (1/mm, negative where convex)."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    curvature: Float[np.ndarray, " n"]

    def __getitem__(self, rows: np.ndarray) -> "Patches":
        return Patches(self.points[rows], self.normals[rows], self.curvature[rows])


def grey_views(images: Pictures, cameras: Sequence[Camera]) -> list[GreyView]:
    """The photos in grey, slightly blurred, for the comparison of patches."""
    return [
        GreyView(cv2.GaussianBlur(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY), (3, 3), 0.8).astype(np.float32), c)
        for i, c in zip(images, cameras, strict=True)
    ]


def views_facing(patches: Patches, views: Sequence[GreyView]) -> Int[np.ndarray, " n"]:
    """Number of views that each patch faces well enough to be compared (cosine over FACING)."""
    return np.asarray((_cosines(patches, views) > FACING).sum(axis=0))


def _cosines(patches: Patches, views: Sequence[GreyView]) -> Float[np.ndarray, "v n"]:
    return np.stack([facing(patches.points, patches.normals, v.camera.place) for v in views])


def agreement(
    patches: Patches, views: Sequence[GreyView], offsets_mm: Float[np.ndarray, " d"]
) -> tuple[Float[np.ndarray, "k n d"], Bool[np.ndarray, "k n d"]]:
    """Mean pairwise correlation of each patch in the views that it faces most, at offsets along its normal.

    For K unit patches p_v of zero mean the score is (|sum_v p_v|² - K) / (K (K - 1)). Index k runs over
    VIEW_COUNTS for patches as they are, then for patches less their gradient. Shading and blurred reflections
    have a gradient, texture has none. Where fewer than three views show contrast and no highlight, the score
    is 0 and the second array False.
    """
    cosine = _cosines(patches, views)
    rank = np.argsort(np.argsort(-cosine, axis=0, kind="stable"), axis=0)
    square = _square(patches, views)
    shape = (2, len(VIEW_COUNTS), len(square), len(offsets_mm))
    total, count = np.zeros((*shape, SIDE * SIDE), np.float32), np.zeros(shape, np.float32)
    for view, ranks, cosines in zip(views, rank, cosine, strict=True):
        rows = np.flatnonzero((ranks < max(VIEW_COUNTS)) & (cosines > FACING))
        if len(rows) == 0:
            continue
        values = _seen(square[rows], patches.normals[rows], view, offsets_mm)
        dull = np.mean(values > HIGHLIGHT, axis=2) < MOST_HIGHLIGHT
        values -= values.mean(axis=2, keepdims=True)
        for kind in range(2):
            if kind:
                values -= (values @ _GRADIENT) @ _GRADIENT.T
            length = np.sqrt(np.einsum("ndp,ndp->nd", values, values))
            good = dull & (length > LEAST_CONTRAST[kind] * SIDE)
            unit = values * np.where(good, 1 / np.maximum(length, 1e-9), 0.0).astype(np.float32)[..., None]
            for k, most in enumerate(VIEW_COUNTS):
                among = ranks[rows] < most
                total[kind, k, rows[among]] += unit[among]
                count[kind, k, rows[among]] += good[among]
    power = np.einsum("skndp,skndp->sknd", total, total)
    enough = count >= FEWEST_VIEWS
    scores = np.where(enough, (power - count) / np.maximum(count * (count - 1), 1), 0.0)
    return scores.reshape(-1, *shape[2:]).astype(float), enough.reshape(-1, *shape[2:])


def best_offsets(
    scores: Float[np.ndarray, "k n d"], offsets_mm: Float[np.ndarray, " d"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Offset (mm) of the scores' peak by a parabola, and its weight, the squared score; 0 if unclear."""
    step = float(offsets_mm[1] - offsets_mm[0])
    each = [_peak(s, offsets_mm, LEAST_SCORE[k // len(VIEW_COUNTS)]) for k, s in enumerate(scores)]
    offset, weight = np.stack([o for o, _ in each]), np.stack([w for _, w in each])
    best = np.take_along_axis(offset, weight.argmax(0)[None], axis=0)
    same = np.abs(offset - best) <= DISTINCT_STEPS * abs(step)
    agreed = ~((weight > 0) & ~same).any(axis=0)
    shares = weight * same
    mean = (shares * offset).sum(0) / np.maximum(shares.sum(0), 1e-9)
    return mean, np.where(agreed, weight.max(0), 0.0)


def _square(patches: Patches, views: Sequence[GreyView]) -> Float[np.ndarray, "n p 3"]:
    """Points of square patches of SIDE x SIDE samples, bent with the surface's curvature."""
    pixel_mm = float(np.median([v.camera.pixel_mm(patches.points) for v in views]))
    normals = patches.normals
    aside = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(normals, aside)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normals, across)
    steps = (np.arange(SIDE) - (SIDE - 1) / 2) * PATCH_STEP_PX * pixel_mm
    u, v = (g.ravel() for g in np.meshgrid(steps, steps))
    flat = patches.points[:, None] + u[None, :, None] * across[:, None] + v[None, :, None] * along[:, None]
    bulge = 0.5 * patches.curvature[:, None] * (u**2 + v**2)
    return np.asarray(flat + bulge[..., None] * normals[:, None])


def _seen(
    square: Float[np.ndarray, "n p 3"],
    normals: Float[np.ndarray, "n 3"],
    view: GreyView,
    offsets_mm: Float[np.ndarray, " d"],
) -> Float[np.ndarray, "n d p"]:
    """Grey levels of patches in one view at every offset."""
    P = view.camera.intrinsics @ view.camera.cam_from_world[:3]
    start = (square @ P[:, :3].T + P[:, 3]).astype(np.float32)
    step = (normals @ P[:, :3].T).astype(np.float32)
    h = start[:, None] + offsets_mm.astype(np.float32)[None, :, None, None] * step[:, None, None]
    return sampled(view.grey, h[..., :2] / h[..., 2:], outside=0.0)


def _peak(
    scores: Float[np.ndarray, "n d"], offsets: Float[np.ndarray, " d"], least: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Offset of each patch's highest score, by a parabola, and its weight: 0 for a peak without trust."""
    rows = np.arange(len(scores))
    best = scores.argmax(1)
    inner = np.clip(best, 1, len(offsets) - 2)
    low, mid, high = scores[rows, inner - 1], scores[rows, inner], scores[rows, inner + 1]
    bend = low - 2 * mid + high
    shift = np.where(bend < -1e-6, 0.5 * (low - high) / np.where(bend < -1e-6, bend, -1.0), 0.0)
    offset = offsets[inner] + np.clip(shift, -1, 1) * (offsets[1] - offsets[0])
    score = scores[rows, best]
    edge = (best == 0) | (best == len(offsets) - 1)
    far = np.abs(np.arange(len(offsets))[None] - best[:, None]) > DISTINCT_STEPS
    second = np.where(far, scores, -1.0).max(1)
    trusted = (score > least) & ~edge & (score - second > DISTINCT)
    return offset, np.where(trusted, score**2, 0.0)
