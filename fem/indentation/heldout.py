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


@dataclass(frozen=True, kw_only=True)
class LawPrediction:
    """What one law says of the frames that it was not fitted to, NaN elsewhere, and how far off it is: root
    mean squares over that of the force left out.
    """

    end_N: Float[np.ndarray, " t"]
    blocks_N: Float[np.ndarray, " t"]
    end_share: float
    blocks_share: float


def whole_recordings(trace: IndenterTrace) -> list[Bool[np.ndarray, " t"]]:
    """For each recording in turn its frames from where its force has risen by FIRST of its peak.

    What comes before stays in the fit: it says where this recording's first touch and zero are, which no
    other one knows.
    """
    masks = []
    for frames, part in zip(trace.slices, trace.parts, strict=True):
        risen = part.force_N - float(np.median(part.force_N[:STAYS]))
        above = np.flatnonzero(risen > FIRST * risen.max())
        mask = np.zeros(len(trace.time_s), dtype=bool)
        mask[frames.start + int(above[0]) : frames.stop] = True
        masks.append(mask)
    return masks


def predict_law(known: TraceFit, trace: IndenterTrace, no_contact: NoContactNoise) -> LawPrediction:
    """The law, refitted without the frames it predicts: the trace's end, and its blocks in turn.

    From FEWEST_WHOLE recordings on, whole recordings in turn take the place of the end.
    """
    block = np.concatenate(
        [np.arange(len(part.time_s)) * BLOCKS // len(part.time_s) % 2 == 0 for part in trace.parts]
    )
    several = len(trace.parts) >= FEWEST_WHOLE
    end = _left_out(known, trace, no_contact, whole_recordings(trace) if several else [future_frames(trace)])
    blocks = _left_out(known, trace, no_contact, [block, ~block])
    return LawPrediction(
        end_N=end,
        blocks_N=blocks,
        end_share=_share(end, trace.force_N),
        blocks_share=_share(blocks, trace.force_N),
    )


def _share(predicted_N: Float[np.ndarray, " t"], force_N: Float[np.ndarray, " t"]) -> float:
    out = np.isfinite(predicted_N)
    return float(np.sqrt(np.mean((predicted_N - force_N)[out] ** 2) / np.mean(force_N[out] ** 2)))


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
    seen = ~mask
    known_s, known_N = trace.time_s[seen], trace.force_N[seen]
    blind[mask] = np.interp(trace.time_s[mask], known_s, known_N)
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
