"""How well a law predicts frames that it was not fitted to."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.contact_law import Law
from fem.indentation.fit import TraceFit, fit
from fem.indentation.trace import IndenterTrace
from fem.indentation.trace_noise import NoContactNoise

#: blocks into which the whole trace is cut, every second one left out in turn
BLOCKS = 10
#: a compliant machine's force and the law's have settled where they change by so small a share of the peak
MOST_ROUNDS, STILL = 60, 1e-3
#: of each round's change: less than all of it, so that a machine softer than the specimen settles as well
TAKEN = 0.5


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """Force of the frames left out, NaN elsewhere, by the linear law and by the named one."""

    protocol: str
    before_N: Float[np.ndarray, " t"]
    after_N: Float[np.ndarray, " t"]

    def rms(self, force_N: Float[np.ndarray, " t"]) -> tuple[float, float]:
        """Root mean square error over that of the force left out, before and after."""
        out = np.isfinite(self.before_N)
        size = np.sqrt(np.mean(force_N[out] ** 2))
        return (
            float(np.sqrt(np.mean((self.before_N - force_N)[out] ** 2)) / size),
            float(np.sqrt(np.mean((self.after_N - force_N)[out] ** 2)) / size),
        )


def future_frames(trace: IndenterTrace) -> Bool[np.ndarray, " t"]:
    """What is predicted from the past: all from the start of unloading, else the second half of the hold.

    Where the ball never stands still, the last third.
    """
    phases = np.array(trace.phases)
    frames = np.arange(len(phases))
    deepest = int(np.argmax(trace.travel_mm >= trace.travel_mm.max() * (1 - 1e-3)))
    unload = np.flatnonzero((phases == "unload") & (frames > deepest))
    if len(unload) and len(phases) - unload[0] >= 5:
        return np.asarray(frames >= unload[0])
    hold = np.flatnonzero((phases == "hold") & (frames > deepest))
    first = hold[len(hold) // 2] if len(hold) >= 10 else 2 * len(phases) // 3
    return np.asarray(frames >= first)


def predict(
    linear: TraceFit, named: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise
) -> tuple[Prediction, Prediction]:
    """Both laws, refitted without the frames they predict: the trace's end, and its blocks in turn."""
    block = np.arange(len(trace.time_s)) * BLOCKS // len(trace.time_s) % 2 == 0
    ways = {"end": [future_frames(trace)], "blocks": [block, ~block]}
    return tuple(  # type: ignore[return-value]
        Prediction(
            protocol=name,
            before_N=_left_out(linear, trace, no_contact, masks),
            after_N=_left_out(named, trace, no_contact, masks),
        )
        for name, masks in ways.items()
    )


def _left_out(
    known: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise, masks: list[Bool[np.ndarray, " t"]]
) -> Float[np.ndarray, " t"]:
    force = np.full(len(trace.time_s), np.nan)
    for mask in masks:
        again = fit(known.law, trace, no_contact, known.scaled[None], frames=~mask, follow=1)
        force[mask] = _without_measured(known.law, again.scaled, trace, mask)[mask]
    return np.asarray(force)


def _without_measured(
    law: Law, scaled: Float[np.ndarray, " k"], trace: IndenterTrace, mask: Bool[np.ndarray, " t"]
) -> Float[np.ndarray, " t"]:
    """The law's force where a compliant machine gives way under that force itself, not the measured one.

    Raises FemFailure (NOT_CONVERGED) where force and travel do not agree within STILL after MOST_ROUNDS.
    """
    blind = trace.force_N.copy()
    blind[mask] = np.interp(trace.time_s[mask], trace.time_s[~mask], trace.force_N[~mask])
    gives_way = any(u.name == "mm_per_N" for u in law.unknowns)
    for _ in range(MOST_ROUNDS):
        force = law.force_N(replace(trace, force_N=blind), scaled[None])[0]
        changed = float(np.abs(force[mask] - blind[mask]).max(initial=0.0) / np.abs(trace.force_N).max())
        if changed < STILL or not gives_way:
            return np.asarray(force)
        blind[mask] += TAKEN * (force - blind)[mask]
    raise FemFailure(
        FemProblem.NOT_CONVERGED,
        f"the force on a machine that gives way still changes by {changed:.2%} of its peak after "
        f"{MOST_ROUNDS} rounds, expected {STILL:.1%} at most",
    )
