"""A surface that lies on the outlines where views are tangent to it, of least bending in between."""

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
"""Of the fit; each looks for the rims anew. Set by hand."""
STIFFNESS = 6.0
"""Of bending against a rim's miss in mm, both squared. Set by hand."""
REACH_SHARE = 0.03
"""Of the fruit's size, within which a vertex belongs to a rim; twice that in the first round. Set by hand."""
LEAST_SPREAD_PX = 0.35
"""px, least spread of the misses, as RIM_SD_PX of recon.checks.surface_error."""
SPREADS = 3.0
"""Spreads from where on a miss counts ever less. Set by hand, as usual in robust statistics."""
SHADED, NONE_FROM, NONE_AT_FIRST_FROM = 0.4, 1.0, 0.8
"""How far down a rim's normal points (1: straight down) from where on it does not count, in the end and in
the CAUTIOUS_ROUNDS first rounds; over the SHADED before that it counts ever less."""
SPREADING = 6
"""Half steps to the neighbours' mean that spread what is known over the skin. Set by hand."""


@dataclass(frozen=True)
class FittedSurface:
    """A surface on the outlines: its vertices, and how many rims hold each of them."""

    vertices: Vertices
    support: Float[np.ndarray, " n"]


def fitted_to_outlines(vertices: Vertices, faces: Faces, silhouettes: Sequence[Silhouette]) -> FittedSurface:
    """A hull's vertices moved along their normals until its rims lie on the outlines.

    The hull of few or noisy outlines is biased: outward where no view is tangent (a ball of radius r by r δ²
    / 2 at δ from the nearest tangent view), inward by noise. Here all outlines count alike. The signed
    distance of a rim, on edge (i, j), to its outline is one equation for the shift δ of the edge's ends,

        min_δ  sum_rims w (a_i δ_i + a_j δ_j - depth)² + STIFFNESS sum_i (n_i . (L x)_i + (L δ)_i)²,

    with L the mean of the neighbours less the vertex and w Geman and McClure's weight, solved again on the
    moved mesh. The lowest vertex belongs on z = 0. Rims that look down at it have the fruit's
    shadow behind them: in the first rounds those beyond 53 degrees do not count.
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
        spread = max(1.48 * float(np.median(np.abs(miss))), LEAST_SPREAD_PX * float(np.median(pixel_mm)))
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
