"""Effects of the machine: compliance of the rig, and drift of the load cell's zero."""

import numpy as np

from fem.indentation.trace_effect import TraceEffect, unknown
from fem.mismatch.effects import gripper_compliance, sensor_drift

#: prior median of the machine's stiffness (N/mm), and the standard deviation of its logarithm: grippers
#: with soft pads have 8 N/mm, arms 10 to 50, presses on a frame hundreds to thousands (set by hand)
MACHINE_N_PER_MM, MACHINE_SD = 100.0, 1.5
#: drift of a faulty load cell over that of its class, which the plain law includes (set by hand)
FAULT = 10.0

_COMPLIANCE = unknown(
    gripper_compliance.SPEC, "mm_per_N", scale="log", mean=-float(np.log(MACHINE_N_PER_MM)), sd=MACHINE_SD
)
GRIPPER_COMPLIANCE = TraceEffect(
    name=gripper_compliance.SPEC.name,
    unknowns=(_COMPLIANCE,),
    give_mm=lambda value, trace: value["mm_per_N"][:, None] * (trace.force_N - value["zero_N"][:, None]),
)
"""True depth = travel - c F, with the measured F."""


def drift_of_cell(*, class_N_per_min: float) -> TraceEffect:
    """Recorded force = true force + rate times time, for a load cell ten times worse than its class."""
    spec = sensor_drift.SPEC
    rate = unknown(spec, "newton_per_s", scale="linear", mean=0.0, sd=FAULT * class_N_per_min / 60)
    return TraceEffect(
        name=spec.name,
        unknowns=(rate,),
        added_N=lambda value, trace: value["newton_per_s"][:, None] * (trace.time_s - trace.time_s[0]),
    )
