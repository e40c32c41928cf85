"""The markers at rest as a regular lattice seen through a smooth lens, and how far they are from it.

With X = (u, v) a marker's place on its lattice, a camera that looks at a flat face has it at

    x = p + (k1 r^2) p + t,   p = H (u, v, 1),   r = |p|,
    t = (2 t1 p1 p2 + t2 (r^2 + 2 p1^2), t1 (r^2 + 2 p2^2) + 2 t2 p1 p2)

(a homography H, then Brown and Conrady's first radial and the tangential terms about the picture's middle, in
half diagonals: Brown 1971, Close-range camera calibration): eleven numbers. A gel that is pressed bulges, and
its markers leave that place together; printing leaves each of them off by itself. Neighbours' mean tells the
two apart.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from tactile.markers.marker_lattice import Lattice, voted

REACH = 0.35
"""Of the spacing: a neighbour is looked for within this distance of where the steps so far put it. Set by
hand."""
ASLANT = 0.6
"""Least sine of the angle of a grid's two steps: 37 degrees; a square one has 1, a hexagonal one 0.87."""
FARTHEST_STEP = 2.4
"""Of the spacing: a grid's longer step is at most this long. A square grid in a picture that was squeezed
from 16:9 to 1:1 has 1.78; `voted` counts steps up to 2.5."""
USUAL_MISFIT_PX = 0.5
"""Misfit from which on a marker weighs less: what printed dots have of themselves, 0.35 to 0.6 px (43 empty
gels, benchmarks/gel_references.py FOLDER --half even)."""
PARAMETERS = 11
"""Of the lens and the homography."""
FEWEST = 16
"""Markers that tell PARAMETERS with some to spare: 32 values."""
UNINDEXED = np.iinfo(np.int64).min
"""Place on the lattice of a marker that no step reaches."""


@dataclass(frozen=True)
class LensFit:
    """A lattice seen through a lens: `values` are the homography's first eight and the lens's three."""

    values: Float[np.ndarray, "11"]
    shape: tuple[int, int]

    def places_px(self, lattice_places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Where the camera has these places of the lattice."""
        return _seen(self.values, lattice_places, self.shape)


def lattice_places(lattice: Lattice) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Each marker's place on the grid, in steps from one in the middle, and whether it has one.

    Grown from neighbour to neighbour with steps that follow the picture's distortion. No marker has a place
    where they are scattered.
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
    """The two shortest common steps between neighbours, to the right and down; None where they have none."""
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
    """The lens that has these places of a lattice where they are seen; markers far off weigh less.

    Least squares of a soft absolute misfit. Needs FEWEST markers or more.
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
    """Mean of each marker's and its neighbours' misfit (px): what they have in common."""
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
