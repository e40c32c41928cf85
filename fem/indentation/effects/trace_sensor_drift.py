"""A load cell whose zero wanders: force that grows with time, touched or not."""

import numpy as np
from jaxtyping import Float

from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_effect import TraceEffect, TraceEffectSpec, Values, unknown
from fem.mismatch.effects.sensor_drift import SPEC

#: drift of a faulty load cell over that of its class, which the plain law allows for (set by hand)
FAULT = 10.0


def sensor_drift(*, class_N_per_min: float) -> TraceEffect:
    """Recorded force = true force + rate times time, of a load cell ten times worse than its class."""
    rate = unknown(SPEC, "newton_per_s", scale="linear", mean=0.0, sd=FAULT * class_N_per_min / 60)
    return TraceEffect(name=SPEC.name, unknowns=(rate,), added_N=_added_N)


def _added_N(value: Values, trace: IndenterTrace) -> Float[np.ndarray, "p t"]:
    return np.asarray(value["newton_per_s"][:, None] * (trace.time_s - trace.time_s[0]))


def _forms(trace: IndenterTrace) -> tuple[TraceEffect, ...]:
    return (sensor_drift(class_N_per_min=trace.drift_sd_N_per_min),)


EFFECT = TraceEffectSpec(spec=SPEC, rank=60, forms=_forms)
"""Its place in the search: see TraceEffectSpec."""
