"""Force of a gel that is a bed of springs: what each marker's own displacement says, and nothing else.

A thin gel whose stiffness per area was measured (normal kn, shear kt) gives way point by point:

    f = -A (kt u_x, kt u_y, kn u_z)

with A the marker's share of the face. Nothing has to be inverted and nothing smoothed; noise of displacement
is noise of force, sample by sample, pressed or not.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tactile.gel.slab import SpringBed

TOUCHES_AT_SD = 4.0
"""A marker touches where it is pressed in by so many standard deviations of its noise: one in 30,000 by
chance."""


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

    def joint_covariance(self) -> Float[np.ndarray, "d d"]:
        """Covariance of any frame's [displacement (mm); force (N)], markers then x, y, z."""
        n = len(self.information_per_mm2)
        blocks = np.zeros((n, 3, n, 3))
        blocks[np.arange(n), :, np.arange(n)] = self._covariance
        noise = blocks.reshape(3 * n, 3 * n)
        gain = np.tile(-self.newton_per_mm, n)
        return np.block([[noise, noise * gain], [gain[:, None] * noise, gain[:, None] * noise * gain]])

    @property
    def _covariance(self) -> Float[np.ndarray, "n 3 3"]:
        return np.asarray(np.linalg.pinv(self.information_per_mm2, hermitian=True))
