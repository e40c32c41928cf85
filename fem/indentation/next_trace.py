"""Which press would tell the remaining explanations apart."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
from jaxtyping import Float

from fem.indentation.contact_law import Law
from fem.indentation.fit import TraceFit, jacobian_N, noise_with
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_noise import NoContactNoise

#: frames of a press that is only thought of
FRAMES = 240
Path = Callable[[float, float], tuple[list[float], list[float]]]

#: words of each press, and its corners: times (s) and travels over the deepest, from ramp and hold
PRESSES: dict[str, Path] = {
    "the same press, then draw the indenter back as fast as it went in and record two more minutes": (
        lambda ramp, hold: (
            [0, ramp, ramp + hold, 2 * ramp + hold, 2 * ramp + hold + 120],
            [0, 1, 1, 0, 0],
        )
    ),
    "press twice at the same spot to the same depth, one minute apart": (
        lambda ramp, hold: (
            [0, ramp, ramp + hold, 2 * ramp + hold, 2 * ramp + hold + 60, 3 * ramp + hold + 60],
            [0, 1, 1, 0, 0, 1],
        )
    ),
    "press in five steps, holding each as long as the last hold": (
        lambda ramp, hold: (
            [x for k in range(5) for x in (k * (ramp / 5 + hold), k * (ramp / 5 + hold) + ramp / 5)],
            [x for k in range(5) for x in (k / 5, (k + 1) / 5)],
        )
    ),
    "the same press ten times slower": lambda ramp, hold: ([0, 10 * ramp, 10 * ramp + hold], [0, 1, 1]),
    "the same press ten times faster": lambda ramp, hold: ([0, ramp / 10, ramp / 10 + hold], [0, 1, 1]),
    "the same press with a hold ten times as long": (
        lambda ramp, hold: ([0, ramp, ramp + 10 * hold], [0, 1, 1])
    ),
    "leave the indenter in the air for a minute before the same press": (
        lambda ramp, hold: ([0, 60, 60 + ramp, 60 + ramp + hold], [-0.01, 0, 1, 1])
    ),
}


def next_press(remaining: list[TraceFit], trace: IndenterTrace, no_contact: NoContactNoise) -> str | None:
    """The press whose smallest distance between any two of the remaining laws is largest; None for one law.

    Distance: one law's forces less the other's, what the other could take up in its own unknowns projected
    out, in standard deviations of noise and of the share both leave unexplained.
    """
    if len(remaining) < 2:
        return None
    load = np.flatnonzero(np.array(trace.phases) == "load")
    hold = float(np.sum(np.diff(trace.time_s)[np.array(trace.phases[1:]) == "hold"]))
    first, last = float(trace.time_s[load[0]]), float(trace.time_s[load[-1]])
    ramp, deepest = max(last - first, 0.1), float(np.ptp(trace.travel_mm))
    worst: dict[str, float] = {}
    for words, corners in PRESSES.items():
        times, shares = corners(ramp, max(hold, ramp))
        press = _press(times, shares, trace, deepest)
        worst[words] = min(
            min(_distance(a, b, press, no_contact), _distance(b, a, press, no_contact))
            for a, b in combinations(remaining, 2)
        )
    return max(worst, key=lambda words: worst[words])


def _press(times: list[float], shares: list[float], trace: IndenterTrace, deepest: float) -> IndenterTrace:
    time_s = np.unique(np.r_[np.linspace(times[0], times[-1], FRAMES), times])
    travel = float(trace.travel_mm.min()) + deepest * np.interp(time_s, times, shares)
    return IndenterTrace(
        time_s=time_s, force_N=np.zeros(len(time_s)), travel_mm=travel, geometry=trace.geometry
    )


def _distance(truth: TraceFit, other: TraceFit, press: IndenterTrace, no_contact: NoContactNoise) -> float:
    """How far `truth`'s forces are from all that `other` could bring forth nearby."""
    force = _own_force(truth.law, truth.scaled, press)
    recorded = IndenterTrace(
        time_s=press.time_s, force_N=force, travel_mm=press.travel_mm, geometry=press.geometry
    )
    guess, slope = jacobian_N(other.law, recorded, other.scaled)
    frames = np.ones(len(force), dtype=bool)
    noise = noise_with(no_contact, recorded, max(truth.share, other.share), frames)
    gap = force - guess
    weighted = noise.solve(np.column_stack([gap, slope]))
    taken = slope.T @ weighted[:, 0]
    matrix = slope.T @ weighted[:, 1:] + np.linalg.inv(other.covariance)
    return float(gap @ weighted[:, 0] - taken @ np.linalg.solve(matrix, taken))


def _own_force(law: Law, scaled: Float[np.ndarray, " k"], press: IndenterTrace) -> Float[np.ndarray, " t"]:
    """The law's force, the machine giving way under it."""
    force = np.zeros(len(press.time_s))
    for _ in range(8):
        at = IndenterTrace(
            time_s=press.time_s, force_N=force, travel_mm=press.travel_mm, geometry=press.geometry
        )
        force = law.force_N(at, scaled[None])[0]
    return force
