"""Displacement that known effects add to the plain model, at the modulus fitted with them.

    y(t) = X + s [c(t) + d(t)] + R q(t) + ...,      d = sum over effects of (c_theta - c) + shift / s

Most laws depend on s = 1/E, and s depends on them: d and s are computed in turn until s settles.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.effect import Effect, Response
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import Fields
from fem.mismatch.procedure import case_model
from fem.mismatch.result import in_words
from fem.mismatch.selection.modulus_with import modulus_of
from fem.mismatch.signature_variant import ONE_WAY

MOST_ROUNDS, STILL = 12, 1e-3
"""Most rounds; rounds end when the relative change of 1/E is below STILL."""


@dataclass(frozen=True, kw_only=True)
class KnownEffect:
    """An effect with its searched parameters, as a function of the flesh's modulus E (MPa)."""

    effect: Effect
    parameters: Callable[[float], Mapping[str, float]]


def displacement_corrections(
    case: MismatchCase, effects: Sequence[KnownEffect], *, at_finite_strain: bool
) -> list[Float[np.ndarray, "_t _n 3"]]:
    """d(t) of every recording in all frames, mm MPa; zero without contact.

    `at_finite_strain`: whether the effects also change the large deformation.

    Raises FemFailure if the recordings or an effect's model cannot be computed, or 1/E does not settle.
    """
    model, _ = case_model(case, beyond_small_strain=at_finite_strain)
    if not model.compliance > 0:
        raise FemFailure(
            FemProblem.NO_MODULUS,
            "the forces do not move the fruit along themselves (1/E is "
            f"{model.compliance:.2g} per MPa), so no effect can be added at its E: expected 1/E > 0; "
            "record the grasp again",
        )
    for _ in range(MOST_ROUNDS):
        corrections = _corrections(model, effects)
        whole = [
            recording.tracks.unit_displacement + correction
            for recording, correction in zip(model.grasps, corrections, strict=True)
        ]
        compliance = 1 / modulus_of(model, Response(unit=whole)).value
        moved = abs(compliance / model.compliance - 1)
        model = replace(model, compliance=compliance)
        if moved < STILL:
            break
    else:
        names = ", ".join(in_words(known.effect.spec.name) for known in effects)
        raise FemFailure(
            FemProblem.NOT_CONVERGED,
            f"E with {names} still changes by {moved:.2%} after {MOST_ROUNDS} rounds, "
            f"expected {STILL:.1%} at most",
        )
    return [
        recording.over_all_frames(correction)
        for recording, correction in zip(model.grasps, corrections, strict=True)
    ]


def _corrections(model: CaseModel, effects: Sequence[KnownEffect]) -> Fields:
    """d in the frames used: the sum of small corrections."""
    corrections = [np.zeros_like(recording.tracks.unit_displacement) for recording in model.grasps]
    for known in effects:
        answer = known.effect.respond(model, known.parameters(1 / model.compliance), ONE_WAY)
        for k, recording in enumerate(model.grasps):
            corrections[k] = corrections[k] + answer.unit[k] - recording.tracks.unit_displacement
            if answer.shift_mm is not None:
                corrections[k] = corrections[k] + answer.shift_mm[k] / model.compliance
    return corrections
