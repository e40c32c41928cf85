"""Integration of the traction field, whose samples are marker forces, over the fruit's surface.

Each marker's force is its traction times its cell. Between markers the traction is interpolated linearly on
their Delaunay triangles, t(x) = sum_i f_i phi_i(x) / a_i with a_i the integral of phi_i, and integrated
with a twelve-point rule per triangle at the material points that the triangle covers on the fruit. With point
loads the result would depend on the mesh; with traction it does not.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, eye_array
from scipy.spatial import Delaunay

from fem.solid.rigid_core import rigid_modes

CORNERS = np.eye(3)
"""Barycentric coordinates of a triangle's corners."""
MIDDLES = (CORNERS + np.roll(CORNERS, -1, axis=0)) / 2
"""Of its edges' middles."""
QUARTERS = np.stack([np.stack([CORNERS[k], MIDDLES[k], MIDDLES[k - 1]]) for k in range(3)] + [MIDDLES])
"""Corners of the four triangles between them."""
RULE = np.einsum("pk,qkc->qpc", (1 + 3 * CORNERS) / 6, QUARTERS).reshape(12, 3)
"""Barycentric coordinates of twelve points, three in each quarter; exact to second degree.

With markers 1 mm apart the loads lie 0.25 mm apart. Three points per triangle make E 0.6 % too high where the
mesh's edges are 1 mm, twelve change it by less than 0.1 % between edges of 2 and 1 mm.
"""
LONGEST_SIDE = 3.0
"""Triangles with a side longer than this many marker spacings bridge separate patches: they are left out."""

SHEAR = 1e-3
"""Shear that breaks ties of a triangulation: far above rounding, too small to change others."""


def moment_correction(
    points_mm: Float[np.ndarray, "q 3"], marker_mm: Float[np.ndarray, "n 3"], weights: csr_array
) -> tuple[Float[np.ndarray, "d 6"], Float[np.ndarray, "6 m"]]:
    """A and B, so that forces W f + A B f at the points have the total force and moment of the markers.

    Every column of `weights`, W, sums to one: the interpolated field keeps the force. On a curved surface its
    moment is off by a few micrometres; the smallest field a + b x (x - centre), weighted like the loads
    themselves, corrects that. Rows of A and columns of B go point by point (marker by marker), x, y, z.
    """
    centre = points_mm.mean(axis=0)
    of_markers, of_points = (rigid_modes(places, centre_mm=centre) for places in (marker_mm, points_mm))
    share = np.asarray(weights.sum(axis=1)).reshape(-1)
    weighted = share[:, None, None] * of_points
    gram = np.einsum("qik,qil->kl", of_points, weighted)
    kept = (weights.T @ of_points.reshape(len(of_points), -1)).reshape(of_markers.shape)
    missing = (of_markers - kept).reshape(-1, 6)
    amounts = np.linalg.pinv(gram, rcond=1e-12, hermitian=True)
    return weighted.reshape(-1, 6), np.asarray(amounts @ missing.T)


def marker_weights(
    rest_mm: Float[np.ndarray, "n 3"], surface_mm: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "q 3"], csr_array]:
    """Integration points and weights for the field of markers resting at `rest_mm` (pad frame).

    The points lie on the triangles between the markers' places `surface_mm`: project them on the surface
    before use. A marker in no triangle (alone, or on a line) carries its force at its own place.

    Linear interpolation of samples is too flat by h^2/12 of the traction's Laplacian per direction; a twelfth
    of the markers' own differences (cotangent weights) corrects that. Without it E is 1 % too low for a patch
    five markers wide and 0.2 % for one of eight. Total force and moment do not change.
    """
    triangles, area = _cells(rest_mm[:, :2])
    cell = cell_areas(rest_mm[:, :2])
    alone = np.flatnonzero(cell == 0)
    points = np.einsum("rk,mkx->mrx", RULE, surface_mm[triangles]).reshape(-1, 3)
    load = (area[:, None, None] / len(RULE) * RULE) / cell[triangles][:, None, :]
    rows = np.concatenate([np.repeat(np.arange(len(points)), 3), len(points) + np.arange(len(alone))])
    columns = np.concatenate([np.repeat(triangles[:, None, :], len(RULE), axis=1).ravel(), alone])
    values = np.concatenate([load.ravel(), np.ones(len(alone))])
    points = np.vstack([points, surface_mm[alone]])
    spread = csr_array((values, (rows, columns)), shape=(len(points), len(rest_mm)))
    sharpened = eye_array(len(rest_mm)) + _differences(rest_mm[:, :2], triangles) / 12
    return points, csr_array(spread @ sharpened)


def cell_areas(rest_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """The area (mm2) of gel that each marker represents within the hull of all; zero without a triangle.

    A grid of 3 x 3 markers, 2 mm apart: the hull has 16 mm2.

    >>> grid = np.array([[x, y] for x in (0.0, 2, 4) for y in (0.0, 2, 4)])
    >>> cell_areas(grid)
    array([1., 2., 1., 2., 4., 2., 1., 2., 1.])
    """
    triangles, area = _cells(rest_mm)
    shares = np.repeat(area / 3, 3)
    return np.bincount(triangles.ravel(), shares, minlength=len(rest_mm)).astype(float)


def _differences(flat_mm: Float[np.ndarray, "n 2"], triangles: Int[np.ndarray, "m 3"]) -> csr_array:
    """Minus the Laplacian of values at the markers, times the cell: half the cotangents of opposite angles.

    Pinkall and Polthier (1993). Halved once more, since every place is covered by two triangulations.
    """
    corner = flat_mm[triangles]
    blocks = np.zeros((len(triangles), 3, 3))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        u, v = corner[:, i] - corner[:, k], corner[:, j] - corner[:, k]
        weight = (u * v).sum(axis=1) / np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 4
        blocks[:, i, i] += weight
        blocks[:, j, j] += weight
        blocks[:, i, j] -= weight
        blocks[:, j, i] -= weight
    rows, columns = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, (1, 3)).ravel()
    return csr_array((blocks.ravel(), (rows, columns)), shape=(len(flat_mm), len(flat_mm)))


def _cells(flat_mm: Float[np.ndarray, "n 2"]) -> tuple[Int[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Triangles between neighbouring markers and their areas; none if the markers span no area.

    The diagonals of a square grid are arbitrary, and a random choice gives its markers uneven cells. So two
    triangulations count half each: the Delaunay ones after a slight shear to either side.
    """
    if len(flat_mm) < 3 or np.linalg.matrix_rank(flat_mm - flat_mm.mean(axis=0), tol=1e-6) < 2:
        return np.empty((0, 3), dtype=np.int64), np.empty(0)
    sheared = [flat_mm + shear * flat_mm[:, ::-1] * [1.0, 0.0] for shear in (SHEAR, -SHEAR)]
    triangles = np.vstack([np.asarray(Delaunay(points).simplices, dtype=np.int64) for points in sheared])
    corners = flat_mm[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(edge_1[:, 0] * edge_2[:, 1] - edge_1[:, 1] * edge_2[:, 0])
    shortest = np.median(sides.min(axis=1))
    kept = (sides.max(axis=1) < LONGEST_SIDE * shortest) & (area > 1e-3 * np.median(area))
    return triangles[kept], 0.5 * area[kept]
