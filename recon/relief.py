"""Relief that no silhouette shows (the stem cavity, a shallow suture): depth along the hull's normals where
photos agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import sparse
from scipy.sparse.linalg import spsolve

from recon.camera import Camera
from recon.closed import facing, neighbour_mean, vertex_normals
from recon.hull import ball, sampled, split


@dataclass(frozen=True, kw_only=True)
class Search:
    """Offsets along the normals, in radii of the fruit, from the surface given or as moved before."""

    highest: float
    lowest: float
    steps: int
    from_moved: bool


SEARCHES = (
    Search(highest=0.015, lowest=-0.2, steps=24, from_moved=False),
    Search(highest=0.015, lowest=-0.2, steps=24, from_moved=False),
    Search(highest=0.05, lowest=-0.07, steps=18, from_moved=True),
    Search(highest=0.05, lowest=-0.07, steps=18, from_moved=True),
    Search(highest=0.04, lowest=-0.04, steps=16, from_moved=True),
)
LEVEL = 5
VIEWS_EACH = 5
SIDE = 7
PATCH_STEP_PX = 1.7
LEAST_SCORE = 0.5
LEAST_CONTRAST = 1.2
GLOSS_DEPTH_SHARE = 0.04
HIGHLIGHT = 215.0
STEM_COSINE = 0.75
SHALLOW_SHARE = 0.055
MOST_DEEP = 0.25
STIFFNESS = 1.2
SUPPORT_WEIGHT = 5.0
EVERYWHERE, LOOSE = 0.02, 2e-4
FLAT, ROUND = 0.45, 0.85
HOLLOW_SHARE = 0.02
HOLLOW_DENSITY = 0.25
HOLLOW_SPREADING = 3


def with_relief(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    cameras: Sequence[Camera],
    *,
    support: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "n 3"], float]:
    """A surface on `ball`'s directions moved to where the photos agree, and the share of it that was measured
    so.

    For each vertex a small square patch, bent as the surface is, slides along the normal; at each offset the
    views that face it most are compared by their mean pairwise normalised correlation, (|sum of unit
    patches|² - K) / (K (K - 1)). Peaks that are high and on enough contrast are kept, and a membrane on the
    mesh fills between them; where the surface bulges it is held by the outlines (`support`: how many rims
    hold a vertex), which place the skin some ten times better than depth does. Highlights and mirrored lights
    put depth behind the skin: where more than a quarter of the surface seems to lie deeper than 4 % of the
    radius, nothing is moved.
    """
    finer = round(np.log(max(len(vertices) - 2, 10) / 10) / np.log(4))
    level = min(LEVEL, finer)
    coarse_faces = ball(level)[1]
    count = 10 * 4**level + 2
    points, normals = vertices[:count], vertex_normals(vertices, faces)[:count]
    radius = float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
    grey = [
        cv2.GaussianBlur(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY), (3, 3), 0.8).astype(np.float32) for i in images
    ]
    bending = _curvature(points, normals, coarse_faces)
    held = SUPPORT_WEIGHT * support[:count] * _rounded(bending * radius)
    moved, share, hollow = points, 0.0, np.zeros(count)
    for search in SEARCHES:
        base = moved if search.from_moved else points
        offsets = np.linspace(search.highest, search.lowest, search.steps) * radius
        scores = _agreement(base, normals, bending, grey, cameras, offsets)
        height = np.einsum("ij,ij->i", base - points, normals)
        side = np.abs(normals[:, 2]) < STEM_COSINE
        scores[side] *= (height[:, None] + offsets > -SHALLOW_SHARE * radius)[side]
        offset, weight = _peaks(_shared(scores, coarse_faces), offsets)
        found = height + offset
        if (weight * (found < -GLOSS_DEPTH_SHARE * radius)).sum() > MOST_DEEP * max(float(weight.sum()), 1.0):
            return vertices, 0.0
        hollow = np.maximum(hollow, _hollow(found < -HOLLOW_SHARE * radius, weight > 0, coarse_faces))
        pull = LOOSE + (EVERYWHERE + held) * (1 - hollow) ** 4
        smooth = _membrane(found, weight, pull, coarse_faces)
        moved = base + (smooth - height)[:, None] * normals
        share = float((weight > 0).mean())
        turned = vertex_normals(moved, coarse_faces)
        normals = turned if search.from_moved else _blend(normals, turned)
        bending = _curvature(moved, turned, coarse_faces)
    return vertices + split(moved - points, level, finer), share


def _rounded(bending: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """1 where a surface (mean curvature in inverse radii, negative if convex) bulges, 0 where it is flat.

    Outlines bridge a hollow from lip to lip with a piece that is flat across: what is flat may be a bridge.
    """
    return np.asarray(np.clip((-bending - FLAT) / (ROUND - FLAT), 0.0, 1.0))


def _hollow(
    deep: Bool[np.ndarray, " n"], trusted: Bool[np.ndarray, " n"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " n"]:
    """1 where the photos agree all around that the skin lies deep under the outlines, 0 elsewhere, soft
    between.
    """
    step = neighbour_mean(faces, len(deep))
    sure, low = trusted.astype(float), (trusted & deep).astype(float)
    for _ in range(HOLLOW_SPREADING):
        sure, low = 0.5 * (sure + step @ sure), 0.5 * (low + step @ low)
    hollow = ((low > HOLLOW_DENSITY) & (low > 0.6 * sure)).astype(float)
    for _ in range(HOLLOW_SPREADING):
        hollow = np.maximum(hollow, np.minimum(1.0, 1.5 * (step @ hollow)))
    return np.asarray(hollow)


def _agreement(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    bending: Float[np.ndarray, " n"],
    grey: Sequence[Float[np.ndarray, "h w"]],
    cameras: Sequence[Camera],
    offsets: Float[np.ndarray, " d"],
) -> Float[np.ndarray, "n d"]:
    """Mean pairwise correlation of each vertex's patches at each offset; 0 where fewer than three views
    count.
    """
    pixel_mm = float(np.median([np.median(c.into(points)[:, 2]) / c.focal_px for c in cameras]))
    across = np.cross(normals, np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normals, across)
    steps = (np.arange(SIDE) - (SIDE - 1) / 2) * PATCH_STEP_PX * pixel_mm
    u, v = (g.ravel() for g in np.meshgrid(steps, steps))
    patch = points[:, None] + u[None, :, None] * across[:, None] + v[None, :, None] * along[:, None]
    patch += (0.5 * bending[:, None] * (u**2 + v**2))[..., None] * normals[:, None]
    cosine = np.stack([facing(points, normals, c.place) for c in cameras])
    chosen = np.argsort(-cosine, axis=0, kind="stable")[:VIEWS_EACH]
    use = np.zeros_like(cosine, dtype=bool)
    np.put_along_axis(use, chosen, True, axis=0)
    use &= cosine > 0.35
    total = np.zeros((len(offsets), len(points), SIDE * SIDE), np.float32)
    views = np.zeros((len(offsets), len(points)))
    for camera, picture, rows in zip(cameras, grey, use, strict=True):
        at = np.flatnonzero(rows)
        if len(at) == 0:
            continue
        P = camera.intrinsics @ camera.cam_from_world[:3]
        start = patch[at] @ P[:, :3].T + P[:, 3]
        step = normals[at] @ P[:, :3].T
        for k, offset in enumerate(offsets):
            h = start + offset * step[:, None]
            values = sampled(picture, (h[..., :2] / h[..., 2:]).reshape(-1, 2), outside=0.0).reshape(
                len(at), -1
            )
            dull = np.mean(values > HIGHLIGHT, axis=1) < 0.05
            values -= values.mean(1, keepdims=True)
            length = np.linalg.norm(values, axis=1, keepdims=True)
            good = (length[:, 0] > LEAST_CONTRAST * SIDE) & dull
            total[k, at[good]] += values[good] / length[good]
            views[k, at[good]] += 1
    power = np.einsum("dnp,dnp->dn", total, total)
    pairs = np.maximum(views * (views - 1), 1)
    return np.where(views >= 3, (power - views) / pairs, 0.0).T


def _curvature(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " n"]:
    """Mean curvature, 1/mm, negative where convex: the mean of 2 n . (x_j - x_i) / |x_j - x_i|² over the
    neighbours j.
    """
    i, j = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    step = points[j] - points[i]
    each = 2 * np.einsum("ij,ij->i", step, normals[i]) / np.sum(step**2, axis=1)
    mean = np.bincount(i, each, len(points)) / np.bincount(i, minlength=len(points))
    smooth = neighbour_mean(faces, len(points))
    for _ in range(6):
        mean = 0.5 * mean + 0.5 * (smooth @ mean)
    limit = 3 / float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
    return np.asarray(np.clip(mean, -limit, limit))


def _shared(scores: Float[np.ndarray, "n d"], faces: Int[np.ndarray, "m 3"]) -> Float[np.ndarray, "n d"]:
    """Scores averaged with the neighbours', twice."""
    step = neighbour_mean(faces, len(scores))
    for _ in range(2):
        scores = 0.5 * scores + 0.5 * (step @ scores)
    return scores


