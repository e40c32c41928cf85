"""What is not known exactly, beyond noise: the prior spread of every cause that moves a modulus."""

from dataclasses import dataclass

from fem.grasp_sensitivity import PIT_OFFSET, PIT_SIZE, POISSON_RATIO, SURFACE

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
    """Standard deviations of what the measurement itself does not show.

    `gel_scale_sd`, `force_scale_sd`: relative scale errors of single markers, of their displacement and of
    their force. Their defaults are assumed, for a calibrated marker gel, and not measured on any one sensor:
    a batch may set them from its own sensor's calibration.

    `pit_offset_sd_mm` (each axis), `pit_size_sd`: spread of the pit prior (centre; relative size).
    `surface_sd_mm`: error of the fruit's surface mesh. `pose_sd_mm`: error of a pad's place along
    the skin. `poisson_ratio_sd`: spread of Poisson's ratio, zero where it is given. The size of elements is
    not here: it is measured on every mesh (fem.discretisation).
    """

    gel_scale_sd: float = 0.004
    force_scale_sd: float = 0.01
    pit_offset_sd_mm: float = 0.5
    pit_size_sd: float = 0.03
    surface_sd_mm: float = 0.1
    pose_sd_mm: float = 0.3
    poisson_ratio_sd: float = 0.0

    def __post_init__(self) -> None:
        if not self.gel_scale_sd > 0:
            raise ValueError(f"gel_scale_sd is {self.gel_scale_sd:g}, expected above zero; no scale is exact")

    def sd_of(self, cause: str) -> float:
        """Prior standard deviation of a cause of fem.grasp_sensitivity, in its unit."""
        if cause in PIT_OFFSET:
            return self.pit_offset_sd_mm
        if cause in (PIT_SIZE, POISSON_RATIO):
            return self.pit_size_sd if cause == PIT_SIZE else self.poisson_ratio_sd
        return self.surface_sd_mm / 3**0.5 if cause in SURFACE else self.pose_sd_mm


def part_of(cause: str) -> str:
    """Under which name a cause's share of the error bar is reported."""
    if cause in PIT_OFFSET:
        return PIT_PLACE
    return cause if cause in (PIT_SIZE, POISSON_RATIO) else REGISTRATION
