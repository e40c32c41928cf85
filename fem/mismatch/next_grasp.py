"""What to record next: what parts the explanations that are left.

Computed over some thirty candidate grasps (fem.mismatch.design): the one whose smallest expected ln evidence
between two of them is greatest. Where that cannot be computed, a fixed recommendation.
"""

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure
from fem.mismatch.catalogue import SPECS
from fem.mismatch.design.candidate_grasps import PlaceKind
from fem.mismatch.design.compared_candidates import ComparedCandidate, compared_candidates
from fem.mismatch.design.predictions import Explained
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.result import NONE, UNKNOWN, NextGraspPlan, ProposedGrasp, ProposedPad
from fem.mismatch.selection.model_selection import Hypothesis, ModelSelection
from fem.mismatch.selection.screening import LinearRound

TURNED = (
    "grasp the same spots once more with the fruit turned by 180 degrees between the jaws: what belongs "
    "to a sensor or jaw stays with it, what belongs to the fruit moves along"
)
SPEEDS = "grasp one spot at two speeds that differ tenfold, each with a hold of ten seconds"
ACROSS = "grasp across the last direction, and along the stem if the jaws allow it"
LISTED = 5
"""Candidates that an answer lists. Set by hand, to be read at a glance."""
LEAST_PROBABILITY = 0.01
"""Of another explanation, from which a single recording leaves it to be told apart. Set by hand: a fifth of
what a verdict may lack (fem.mismatch.selection.decision), as nothing else checks a single recording."""
FOLLOWS_RECORDED_BALANCE = "third_contact"
"""An effect whose force is taken from the recorded pads' balance, which no candidate has."""
MOST_EXPLAINED = 4
"""Explanations that are followed to the candidates, the likeliest first. Set by hand, to bound the time."""


def next_grasp(verdict: str | tuple[str, ...], *, grasps: int) -> str | None:
    """A sentence, or None where nothing is left to tell apart.

    A turned fruit separates every effect of the jaws from every effect of the fruit.
    """
    if isinstance(verdict, str):
        if verdict == UNKNOWN:
            return f"nothing in the catalogue explains this; first {SPEEDS}; then {TURNED}"
        if verdict != NONE and grasps < 2:
            return f"one recording alone cannot be checked against another: {ACROSS}; then {TURNED}"
        return None
    names = [part for name in verdict for part in name.split("+") if part in SPECS]
    of_the_jaws = [SPECS[name].of_the_jaws for name in names]
    if any(of_the_jaws) and not all(of_the_jaws):
        return TURNED
    return SPEEDS if any(SPECS[name].knows_time for name in names) else ACROSS


def planned_grasp(
    forward: ForwardModel, linear: LinearRound, selection: ModelSelection
) -> NextGraspPlan | None:
    """The plan; None where nothing is left to tell apart, or nothing of it can be computed.

    `forward`, `linear`: the plain model of the recordings so far, and their linear round.
    """
    left = explanations_left(linear, selection, grasps=len(forward.base.grasps))
    if len(left) < 2 or any(FOLLOWS_RECORDED_BALANCE in explanation.name.split("+") for explanation in left):
        return None
    try:
        compared = compared_candidates(forward, left)
    except (FemFailure, np.linalg.LinAlgError):
        return None
    if not compared:
        return None
    start = _first_pad_deg(forward)
    listed = tuple(_planned(forward, candidate, start) for candidate in compared[:LISTED])
    return NextGraspPlan(grasps=listed, tried=len(compared))


def explanations_left(linear: LinearRound, selection: ModelSelection, *, grasps: int) -> list[Explained]:
    """What the verdict leaves, of what was refitted; of a single recording the best and the next.

    None of anything where the verdict is "none" or "unknown", or one name that several recordings share.
    """
    if isinstance(selection.verdict, str):
        if selection.verdict in (NONE, UNKNOWN) or grasps > 1:
            return []
        known = [
            hypothesis
            for hypothesis in selection.ranking
            if hypothesis.refit is not None or hypothesis.name == NONE
        ]
        first = next((hypothesis for hypothesis in known if hypothesis.name == selection.verdict), None)
        if first is None:
            return []
        rest = [
            hypothesis
            for hypothesis in known
            if hypothesis is not first and hypothesis.probability > LEAST_PROBABILITY
        ]
        chosen = [first, *rest[:1]]
    else:
        left = [hypothesis for hypothesis in selection.ranking if hypothesis.name in selection.verdict]
        chosen = [
            hypothesis for hypothesis in left if hypothesis.refit is not None or hypothesis.name == NONE
        ]
    return [_explained(hypothesis, linear) for hypothesis in chosen[:MOST_EXPLAINED]]


