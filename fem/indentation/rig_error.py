"""What no law of the flesh can explain of a trace whose rig was taken off: the error of the rig's own
shape."""

import numpy as np

from fem.indentation.trace import IndenterTrace

SHAPE = 0.3
"""Of the rig's standard deviation, what is no scale of its curve. Set by hand: of three squeezes of a spring
in series with Hertz's contact the curve is 0.016 mm off at the first touch, where its standard deviation at
the largest force is 0.057 mm (tests/pipeline/test_calibrate_rig.py)."""
STEEPER = 1.5
"""Relative change of a ball's force over that of its depth (Hertz)."""
AT_LEAST = 0.05
"""Share of the peak force above which the ball counts as in contact. Set by hand, as the noise's floor."""


def rig_error(trace: IndenterTrace) -> float:
    """Least share of the force that is left unexplained; 0 where no rig was taken off.

    STEEPER SHAPE sd / d at the peak, d the depth there: the travel since a twentieth of the peak force.
    """
    if trace.rig_sd_mm is None:
        return 0.0
    if len(trace.parts) > 1:
        return max(rig_error(part) for part in trace.parts)
    peak = int(np.argmax(trace.force_N))
    below = np.flatnonzero(trace.force_N[: peak + 1] < AT_LEAST * trace.force_N[peak])
    start = int(below[-1]) if len(below) else 0
    depth = max(float(trace.travel_mm[peak] - trace.travel_mm[start]), 1e-6)
    return float(STEEPER * SHAPE * trace.rig_sd_mm[peak] / depth)
