"""What a bare ball indenter recorded: force over travel and time, checked."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure, FemProblem

#: fewest frames that a fit with a dozen unknowns can be asked to explain
FEWEST_FRAMES = 20
#: travel slower than this share of the fastest counts as standing still
STILL = 0.05


@dataclass(frozen=True, kw_only=True)
class IndenterTrace:
    """Force that pushes the ball back (positive in contact) and how far the machine has driven it in.

    `travel_mm` is the machine's own reading: contact may start later than travel, or before the first frame.
    Where the rig's own give was taken off it, `rig_give_mm` is that, `rig_sd_mm` its standard deviation,
    which all frames share.
    Raises FemFailure (bad-load) where arrays differ in length, hold what is no number, or time runs back.
    """

    time_s: Float[np.ndarray, " t"]
    force_N: Float[np.ndarray, " t"]
    travel_mm: Float[np.ndarray, " t"]
    radius_mm: float
    rig_give_mm: Float[np.ndarray, " t"] | None = None
    rig_sd_mm: Float[np.ndarray, " t"] | None = None

    def __post_init__(self) -> None:
        frames = len(self.time_s)
        if not frames == len(self.force_N) == len(self.travel_mm):
            raise FemFailure(
                FemProblem.BAD_LOAD,
                f"indenter trace: found {frames} times, {len(self.force_N)} forces and "
                f"{len(self.travel_mm)} travels, expected as many of each: export them from one table.",
            )
        for name in ("rig_give_mm", "rig_sd_mm"):
            values = getattr(self, name)
            if values is not None and (len(values) != frames or not np.isfinite(values).all()):
                raise FemFailure(
                    FemProblem.BAD_LOAD,
                    f"indenter trace: found {name} that is not one finite number a frame, expected {frames}: "
                    "convert the trace again with --rig.",
                )
        if frames < FEWEST_FRAMES:
            raise FemFailure(
                FemProblem.BAD_LOAD,
                f"indenter trace: found {frames} frames, expected at least {FEWEST_FRAMES}: record longer.",
            )
        for name in ("time_s", "force_N", "travel_mm"):
            if not np.isfinite(getattr(self, name)).all():
                raise FemFailure(
                    FemProblem.BAD_LOAD,
                    f"indenter trace: found {name} that is not finite, expected numbers: drop those frames.",
                )
        if (np.diff(self.time_s) <= 0).any():
            first = int(np.argmax(np.diff(self.time_s) <= 0)) + 1
            raise FemFailure(
                FemProblem.BAD_LOAD,
                f"indenter trace: found time {self.time_s[first]:g} s after {self.time_s[first - 1]:g} s, "
                "expected strictly increasing times: sort the frames.",
            )
        if self.radius_mm <= 0:
            raise FemFailure(
                FemProblem.BAD_LOAD,
                f"indenter trace: found radius {self.radius_mm:g} mm, expected more than 0: give the ball's.",
            )

    @property
    def phases(self) -> tuple[str, ...]:
        """Per frame "load" (driven in), "hold" (standing) or "unload" (drawn back)."""
        rate = np.gradient(self.travel_mm, self.time_s)
        limit = STILL * float(np.max(np.abs(rate)))
        return tuple("load" if v > limit else "unload" if v < -limit else "hold" for v in rate)
