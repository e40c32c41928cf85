"""Relief that no silhouette shows (the stem cavity, a shallow suture): depth along the hull's normals where
photos agree.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy import sparse
from scipy.sparse.linalg import spsolve

from recon.camera import Camera
from recon.closed import vertex_normals
from recon.hull import ball, sampled

LEVEL = 5
VIEWS_EACH = 5
SIDE = 7
PATCH_STEP_PX = 1.7
DEEPEST_SHARE = 0.2
OFFSETS = 24
LEAST_SCORE = 0.55
LEAST_CONTRAST = 1.2
GLOSS_DEPTH_SHARE = 0.04
HIGHLIGHT = 215.0
STEM_COSINE = 0.75
SHALLOW_SHARE = 0.055
MOST_DEEP = 0.25
STIFFNESS = 0.6


def with_relief(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    cameras: Sequence[Camera],
) -> tuple[Float[np.ndarray, "n 3"], float]:
    """A hull of `visual_hull` moved inward to where the photos agree, and the share of it that was measured
    so.

    For each vertex a small square patch, bent as the surface is, slides along the normal; at each offset the
    views that face it most are compared by their mean pairwise normalised correlation, (|sum of unit
    patches|² - K) / (K (K - 1)). Peaks that are high and on enough contrast are kept, and a membrane on the
    mesh fills between them. Highlights and mirrored lights put depth behind the skin: where more than a
    quarter of the surface seems to lie deeper than 4 % of the radius, nothing is moved.
    """
    level = min(LEVEL, round(np.log(max(len(vertices) - 2, 10) / 10) / np.log(4)))
    coarse_faces = ball(level)[1]
    count = 10 * 4**level + 2
    points, normals = vertices[:count], vertex_normals(vertices, faces)[:count]
    radius = float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
    offsets = np.linspace(0.015, -DEEPEST_SHARE, OFFSETS) * radius
    grey = [
        cv2.GaussianBlur(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY), (3, 3), 0.8).astype(np.float32) for i in images
    ]
    offset = np.zeros(count)
    weight = np.zeros(count)
    bending = _bending(points, normals, coarse_faces)
    for _ in range(2):
        scores = _agreement(points, normals, bending, grey, cameras, offsets)
        scores[np.abs(normals[:, 2]) < STEM_COSINE] *= offsets > -SHALLOW_SHARE * radius
        offset, weight = _peaks(_shared(scores, coarse_faces), offsets)
        deep = offset < -GLOSS_DEPTH_SHARE * radius
        if (weight * deep).sum() > MOST_DEEP * max(float(weight.sum()), 1.0):
            return vertices, 0.0
        offset = _membrane(offset, weight, coarse_faces)
        moved = points + offset[:, None] * normals
        normals = _blend(normals, vertex_normals(moved, coarse_faces))
        bending = _bending(moved, vertex_normals(moved, coarse_faces), coarse_faces)
    return vertices + _everywhere(moved - points, level, len(vertices)), float((weight > 0).mean())


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
    facing = np.stack([_facing(points, normals, c) for c in cameras])
    chosen = np.argsort(-facing, axis=0, kind="stable")[:VIEWS_EACH]
    use = np.zeros_like(facing, dtype=bool)
    np.put_along_axis(use, chosen, True, axis=0)
    use &= facing > 0.35
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


def _facing(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], camera: Camera
) -> Float[np.ndarray, " n"]:
    ray = camera.place - points
    return np.asarray(np.einsum("ij,ij->i", ray, normals) / np.linalg.norm(ray, axis=1))


def _bending(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " n"]:
    """Mean curvature, 1/mm, negative where convex: the mean of 2 n . (x_j - x_i) / |x_j - x_i|² over the
    neighbours j.
    """
    i, j = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    step = points[j] - points[i]
    each = 2 * np.einsum("ij,ij->i", step, normals[i]) / np.sum(step**2, axis=1)
    mean = np.bincount(i, each, len(points)) / np.bincount(i, minlength=len(points))
    smooth = _neighbours(faces, len(points))
    for _ in range(6):
        mean = 0.5 * mean + 0.5 * (smooth @ mean)
    limit = 3 / float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
    return np.asarray(np.clip(mean, -limit, limit))


def _shared(scores: Float[np.ndarray, "n d"], faces: Int[np.ndarray, "m 3"]) -> Float[np.ndarray, "n d"]:
    """Scores averaged with the neighbours', twice."""
    step = _neighbours(faces, len(scores))
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
    offset: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, " n"]:
    """argmin sum w (x - offset)² + STIFFNESS |x - mean of neighbours|² + a small pull to the hull."""
    step = _neighbours(faces, len(offset))
    bend = sparse.identity(len(offset)) - step
    A = sparse.diags(weight + 0.02) + STIFFNESS * (bend.T @ bend) * 4
    return np.asarray(spsolve(A.tocsc(), weight * offset))


def _blend(old: Float[np.ndarray, "n 3"], new: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    mixed = old + new
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


def _neighbours(faces: Int[np.ndarray, "m 3"], count: int) -> sparse.csr_array:
    """Row-stochastic adjacency."""
    i = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    i = np.concatenate([i, i[:, ::-1]])
    A = sparse.csr_array((np.ones(len(i)), (i[:, 0], i[:, 1])), shape=(count, count))
    A.data[:] = 1.0
    return sparse.csr_array(sparse.diags(1 / np.asarray(A.sum(1)).ravel()) @ A)


def _everywhere(shift: Float[np.ndarray, "n 3"], level: int, count: int) -> Float[np.ndarray, "m 3"]:
    """Shifts of a ball's vertices carried to its finer levels: a new vertex moves as the mean of its edge's
    ends.
    """
    while len(shift) < count:
        faces = ball(level)[1]
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        shift = np.concatenate([shift, shift[np.unique(edges, axis=0)].mean(1)])
        level += 1
    return shift
