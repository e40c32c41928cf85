"""A load cell whose zero wanders: force that grows with time, touched or not."""

from fem.indentation.effects.trace_effect import TraceEffect
from fem.indentation.unknowns import Unknown

NAME = "sensor_drift"


def sensor_drift(*, force_N: float, duration_s: float) -> TraceEffect:
    """Recorded force = true force + rate times time; some five per cent of the peak over the recording."""
    unknown = Unknown(
        name="newton_per_s", unit="N/s", scale="linear", mean=0.0, sd=0.05 * force_N / duration_s
    )
    return TraceEffect(name=NAME, unknowns=(unknown,))