def _peaks(
    scores: Float[np.ndarray, "n d"], offsets: Float[np.ndarray, " d"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Offset of the best score, to a part of the step by a parabola, and its weight (0 where it is not to be
    trusted).
    """
    rows = np.arange(len(scores))
    best = scores.argmax(1)
    inner = np.clip(best, 1, len(offsets) - 2)
    low, mid, high = scores[rows, inner - 1], scores[rows, inner], scores[rows, inner + 1]
    bend = low - 2 * mid + high
    shift = np.where(bend < -1e-6, 0.5 * (low - high) / np.where(bend < -1e-6, bend, -1.0), 0.0)
    offset = offsets[inner] + np.clip(shift, -1, 1) * (offsets[1] - offsets[0])
    score = scores[rows, best]
    edge = (best == 0) | (best == len(offsets) - 1)
    far = np.abs(np.arange(len(offsets))[None] - best[:, None]) > 3
    second = np.where(far, scores, -1.0).max(1)
    trusted = (score > LEAST_SCORE) & ~edge & (score - second > 0.1)
    return offset, np.where(trusted, score**2, 0.0)


def _membrane(
    offset: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    pull: Float[np.ndarray, " n"],
    faces: Int[np.ndarray, "m 3"],
) -> Float[np.ndarray, " n"]:
    """argmin sum w (x - offset)² + pull x² + STIFFNESS |x - mean of neighbours|²."""
    step = neighbour_mean(faces, len(offset))
    bend = sparse.identity(len(offset)) - step
    A = sparse.diags(weight + pull) + STIFFNESS * (bend.T @ bend) * 4
    return np.asarray(spsolve(A.tocsc(), weight * offset))


def _blend(old: Float[np.ndarray, "n 3"], new: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    mixed = old + new
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))
