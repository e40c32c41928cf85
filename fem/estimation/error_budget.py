"""Uncertain inputs beyond noise: the prior standard deviation of every cause that changes a modulus."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import PIT_OFFSET, PIT_SIZE, POISSON_RATIO, SURFACE
from fem.grasp_history import GraspHistory

#: the parts of an error bar, as they are reported
TACTILE, REGISTRATION, PIT_PLACE, DISCRETISATION, MODEL, SCATTER = (
    "tactile noise",
    "registration and mesh",
    "pit offset",
    "discretisation",
    "misfit of the model",
    "scatter between grasps",
)


@dataclass(frozen=True, kw_only=True)
class ErrorBudget:
    """Standard deviations of inputs that the measurement itself does not determine.

    `gel_scale_sd`, `force_scale_sd`: relative scale errors of single markers, of their displacement and of
    their force; above zero. Their defaults are assumed, for a calibrated marker gel. A batch may set them
    from its own sensor's calibration.

    `pit_offset_sd_mm` (each axis), `pit_size_sd`: spread of the pit prior (centre; relative size).
    `surface_sd_mm`: error of the fruit's surface mesh, if that of a pad's patch is not known
    (PadHistory.surface_sd_mm). `pose_sd_mm`: error of a pad's place along the skin. `poisson_ratio_sd`:
    spread of Poisson's ratio, zero if it is given. The discretisation error is not here: it is measured on
    every mesh (fem.solid.discretisation_error).
    """

    gel_scale_sd: float = 0.004
    force_scale_sd: float = 0.01
    pit_offset_sd_mm: float = 0.5
    pit_size_sd: float = 0.03
    surface_sd_mm: float = 0.1
    pose_sd_mm: float = 0.3
    poisson_ratio_sd: float = 0.0

    def surface_under_pads_mm(self, history: GraspHistory) -> Float[np.ndarray, " p"]:
        """Standard deviation of the mesh's error under each pad: of its patch, or else of the whole mesh."""
        known = (pad.surface_sd_mm for pad in history.pads)
        return np.array([self.surface_sd_mm if sd is None else sd for sd in known])

    def sd_of(self, cause: str, *, history: GraspHistory | None = None) -> float:
        """Prior standard deviation of a cause of fem.estimation.sensitivity, in its unit.

        The waves of a recording's surface (`history`) have the root mean square of the standard deviations
        under its pads, sqrt(sum_p sd_p² / P): the mesh's error affects E only there.
        """
        if cause in SURFACE and history is not None and history.pads:
            return float(np.sqrt(np.mean(self.surface_under_pads_mm(history) ** 2) / 3))
        if cause in PIT_OFFSET:
            return self.pit_offset_sd_mm
        if cause in (PIT_SIZE, POISSON_RATIO):
            return self.pit_size_sd if cause == PIT_SIZE else self.poisson_ratio_sd
        return self.surface_sd_mm / 3**0.5 if cause in SURFACE else self.pose_sd_mm


def part_of(cause: str) -> str:
    """The name of a cause's share of the error bar in reports."""
    if cause in PIT_OFFSET:
        return PIT_PLACE
    return cause if cause in (PIT_SIZE, POISSON_RATIO) else REGISTRATION
