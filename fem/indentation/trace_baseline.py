"""The plain law of a geometry, with its nuisances: onset, toe, zero, drift, ends, and the theory's error."""

import numpy as np

from fem.indentation.contact_law import Law, suffix_of
from fem.indentation.no_contact import first_touch
from fem.indentation.trace import IndenterTrace
from fem.indentation.unknowns import Unknown

#: prior sd of the exponent that bends the force-depth curve: 7 % of the force at a depth of R, for strains
#: that are small no more, a ball that is not quite one, friction under it
BEND_SD = 0.1
#: prior sd of the onset over the travel, and of the zero of a load cell over the peak force (set by hand)
ONSET_SD, ZERO_SD = 0.15, 0.005
#: prior sd of the logarithm of the toe's width: a factor of 2.7 either way
TOE_SD = 1.0
#: prior sd on the logit of `ends_held`: flat from 0.1 to 0.9, with tails that reach sliding and held ends
ENDS_SD = 1.7


def linear_law(trace: IndenterTrace, *, thickness_mm: float | None, poisson_ratio: float) -> Law:
    """The geometry's curve with its nuisances.

    Common to all recordings: E; `bend`, force times (1 + d/length)^bend; the load cell's drift
    (`trace.drift_sd_N_per_min`); where the ends are not known `ends_held`, from 0 (sliding) to 1 (held).
    Of each recording: the travel at first touch, the cell's zero, and of flat ends the toe, the width over
    which first touches are spread.
    """
    curve = trace.geometry.curve(thickness_mm=thickness_mm, poisson_ratio=poisson_ratio)
    own = [_own(part, k, curve.toe_mm) for k, part in enumerate(trace.parts)]
    peaks = [float(np.abs(part.force_N).max()) for part in trace.parts]
    guesses = [
        peak
        / float(curve.force_N_per_MPa(np.array(max(float(part.travel_mm.max()) - unknowns[0].mean, 1e-3))))
        for part, unknowns, peak in zip(trace.parts, own, peaks, strict=True)
    ]
    guess = float(np.exp(np.mean(np.log(guesses))))
    drift = Unknown(
        name="drift_N_per_min", unit="N/min", scale="linear", mean=0.0, sd=trace.drift_sd_N_per_min
    )
    ends = Unknown(name="ends_held", unit="1", scale="logit", mean=0.0, sd=ENDS_SD)
    return Law(
        curve=curve,
        baseline=(
            Unknown(name="E_MPa", unit="MPa", scale="log", mean=float(np.log(guess)), sd=2.0),
            *(unknown for unknowns in own for unknown in unknowns),
            Unknown(name="bend", unit="1", scale="linear", mean=0.0, sd=BEND_SD),
            drift,
            *([] if curve.held_over_sliding(np.zeros(1)) is None else [ends]),
        ),
    )


def _own(trace: IndenterTrace, number: int, toe_mm: float) -> tuple[Unknown, ...]:
    """First touch, zero and toe of one recording. The first reading may be the cell's zero or a force:
    the zero's standard deviation holds all of it.
    """
    touch = first_touch(trace)
    onset_mm = float(trace.travel_mm[max(touch - 1, 0)])
    peak = float(np.abs(trace.force_N).max())
    zero = float(np.median(trace.force_N[: max(touch - 1, 1)]))
    spread = float(np.ptp(trace.travel_mm))
    at = suffix_of(number)
    toe = Unknown(
        name=f"toe_mm{at}", unit="mm", scale="log", mean=float(np.log(max(toe_mm, 1e-9))), sd=TOE_SD
    )
    return (
        Unknown(name=f"onset_mm{at}", unit="mm", scale="linear", mean=onset_mm, sd=ONSET_SD * spread),
        Unknown(
            name=f"zero_N{at}", unit="N", scale="linear", mean=zero, sd=float(np.hypot(ZERO_SD * peak, zero))
        ),
        *([toe] if toe_mm else []),
    )
