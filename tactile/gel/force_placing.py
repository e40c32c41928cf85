"""Where on the gel a marker's force acts: what one marker has too much of, a neighbour has too little of.

Force is solved for on a grid as coarse as the markers, so that a steep front can lie anywhere between two of
them. Marker i and the neighbour j(i) that it differs from most exchange PLACING of that difference,

    C = PLACING^2 sum_i |f_i - f_j(i)|^2 (e_i - e_j(i)) (e_i - e_j(i))',

component by component: the sum of all forces is left exactly as it was.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

PLACING = 0.15
"""With it 94 % of the forces of a press rendered for two cameras lie within two standard deviations, and of
those that it was not chosen on 96 % with shading, 99 % with dots alone (`benchmarks/gel_image_errors.py`)."""
NEIGHBOURS, ADJACENT = 8, 1.45
"""Neighbours at most, and how many spacings away (across a square's corner: 1.41)."""


class ForcePlacing:
    """The covariance that one gel's markers get from this."""

    def __init__(self, rest_mm: Float[np.ndarray, "n 3"]) -> None:
        tree = cKDTree(rest_mm)
        spacing = float(np.median(np.asarray(tree.query(rest_mm, k=2)[0])[:, 1]))
        _, found = tree.query(rest_mm, k=NEIGHBOURS + 1, distance_upper_bound=ADJACENT * spacing)
        near, own = np.asarray(found), np.arange(len(rest_mm))[:, None]
        self._near: Int[np.ndarray, "n k"] = np.where(near < len(rest_mm), near, own)

    def sd_N(self, force_N: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Standard deviation of every marker's force in one frame."""
        partner, exchanged = self._exchanged(force_N)
        variance = exchanged.copy()
        for axis in range(3):
            np.add.at(variance[:, axis], partner[:, axis], exchanged[:, axis])
        return np.asarray(np.sqrt(variance))

    def covariance_N2(self, force_N: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3*n 3*n"]:
        """Joint covariance of all forces in one frame, markers then x, y, z."""
        n = len(force_N)
        partner, exchanged = self._exchanged(force_N)
        total = np.zeros((n, 3, n, 3))
        own = np.arange(n)
        for axis in range(3):
            other, much = partner[:, axis], exchanged[:, axis]
            for a, b, sign in ((own, own, 1), (other, other, 1), (own, other, -1), (other, own, -1)):
                np.add.at(total[:, axis, :, axis], (a, b), sign * much)
        return total.reshape(3 * n, 3 * n)

    def _exchanged(
        self, force_N: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Each marker's j(i), and the variance that the two exchange."""
        differ = np.abs(force_N[self._near] - force_N[:, None])
        partner = np.take_along_axis(self._near, differ.argmax(axis=1), axis=1)
        return partner, (PLACING * differ.max(axis=1)) ** 2
