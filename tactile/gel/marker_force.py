"""Forces marker by marker: of a bed of springs, and where on the gel a slab's act.

A thin gel whose stiffness per area was measured (normal kn, shear kt) gives way point by point:

    f = -A (kt u_x, kt u_y, kn u_z)

with A the marker's share of the face. Nothing has to be inverted and nothing smoothed; noise of displacement
is noise of force, sample by sample, pressed or not.

The force on a slab is solved for on a grid as coarse as the markers, so that a steep front can lie anywhere
between two of them: what one marker has too much of, a neighbour has too little of. Marker i and the
neighbour j(i) that it differs from most exchange PLACING of that difference,

    C = PLACING^2 sum_i |f_i - f_j(i)|^2 (e_i - e_j(i)) (e_i - e_j(i))',

component by component: the sum of all forces is left exactly as it was.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from tactile.gel.slab import SpringBed

TOUCHES_AT_SD = 4.0
"""A marker touches where it is pressed in by so many standard deviations of its noise: one in 30,000 by
chance."""
PLACING = 0.15
"""With it 94 % of the forces of a press rendered for two cameras lie within two standard deviations, and of
those that it was not chosen on 99 % with dots alone (`benchmarks/gel_image_errors.py`)."""
NEIGHBOURS, ADJACENT = 8, 1.45
"""Neighbours at most, and how many spacings away (across a square's corner: 1.41)."""


@dataclass(frozen=True, kw_only=True)
class SpringForce:
    """Springs under markers; `information_per_mm2` (n, 3, 3) is the inverse covariance of displacement."""

    layer: SpringBed
    cell_mm2: float
    information_per_mm2: Float[np.ndarray, "n 3 3"]

    @property
    def newton_per_mm(self) -> Float[np.ndarray, "3"]:
        """Stiffness of one marker's share of the face."""
        kn, kt = self.layer.kn_MPa_per_mm, self.layer.kt_MPa_per_mm
        return self.cell_mm2 * np.array([kt, kt, kn])

    @property
    def displacement_sd_mm(self) -> Float[np.ndarray, "n 3"]:
        """Standard deviations of one frame's displacement."""
        return np.asarray(np.sqrt(np.diagonal(self._covariance, axis1=1, axis2=2)))

    def force_N(self, displacement_mm: Float[np.ndarray, "... n 3"]) -> Float[np.ndarray, "... n 3"]:
        """Force on the fruit; NaN displacement (a marker not seen) is no force."""
        return np.asarray(np.nan_to_num(-self.newton_per_mm * displacement_mm))

    def touching(self, displacement_mm: Float[np.ndarray, "... n 3"]) -> Bool[np.ndarray, "... n"]:
        """Markers that are pressed in by more than noise."""
        pressed = np.nan_to_num(displacement_mm[..., 2])
        return np.asarray(pressed < -TOUCHES_AT_SD * self.displacement_sd_mm[:, 2])

    @property
    def _covariance(self) -> Float[np.ndarray, "n 3 3"]:
        return np.asarray(np.linalg.pinv(self.information_per_mm2, hermitian=True))


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
