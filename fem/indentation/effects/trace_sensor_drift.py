"""A load cell whose zero wanders: force that grows with time, touched or not."""

import numpy as np
from jaxtyping import Float

from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_effect import TraceEffect, TraceEffectSpec, Values, unknown
from fem.mismatch.effects.sensor_drift import SPEC


def sensor_drift(*, force_N: float, duration_s: float) -> TraceEffect:
    """Recorded force = true force + rate times time; some five per cent of the peak over the recording."""
    rate = unknown(SPEC, "newton_per_s", scale="linear", mean=0.0, sd=0.05 * force_N / duration_s)
    return TraceEffect(name=SPEC.name, unknowns=(rate,), added_N=_added_N)


def _added_N(value: Values, trace: IndenterTrace) -> Float[np.ndarray, "p t"]:
    return np.asarray(value["newton_per_s"][:, None] * (trace.time_s - trace.time_s[0]))


def _forms(trace: IndenterTrace) -> tuple[TraceEffect, ...]:
    peak = float(np.abs(trace.force_N).max())
    duration = float(trace.elapsed_s.max())
    return (sensor_drift(force_N=peak, duration_s=duration),)


EFFECT = TraceEffectSpec(spec=SPEC, rank=60, forms=_forms)
"""Its place in the search: see TraceEffectSpec."""
