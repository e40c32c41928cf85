"""A machine that gives way: the recorded travel is more than the ball's."""

import numpy as np

from fem.indentation.effects.trace_effect import TraceEffect
from fem.indentation.unknowns import Unknown

NAME = "gripper_compliance"


def gripper_compliance(*, specimen_mm_per_N: float) -> TraceEffect:
    """True depth = travel - c F with the measured F; c is a few per cent of the specimen's own give."""
    mean = float(np.log(0.05 * specimen_mm_per_N))
    return TraceEffect(
        name=NAME, unknowns=(Unknown(name="mm_per_N", unit="mm/N", scale="log", mean=mean, sd=1.2),)
    )
