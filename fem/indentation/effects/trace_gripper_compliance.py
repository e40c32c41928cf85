"""A machine that gives way: the recorded travel is more than the ball's."""

import numpy as np
from jaxtyping import Float

from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_effect import TraceEffect, TraceEffectSpec, Values, unknown
from fem.mismatch.effects.gripper_compliance import SPEC


def gripper_compliance(*, specimen_mm_per_N: float) -> TraceEffect:
    """True depth = travel - c F with the measured F; c is a few per cent of the specimen's own give."""
    mean = float(np.log(0.05 * specimen_mm_per_N))
    return TraceEffect(
        name=SPEC.name,
        unknowns=(unknown(SPEC, "mm_per_N", scale="log", mean=mean, sd=1.2),),
        give_mm=_give_mm,
    )


def _give_mm(value: Values, trace: IndenterTrace) -> Float[np.ndarray, "p t"]:
    pushing = trace.force_N - value["zero_N"][:, None]
    return np.asarray(value["mm_per_N"][:, None] * pushing)


def _forms(trace: IndenterTrace) -> tuple[TraceEffect, ...]:
    peak = float(np.abs(trace.force_N).max())
    travel = float(np.ptp(trace.travel_mm))
    return (gripper_compliance(specimen_mm_per_N=travel / peak),)


EFFECT = TraceEffectSpec(spec=SPEC, rank=50, forms=_forms)
"""Its place in the search: see TraceEffectSpec."""
