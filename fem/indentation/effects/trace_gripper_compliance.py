"""A machine that gives way: the recorded travel is more than the ball's."""

import numpy as np
from jaxtyping import Float

from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_effect import TraceEffect, TraceEffectSpec, Values, unknown
from fem.mismatch.effects.gripper_compliance import SPEC

#: prior median of the machine's stiffness (N/mm), and the standard deviation of its logarithm: grippers
#: with soft pads have 8 N/mm, arms 10 to 50, presses on a frame hundreds to thousands (set by hand)
MACHINE_N_PER_MM, MACHINE_SD = 100.0, 1.5


def _give_mm(value: Values, trace: IndenterTrace) -> Float[np.ndarray, "p t"]:
    pushing = trace.force_N - value["zero_N"][:, None]
    return np.asarray(value["mm_per_N"][:, None] * pushing)


GRIPPER_COMPLIANCE = TraceEffect(
    name=SPEC.name,
    unknowns=(unknown(SPEC, "mm_per_N", scale="log", mean=-float(np.log(MACHINE_N_PER_MM)), sd=MACHINE_SD),),
    give_mm=_give_mm,
)
"""True depth = travel - c F with the measured F."""
EFFECT = TraceEffectSpec(spec=SPEC, rank=50, forms=lambda _: (GRIPPER_COMPLIANCE,))
"""Its place in the search: see TraceEffectSpec."""
