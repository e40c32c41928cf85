"""Where on the gel the forces of a slab act.

The force on a slab is solved for on a grid as coarse as the markers, so that a steep front can lie anywhere
between two of them: what one marker has too much of, a neighbour has too little of. Marker i and the
neighbour j(i) that it differs from most exchange PLACING of that difference,

    C = PLACING^2 sum_i |f_i - f_j(i)|^2 (e_i - e_j(i)) (e_i - e_j(i))',

component by component: the sum of all forces is left exactly as it was.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

PLACING = 0.15
"""With it 94 % of the forces of a press rendered for two cameras lie within two standard deviations, and of
those that it was not chosen on 99 % with dots alone (`benchmarks/gel_image_errors.py`)."""
NEIGHBOURS, ADJACENT = 8, 1.45
"""Neighbours at most, and how many spacings away (across a square's corner: 1.41)."""


class ForcePlacing:
    """The variances that one gel's markers get from this."""

    def __init__(self, rest_mm: Float[np.ndarray, "n 3"]) -> None:
        tree = cKDTree(rest_mm)
        spacing = float(np.median(np.asarray(tree.query(rest_mm, k=2)[0])[:, 1]))
        _, nearest = tree.query(rest_mm, k=NEIGHBOURS + 1, distance_upper_bound=ADJACENT * spacing)
        near, markers = np.asarray(nearest), np.arange(len(rest_mm))[:, None]
        self._near: Int[np.ndarray, "n k"] = np.where(near < len(rest_mm), near, markers)

    def sd_N(self, force_N: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Standard deviation of every marker's force in one frame."""
        differ = np.abs(force_N[self._near] - force_N[:, None])
        partner = np.take_along_axis(self._near, differ.argmax(axis=1), axis=1)
        exchanged = (PLACING * differ.max(axis=1)) ** 2
        variance = exchanged.copy()
        np.add.at(variance, (partner, np.arange(3)), exchanged)
        return np.asarray(np.sqrt(variance))
