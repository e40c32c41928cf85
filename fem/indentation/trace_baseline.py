"""Linear elasticity of a ball on a slab, with what is never a finding: onset, zero, error of the theory."""

import numpy as np

from fem.indentation.ball import BallOnSlab
from fem.indentation.contact_law import Law
from fem.indentation.no_contact import first_touch
from fem.indentation.trace import IndenterTrace
from fem.indentation.unknowns import Unknown

#: prior sd of the exponent that bends the force-depth curve: 7 % of the force at a depth of R, for strains
#: that are small no more, a ball that is not quite one, friction under it
BEND_SD = 0.1
#: prior sd of the onset over the travel, and of the zero over the peak force
ONSET_SD, ZERO_SD = 0.15, 0.05


def linear_law(trace: IndenterTrace, *, thickness_mm: float | None, poisson_ratio: float) -> Law:
    """E, the travel at first touch, the load cell's zero, and `bend`: force times (1 + d/R)^bend."""
    ball = BallOnSlab.tabulate(
        radius_mm=trace.radius_mm, thickness_mm=thickness_mm, poisson_ratio=poisson_ratio
    )
    touch = first_touch(trace)
    onset_mm = float(trace.travel_mm[max(touch - 1, 0)])
    deepest = float(trace.travel_mm.max()) - onset_mm
    peak = float(np.abs(trace.force_N).max())
    guess = peak / float(ball.force_N_per_MPa(np.array(max(deepest, 1e-3))))
    zero = float(np.median(trace.force_N[: max(touch - 1, 1)]))
    spread = float(np.ptp(trace.travel_mm))
    return Law(
        ball=ball,
        baseline=(
            Unknown(name="E_MPa", unit="MPa", scale="log", mean=float(np.log(guess)), sd=2.0),
            Unknown(name="onset_mm", unit="mm", scale="linear", mean=onset_mm, sd=ONSET_SD * spread),
            Unknown(name="zero_N", unit="N", scale="linear", mean=zero, sd=ZERO_SD * peak),
            Unknown(name="bend", unit="1", scale="linear", mean=0.0, sd=BEND_SD),
        ),
    )
