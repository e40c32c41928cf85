"""How well a law predicts frames that it was not fitted to."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fem.indentation.contact_law import Law
from fem.indentation.fit import TraceFit, fit
from fem.indentation.no_contact import NoContactNoise
from fem.indentation.trace import IndenterTrace

#: rounds in which a compliant machine's force and the law's come to agree, and the share of each round's
#: change that is taken, so that a machine softer than the specimen settles as well
ROUNDS, TAKEN = 60, 0.5


def future_frames(trace: IndenterTrace) -> Bool[np.ndarray, " t"]:
    """What is predicted from the past: all from the start of unloading, else the second half of the hold.

    Where the ball never stands still, the last third. Of several recordings, of each.
    """
    if len(trace.parts) > 1:
        return np.concatenate([future_frames(part) for part in trace.parts])
    phases = np.array(trace.phases)
    frames = np.arange(len(phases))
    after = frames > trace.deepest
    unload = np.flatnonzero((phases == "unload") & after)
    if len(unload) and len(phases) - unload[0] >= 5:
        return np.asarray(frames >= unload[0])
    hold = np.flatnonzero((phases == "hold") & after)
    first = hold[len(hold) // 2] if len(hold) >= 10 else 2 * len(phases) // 3
    return np.asarray(frames >= first)


def predicted_N(known: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise) -> Float[np.ndarray, " t"]:
    """The force by the law refitted without each recording's end, which it predicts; NaN elsewhere."""
    future = future_frames(trace)
    again = fit(known.law, trace, no_contact, known.scaled[None], frames=~future)
    return np.where(future, without_measured(known.law, again.scaled, trace, future), np.nan)


def share_missed(predicted_N: Float[np.ndarray, " t"], force_N: Float[np.ndarray, " t"]) -> float:
    """Root mean square error of what was predicted, over that of the force."""
    out = np.isfinite(predicted_N)
    return float(np.sqrt(np.mean((predicted_N - force_N)[out] ** 2) / np.mean(force_N[out] ** 2)))


def without_measured(
    law: Law, scaled: Float[np.ndarray, " k"], trace: IndenterTrace, mask: Bool[np.ndarray, " t"]
) -> Float[np.ndarray, " t"]:
    """The law's force. In the frames of `mask` it also moves a compliant machine, not the measured one."""
    blind = trace.force_N.copy()
    blind[mask] = np.interp(trace.time_s[mask], trace.time_s[~mask], trace.force_N[~mask])
    force = law.force_N(replace(trace, force_N=blind), scaled[None])[0]
    for _ in range(ROUNDS if any(effect.give_mm is not None for effect in law.effects) else 0):
        blind[mask] += TAKEN * (force - blind)[mask]
        force = law.force_N(replace(trace, force_N=blind), scaled[None])[0]
    return np.asarray(force)
