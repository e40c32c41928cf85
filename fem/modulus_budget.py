"""What a modulus may be off by beyond noise, each part with its source."""

from dataclasses import dataclass

import numpy as np

DISCRETISATION_SD = 0.003
"""Relative spread of E between meshes with edges of 1 to 3 mm at the pads and 4 to 6.5 mm inside."""
PER_MM_OF_PIT_OFFSET = 0.005
"""Two pads: 0.1 % per mm, what one side gains the other loses. One pad on a base has no other side."""
PER_PIT_SIZE = 0.35
"""A pit 3 % larger than it is makes E 0.7 to 1.35 % too low (root mean square 1.0 %)."""
PER_MM_OF_SURFACE = 0.05
"""Smooth waves of 0.15 mm, some 15 mm long, change E by 0 to 0.7 %; the whole surface 0.15 mm out, by 0.3
%."""
PER_POISSON_RATIO = 1.05
"""Nu 0.01 higher makes E 1.05 % lower, near nu 0.45."""


@dataclass(frozen=True, kw_only=True)
class ErrorBudget:
    """Standard deviations of what the measurement itself does not show.

    `gel_scale_sd`, `force_scale_sd`: relative scale errors of single markers, of their displacement and of
    their force. Their defaults are assumed, for a calibrated marker gel, and not measured on any one sensor:
    a batch may set them from its own sensor's calibration.

    `pit_offset_sd_mm`, `pit_size_sd`: spread of the pit prior (centre; relative size). `surface_sd_mm`: error
    of the fruit's surface mesh. `poisson_ratio_sd`: spread of Poisson's ratio, zero where it is given.

    What they do to E was measured on recorded grasps of a plum and a nectarine by changing one thing at a
    time: `benchmarks/modulus_sensitivity.py` prints it. A fruit 1 % too large, moved by 1 mm or turned by 3
    degrees against the pads changes E by 0.2 % and is within the discretisation's share.
    """

    gel_scale_sd: float = 0.004
    force_scale_sd: float = 0.01
    pit_offset_sd_mm: float = 0.5
    pit_size_sd: float = 0.03
    surface_sd_mm: float = 0.1
    poisson_ratio_sd: float = 0.0

    @property
    def model_sd(self) -> float:
        """Relative standard deviation of E from mesh, surface, pit prior and Poisson's ratio together."""
        return float(np.linalg.norm(list(self.parts.values())))

    @property
    def parts(self) -> dict[str, float]:
        """The relative standard deviation of E that each cause brings."""
        return {
            "discretisation": DISCRETISATION_SD,
            "pit offset": PER_MM_OF_PIT_OFFSET * self.pit_offset_sd_mm,
            "pit size": PER_PIT_SIZE * self.pit_size_sd,
            "surface": PER_MM_OF_SURFACE * self.surface_sd_mm,
            "Poisson's ratio": PER_POISSON_RATIO * self.poisson_ratio_sd,
        }
