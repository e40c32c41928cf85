"""The markers at rest as a regular lattice behind a smooth lens, and their misfit to it.

A camera that faces a flat gel sees the marker at the place X = (u, v) of the lattice at

    x = p + (k1 r^2) p + t,   p = H (u, v, 1),   r = |p|,
    t = (2 t1 p1 p2 + t2 (r^2 + 2 p1^2), t1 (r^2 + 2 p2^2) + 2 t2 p1 p2)

H is a homography. The lens has the first radial and both tangential terms about the picture's middle, in half
diagonals (Brown 1971, Close-range camera calibration). These are eleven numbers. Under pressure a gel bulges,
and neighbouring markers leave that place together. Printing errors are independent. The mean over neighbours
separates the two.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from tactile.markers.marker_lattice import Lattice, voted

REACH = 0.35
"""Largest distance of a neighbour from its predicted place, in spacings. Set by hand."""
ASLANT = 0.6
"""Least sine of the angle between a grid's two steps: 37 degrees. Square grids have 1, hexagonal ones
0.87."""
FARTHEST_STEP = 2.4
"""Longest step of a grid, in spacings. A square grid in a picture squeezed from 16:9 to 1:1 has 1.78; `voted`
counts steps up to 2.5."""
USUAL_MISFIT_PX = 0.5
"""Misfit above which a marker weighs less: that of printed dots, 0.35 to 0.6 px (43 empty gels,
benchmarks/gel_references.py FOLDER --half even)."""
PARAMETERS = 11
"""Parameters of the homography and the lens."""
FEWEST = 16
"""Fewest markers for PARAMETERS: 32 values, with some to spare."""
UNINDEXED = np.iinfo(np.int64).min
"""Place on the lattice of a marker that no step reaches."""


@dataclass(frozen=True)
class LensFit:
    """A lattice seen through a lens: `values` are the homography's first eight, then k1, t1 and t2."""

    values: Float[np.ndarray, "11"]
    shape: tuple[int, int]

    def places_px(self, lattice_places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Where the camera sees these places of the lattice."""
        return _seen(self.values, lattice_places, self.shape)


def lattice_places(lattice: Lattice) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Each marker's place on the grid, in steps from one in the middle, and whether it has one.

    The grid grows from neighbour to neighbour with steps that follow the picture's distortion. Scattered
    markers have no place.
    """
    places, indexed = lattice.rest_px, np.zeros(len(lattice.rest_px), dtype=bool)
    tree = cKDTree(places)
    steps = _first_steps(lattice, tree)
    grid: Int[np.ndarray, "n 2"] = np.full((len(places), 2), UNINDEXED)
    if steps is None:
        return np.zeros_like(places), indexed
    lonely = tree.query_ball_point(places, (1 + REACH) * lattice.spacing_px, return_length=True) < 4
    aside = np.linalg.norm(places - np.median(places, axis=0), axis=1)
    seed = int(np.where(lonely, aside + np.ptp(places), aside).argmin())
    grid[seed], here, queue = 0, {seed: steps}, [seed]
    taken = {(0, 0)}
    while queue:
        k = queue.pop(0)
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            place = [int(v) for v in grid[k]]
            place[axis] += sign
            away, m = tree.query(places[k] + sign * here[k][axis])
            if (place[0], place[1]) in taken or away > REACH * lattice.spacing_px or grid[m][0] != UNINDEXED:
                continue
            taken.add((place[0], place[1]))
            grid[m] = place
            now = here[k].copy()
            now[axis] = (now[axis] + sign * (places[m] - places[k])) / 2
            here[int(m)] = now
            queue.append(int(m))
    indexed = grid[:, 0] != UNINDEXED
    return np.where(indexed[:, None], grid, 0).astype(np.float64), indexed


def _first_steps(lattice: Lattice, tree: cKDTree) -> Float[np.ndarray, "2 2"] | None:
    """The two shortest common steps between neighbours, to the right and down; None if there are none."""
    pairs = tree.query_pairs(FARTHEST_STEP * lattice.spacing_px, output_type="ndarray")
    offsets = lattice.rest_px[pairs[:, 1]] - lattice.rest_px[pairs[:, 0]]
    kinds = voted(np.concatenate([offsets, -offsets]), lattice.spacing_px, most=8)
    kinds.sort(key=lambda v: float(np.linalg.norm(v)))
    for v in kinds[1:]:
        first = kinds[0]
        sine = float(first[0] * v[1] - first[1] * v[0]) / np.linalg.norm(first) / np.linalg.norm(v)
        if abs(sine) > ASLANT:
            right, down = sorted((first, v), key=lambda step: -abs(float(step[0])))
            return np.stack([right * (1 if right[0] > 0 else -1), down * (1 if down[1] > 0 else -1)])
    return None


def fitted_lens(
    lattice_places: Float[np.ndarray, "n 2"], seen_px: Float[np.ndarray, "n 2"], shape: tuple[int, int]
) -> LensFit:
    """The lens through which these places of a lattice appear at `seen_px`.

    Least squares of a soft absolute misfit: outliers weigh less. Needs FEWEST markers or more.
    """
    scale = np.abs(lattice_places).max(axis=0).clip(1e-9)
    middle, half = _frame(shape)
    plain = np.column_stack([lattice_places, np.ones(len(lattice_places))])
    affine = np.linalg.lstsq(plain, (seen_px - middle) / half, rcond=None)[0].T

    def misfit(values: Float[np.ndarray, "11"]) -> Float[np.ndarray, " m"]:
        return np.asarray((_seen(values, lattice_places, shape) - seen_px).ravel() / USUAL_MISFIT_PX)

    start = np.concatenate([affine.ravel(), np.zeros(PARAMETERS - 6)])
    unit = np.concatenate([np.tile([*(0.1 / scale), 0.1], 2), 0.01 / scale, [0.1, 0.01, 0.01]])
    fit = least_squares(misfit, start, loss="soft_l1", x_scale=unit)
    return LensFit(fit.x, shape)


def coherent_misfit_px(lattice: Lattice, off_px: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Mean misfit (px) of each marker and its neighbours: the part that they share."""
    near = lattice.nearest
    return np.asarray((off_px + off_px[near].sum(axis=1)) / (1 + near.shape[1]))


def _frame(shape: tuple[int, int]) -> tuple[Float[np.ndarray, "2"], float]:
    """The picture's middle and half its diagonal, px."""
    height, width = shape
    return np.array([(width - 1) / 2, (height - 1) / 2]), float(np.hypot(height, width) / 2)


def _seen(
    values: Float[np.ndarray, "11"], lattice_places: Float[np.ndarray, "n 2"], shape: tuple[int, int]
) -> Float[np.ndarray, "n 2"]:
    middle, half = _frame(shape)
    turned = np.column_stack([lattice_places, np.ones(len(lattice_places))])
    turned = turned @ np.append(values[:8], 1.0).reshape(3, 3).T
    p = turned[:, :2] / turned[:, 2:]
    k1, t1, t2 = values[8:]
    x, y = p.T
    r = x**2 + y**2
    bent = np.stack([2 * t1 * x * y + t2 * (r + 2 * x**2), t1 * (r + 2 * y**2) + 2 * t2 * x * y], axis=1)
    return np.asarray(middle + half * (p * (1.0 + k1 * r)[:, None] + bent))