def in_words(plan: NextGraspPlan) -> str:
    """The best candidate as a sentence that completes "record next: ..."."""
    best = plan.grasps[0]
    where = {
        PlaceKind.SAME: f"grasp the spots of {best.like} again",
        PlaceKind.TURNED: f"grasp the spots of {best.like} with the fruit turned by 180 degrees",
        PlaceKind.ACROSS: f"grasp across the direction of {best.like}",
        PlaceKind.ROUND: "grasp elsewhere round the stem",
        PlaceKind.TILTED: "grasp with the jaws tilted towards the stem",
    }[PlaceKind(best.place)]
    pads = " and ".join(f"pad {pad.pad} at {5 * round(pad.round_deg / 5) % 360}" for pad in best.pads)
    first, other = (name.replace("_", " ") for name in best.pair)
    return (
        f"{where} ({pads} degrees round the stem, counted from pad {best.pads[0].pad} of the first "
        f"recording), {manner_in_words(best)}; of {plan.tried} grasps computed this one sets {first} apart "
        f"from {other} best, by {_rounded(best.gain)} in ln evidence as far as the models go"
    )


def manner_in_words(grasp: ProposedGrasp) -> str:
    """Depth, speed, hold and cycles."""
    depth = "as deep" if grasp.depth == 1 else f"{grasp.depth:g} times as deep"
    speed = "as fast" if grasp.speed == 1 else f"at {grasp.speed:g} times the speed"
    hold = "held as long" if grasp.hold_s is None else f"held for {grasp.hold_s:g} s"
    cycles = "once" if grasp.cycles == 1 else f"{grasp.cycles} times in a row"
    return f"{depth} and {speed} as then, {hold}, {cycles}"


def _rounded(gain: float) -> str:
    """To two digits, without exponent.

    >>> _rounded(4.23), _rounded(1234.5)
    ('4.2', '1200')
    """
    return f"{float(f'{gain:.2g}'):g}" if gain < 1e5 else "100000 and more"


def _explained(hypothesis: Hypothesis, linear: LinearRound) -> Explained:
    again = hypothesis.refit
    return Explained(
        name=hypothesis.name,
        probability=hypothesis.probability,
        gain=hypothesis.gain,
        fit=linear.null if again is None else again.fit,
        products=linear.products if again is None else again.products,
        refit=again,
    )


def _planned(forward: ForwardModel, candidate: ComparedCandidate, start_deg: float) -> ProposedGrasp:
    """As an answer has it."""
    place, protocol, least = candidate.candidate.place, candidate.candidate.protocol, candidate.least
    pads = []
    for number, pad in enumerate(candidate.recording.case.history.pads):
        touching = (pad.episode >= 0).any(axis=0)
        patch = pad.surface_mm[touching]
        push = np.abs(pad.force_N[:, touching]).sum(axis=(0, 2))
        centre = push @ patch / push.sum()
        x, y, z = (float(v) for v in candidate.recording.case.turns[number][:, 2])
        pads.append(
            ProposedPad(
                pad=pad.name,
                centre_mm=(float(centre[0]), float(centre[1]), float(centre[2])),
                direction=(x, y, z),
                round_deg=(_round_deg(forward, centre) - start_deg) % 360.0,
                patch_mm=patch,
            )
        )
    return ProposedGrasp(
        place=place.kind.value,
        like=forward.base.grasps[place.source].case.name,
        pads=tuple(pads),
        depth=protocol.depth,
        speed=protocol.speed,
        hold_s=protocol.hold_s,
        cycles=protocol.cycles,
        turned=place.kind == PlaceKind.TURNED,
        gain=least.least,
        pair=least.names,
        decides=candidate.decides,
    )


def _first_pad_deg(forward: ForwardModel) -> float:
    """Angle round the stem of the first pad's patch in the first recording."""
    first = forward.base.grasps[0]
    touching = (first.pad_of_marker == 0) & (first.tracks.episode >= 0).any(axis=0)
    return _round_deg(forward, first.tracks.place_mm[touching].mean(axis=0))


def _round_deg(forward: ForwardModel, point_mm: Float[np.ndarray, "3"]) -> float:
    """Angle round the stem through the fruit's middle."""
    mesh = forward.base.mesh
    x, y, _ = point_mm - mesh.nodes_mm[mesh.outer_nodes].mean(axis=0)
    return float(np.rad2deg(np.arctan2(y, x)))
