"""Linear elasticity of a geometry, with what is never a finding: onset, zero, error of the theory."""

import numpy as np

from fem.indentation.contact_law import Law, suffix_of
from fem.indentation.no_contact import first_touch
from fem.indentation.trace import IndenterTrace
from fem.indentation.unknowns import Unknown

#: prior sd of the exponent that bends the force-depth curve: 7 % of the force at a depth of R, for strains
#: that are small no more, a ball that is not quite one, friction under it
BEND_SD = 0.1
#: prior sd of the onset over the travel, and of the zero over the peak force
ONSET_SD, ZERO_SD = 0.15, 0.05


def linear_law(trace: IndenterTrace, *, thickness_mm: float | None, poisson_ratio: float) -> Law:
    """E, the travel at first touch, the load cell's zero, and `bend`: force times (1 + d/length)^bend."""
    curve = trace.geometry.curve(thickness_mm=thickness_mm, poisson_ratio=poisson_ratio)
    own = [_own(part, k) for k, part in enumerate(trace.parts)]
    peaks = [float(np.abs(part.force_N).max()) for part in trace.parts]
    guesses = [
        peak / float(curve.force_N_per_MPa(np.array(max(float(part.travel_mm.max()) - one[0].mean, 1e-3))))
        for part, one, peak in zip(trace.parts, own, peaks, strict=True)
    ]
    guess = float(np.exp(np.mean(np.log(guesses))))
    return Law(
        curve=curve,
        baseline=(
            Unknown(name="E_MPa", unit="MPa", scale="log", mean=float(np.log(guess)), sd=2.0),
            *(unknown for both in own for unknown in both),
            Unknown(name="bend", unit="1", scale="linear", mean=0.0, sd=BEND_SD),
        ),
    )


def _own(trace: IndenterTrace, number: int) -> tuple[Unknown, Unknown]:
    """First touch and zero of one recording."""
    touch = first_touch(trace)
    onset_mm = float(trace.travel_mm[max(touch - 1, 0)])
    peak = float(np.abs(trace.force_N).max())
    zero = float(np.median(trace.force_N[: max(touch - 1, 1)]))
    spread = float(np.ptp(trace.travel_mm))
    at = suffix_of(number)
    return (
        Unknown(name=f"onset_mm{at}", unit="mm", scale="linear", mean=onset_mm, sd=ONSET_SD * spread),
        Unknown(name=f"zero_N{at}", unit="N", scale="linear", mean=zero, sd=ZERO_SD * peak),
    )
