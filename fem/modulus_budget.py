"""What a modulus may be off by beyond noise, each part with its source."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class ErrorBudget:
    """Standard deviations of what the measurement itself does not show.

    `gel_scale_sd`, `force_scale_sd`: relative scale errors of single markers, 0.4 % and 1 %.
    `pit_offset_sd_mm`, `pit_size_sd`: spread of the pit prior (centre per axis; relative size).
    `surface_sd_mm`: error of the fruit's surface mesh. The relative spread of E that they cause is
    `model_sd`; its coefficients are the root mean square changes of E over the grasps of four fruits (plum to
    large nectarine) when a pit is moved, grown, or the surface waved by that much: see
    `benchmarks/modulus_sensitivity.py`, which prints them.
    """

    gel_scale_sd: float = 0.004
    force_scale_sd: float = 0.01
    pit_offset_sd_mm: float = 0.5
    pit_size_sd: float = 0.03
    surface_sd_mm: float = 0.1

    @property
    def model_sd(self) -> float:
        """Relative standard deviation of E from mesh, surface and pit prior together."""
        parts = [
            DISCRETISATION_SD,
            PER_MM_OF_PIT_OFFSET * self.pit_offset_sd_mm,
            PER_PIT_SIZE * self.pit_size_sd,
            PER_MM_OF_SURFACE * self.surface_sd_mm,
        ]
        return float(np.sqrt(np.sum(np.square(parts))))


DISCRETISATION_SD = 0.004
"""Spread of E between meshes with edges of 1 to 2.5 mm at the pads."""
PER_MM_OF_PIT_OFFSET = 0.01
PER_PIT_SIZE = 0.3
PER_MM_OF_SURFACE = 0.04
