"""A surface fitted to the outlines where views are tangent to it, with least bending in between."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import sparse

from recon.silhouettes.hull import Silhouette
from recon.triangle_mesh import (
    Faces,
    Vertices,
    neighbour_mean,
    rim_crossings,
    solved,
    unique_edges,
    vertex_normals,
)

ROUNDS, CAUTIOUS_ROUNDS = 8, 5
"""Rounds of the fit, and the first ones of NONE_AT_FIRST_FROM; each finds the rims again. Set by hand."""
STIFFNESS = 6.0
"""Weight of bending against a rim's misfit in mm, both squared. Set by hand."""
REACH_SHARE = 0.03
"""Largest distance of a rim from its outline, over the fruit's radius; at first twice that. By hand."""
RIM_SD_PX = 0.35
"""Least error of a place on a rim, px, and so the least spread of the misfits."""
SPREADS = 3.0
"""Scale of Geman and McClure's weight, in spreads. Set by hand, as usual in robust statistics."""
SHADED, NONE_FROM, NONE_AT_FIRST_FROM = 0.4, 1.0, 0.8
"""Downward part of a rim's normal (1: straight down) at which its weight is zero: at the end, and in the
CAUTIOUS_ROUNDS first rounds. Its weight falls over the SHADED before."""
SPREADING = 6
"""Smoothing rounds that spread the rims' weights over the skin. Set by hand."""


@dataclass(frozen=True)
class FittedSurface:
    """Vertices on the outlines, and the summed weight of the rims at each of them."""

    vertices: Vertices
    support: Float[np.ndarray, " n"]


def fitted_to_outlines(vertices: Vertices, faces: Faces, silhouettes: Sequence[Silhouette]) -> FittedSurface:
    """A hull's vertices moved along their normals until its rims lie on the outlines.

    The hull of few or noisy outlines is biased: inward by noise, outward where no view is tangent. (A ball of
    radius r is biased by r θ² / 2 at θ from the nearest tangent view.) Here all outlines have equal weight.
    The signed distance of a rim, on edge (i, j), to its outline is one equation for the shift δ of the ends,

        min_δ  sum_rims w (a_i δ_i + a_j δ_j - depth)² + STIFFNESS sum_i (n_i . (L x)_i + (L δ)_i)².

    L is the mean of the neighbours less the vertex, w Geman and McClure's weight; each round solves it again.
    The lowest vertex belongs on z = 0. Rims with downward normals have the fruit's shadow behind them: in the
    first rounds those beyond 53 degrees do not count.
    """
    i, j = unique_edges(faces)[0].T
    L = sparse.csr_array(neighbour_mean(faces, len(vertices)) - sparse.identity(len(vertices)))
    x = vertices.copy()
    size = float(np.median(np.linalg.norm(x - x.mean(0), axis=1)))
    bending = sparse.csr_array(STIFFNESS * (L.T @ L))
    held = np.zeros(len(x))
    for turn in range(ROUNDS):
        normals = vertex_normals(x, faces)
        rows, values, pixel_mm = [], [], []
        for s in silhouettes:
            a, b, t = rim_crossings(x, normals, i, j, s.camera.place)
            depth = (1 - t) * s.depth_mm(x[a]) + t * s.depth_mm(x[b])
            near = np.abs(depth) < (REACH_SHARE if turn else 2 * REACH_SHARE) * size
            rows.append(np.stack([a, b, 1 - t, t])[:, near])
            values.append(depth[near])
            pixel_mm.append(s.camera.pixel_mm(x[:50]))
        a, b, wa, wb = np.concatenate(rows, axis=1)
        miss = np.concatenate(values)
        count = np.arange(len(miss))
        A = sparse.csr_array(
            (np.concatenate([wa, wb]), (np.tile(count, 2), np.concatenate([a, b]).astype(int))),
            shape=(len(miss), len(x)),
        )
        spread = max(1.48 * float(np.median(np.abs(miss))), RIM_SD_PX * float(np.median(pixel_mm)))
        weight = 1 / (1 + (miss / (SPREADS * spread)) ** 2) ** 2
        down = -(wa * normals[a.astype(int), 2] + wb * normals[b.astype(int), 2])
        none_from = NONE_AT_FIRST_FROM if turn < CAUTIOUS_ROUNDS else NONE_FROM
        weight *= np.clip((none_from - down) / SHADED, 0.0, 1.0) ** 2
        normal_of = sparse.csr_array(A.T @ sparse.diags(weight) @ A + bending)
        right = A.T @ (weight * miss) - STIFFNESS * (L.T @ np.einsum("ij,ij->i", normals, L @ x))
        lowest = int(x[:, 2].argmin())
        normal_of = normal_of + sparse.csr_array(([100.0], ([lowest], [lowest])), shape=normal_of.shape)
        right[lowest] += 100.0 * x[lowest, 2]
        shift = solved(normal_of + 1e-6 * sparse.identity(len(x)), right)
        limit = 0.1 * size
        x = x + np.clip(shift, -limit, limit)[:, None] * normals
        x[:, 2] = np.maximum(x[:, 2], 0.0)
        held = np.asarray(A.T @ weight).ravel()
    for _ in range(SPREADING):
        held = held + 0.5 * (L @ held)
    return FittedSurface(x, held)
