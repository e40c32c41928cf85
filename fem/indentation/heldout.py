"""How well a law predicts frames that it was not fitted to."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fem.fem_failure import FemFailure, FemProblem
from fem.indentation.contact_law import Law
from fem.indentation.fit import TraceFit, fit
from fem.indentation.no_contact import NoContactNoise
from fem.indentation.trace import IndenterTrace

#: a compliant machine's force and the law's have settled where they change by so small a share of the peak
MOST_ROUNDS, STILL = 60, 1e-3
#: recordings from which on whole ones are left out
FEWEST_WHOLE = 3
#: share of a recording's peak force up to which its frames stay, to say where it begins; frames in the air
FIRST, STAYS = 0.1, 3
#: of each round's change: less than all of it, so that a machine softer than the specimen settles as well
TAKEN = 0.5


def future_frames(trace: IndenterTrace) -> Bool[np.ndarray, " t"]:
    """What is predicted from the past: all from the start of unloading, else the second half of the hold.

    Where the ball never stands still, the last third. Of several recordings, of each.
    """
    if len(trace.parts) > 1:
        return np.concatenate([future_frames(part) for part in trace.parts])
    phases = np.array(trace.phases)
    frames = np.arange(len(phases))
    deepest = int(np.argmax(trace.travel_mm >= trace.travel_mm.max() * (1 - 1e-3)))
    unload = np.flatnonzero((phases == "unload") & (frames > deepest))
    if len(unload) and len(phases) - unload[0] >= 5:
        return np.asarray(frames >= unload[0])
    hold = np.flatnonzero((phases == "hold") & (frames > deepest))
    first = hold[len(hold) // 2] if len(hold) >= 10 else 2 * len(phases) // 3
    return np.asarray(frames >= first)


def whole_recordings(trace: IndenterTrace) -> list[Bool[np.ndarray, " t"]]:
    """For each recording in turn its frames from where its force has risen by FIRST of its peak.

    What comes before stays in the fit: it says where this recording's first touch and zero are, which no
    other one knows.
    """
    masks = []
    for frames, part in zip(trace.slices, trace.parts, strict=True):
        risen = part.force_N - float(np.median(part.force_N[:STAYS]))
        mask = np.zeros(len(trace.time_s), dtype=bool)
        mask[frames.start + int(np.argmax(risen > FIRST * risen.max())) : frames.stop] = True
        masks.append(mask)
    return masks


def predicted_N(known: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise) -> Float[np.ndarray, " t"]:
    """The force by the law refitted without the frames it predicts, NaN elsewhere: each recording's end, or,
    from FEWEST_WHOLE recordings on, whole recordings in turn.
    """
    several = len(trace.parts) >= FEWEST_WHOLE
    force = np.full(len(trace.time_s), np.nan)
    for mask in whole_recordings(trace) if several else [future_frames(trace)]:
        again = fit(known.law, trace, no_contact, known.scaled[None], frames=~mask, follow=1)
        force[mask] = without_measured(known.law, again.scaled, trace, mask)[mask]
    return force


def share_missed(predicted_N: Float[np.ndarray, " t"], force_N: Float[np.ndarray, " t"]) -> float:
    """Root mean square error of what was predicted, over that of the force."""
    out = np.isfinite(predicted_N)
    return float(np.sqrt(np.mean((predicted_N - force_N)[out] ** 2) / np.mean(force_N[out] ** 2)))


def without_measured(
    law: Law, scaled: Float[np.ndarray, " k"], trace: IndenterTrace, mask: Bool[np.ndarray, " t"]
) -> Float[np.ndarray, " t"]:
    """The law's force where a compliant machine gives way under that force itself, not the measured one.

    Raises FemFailure (NOT_CONVERGED) where force and travel do not agree within STILL after MOST_ROUNDS.
    """
    blind = trace.force_N.copy()
    blind[mask] = np.interp(trace.time_s[mask], trace.time_s[~mask], trace.force_N[~mask])
    gives_way = any(effect.give_mm is not None for effect in law.effects)
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
