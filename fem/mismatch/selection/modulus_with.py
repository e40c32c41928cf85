"""E of all recordings together: by the plain model, and with an explanation in its place.

Both by grading's own inference (fem.estimation.joint_inference), linear about the prior's pit: what the pit,
the pads' places and the surface may be off by is marginalised with an effect as without. With an effect in
place E is known no better than the effect: what its parameters are off by is in its spread, and so is how far
that inference and the finder's own evidence disagree.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from fem.estimation.compliance_fit import CompliantFit, MarkerTracks, fit_compliance
from fem.estimation.error_budget import ErrorBudget
from fem.estimation.joint_inference import joint_modulus
from fem.estimation.modulus import first_touch_evidence
from fem.fem_failure import FemFailure
from fem.mismatch.effect import Effect, Response
from fem.mismatch.effect_spec import Correction
from fem.mismatch.evidence.beyond_small_strain import displacement_beyond
from fem.mismatch.gel_fault import GelFault
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import Fields, GraspResponse
from fem.mismatch.result import Modulus
from fem.mismatch.selection.refinement import Refit

LEAST_RELATIVE_SD = 0.01
"""Of E: what all recordings have in common. A linear truth is met to 0.9 and 1.3 % (docs/validation.md,
Solver)."""
SCATTER = 0.02
"""Relative scatter of one recording's E, where there is no second one to show it."""
LEAST_COMPLIANCE = 1e-9
"""1/MPa: what stands for a fit that gives none above zero, beyond any material's."""
SPREADS = {
    Correction.PIT_OFFSET: "pit_offset_sd_mm",
    Correction.PIT_SIZE: "pit_size_sd",
    Correction.POISSON_RATIO: "poisson_ratio_sd",
}
"""The error budget's spread of what an effect puts right: with it in place its own error counts instead."""
SYSTEMATIC = 1.5
"""Standard deviations are this many times those of the thinned noise
(fem.mismatch.model.marker_equations)."""


def modulus_of(model: CaseModel, response: Response | None = None) -> Modulus:
    """E of all recordings, by grading's own inference with an effect's response in the plain one's place.

    Without grading's models, or where that inference has no E: the mean of the recordings' own fits. Markers
    move by what large deformation adds, too.
    """
    plain = Response(unit=model.plain)
    beyond = displacement_beyond(model)
    return _moduli(model, [response or plain], model.case.budget, beyond=beyond)[0]


def _moduli(
    model: CaseModel, responses: Sequence[Response], budget: ErrorBudget, *, beyond: Fields
) -> list[Modulus]:
    """E with each of the responses, all by one estimator: differences between them are the responses' own."""
    if any(model.graded):
        with suppress(FemFailure):
            return [_inferred(model, response, budget, beyond=beyond) for response in responses]
    return [_mean_of_fits(model, response, beyond=beyond) for response in responses]


def _fits(
    model: CaseModel, response: Response, *, beyond: Fields
) -> list[tuple[GraspResponse, MarkerTracks, CompliantFit]]:
    """Every recording with the effect's response, and its own fit."""
    fits = []
    for k, recording in enumerate(model.grasps):
        tracks = replace(
            recording.tracks,
            unit_displacement=response.unit[k] + beyond[k] / model.compliance,
            position_mm=recording.tracks.position_mm
            - (0.0 if response.shift_mm is None else response.shift_mm[k]),
        )
        fit = fit_compliance(
            tracks,
            scale_sd=model.case.budget.gel_scale_sd,
            fruit_moves=recording.case.support == "free",
        )
        fits.append((recording, tracks, fit))
    return fits


def _inferred(model: CaseModel, response: Response, budget: ErrorBudget, *, beyond: Fields) -> Modulus:
    """By fem.estimation.joint_inference, of the recordings that grading has a model of; raises FemFailure."""
    evidence = [
        first_touch_evidence(
            tracks,
            recording.over_time(recording.patterns),
            fit,
            history=recording.prepared,
            model=graded,
            budget=budget,
        )[0]
        for (recording, tracks, fit), graded in zip(
            _fits(model, response, beyond=beyond), model.graded, strict=True
        )
        if graded is not None
    ]
    joint = joint_modulus(evidence, budget=budget, infer_pit=len(evidence) > 1)
    return Modulus(value=model.modulus_scale * joint.E_MPa, sd=model.modulus_scale * joint.E_sd_MPa)


def _mean_of_fits(model: CaseModel, response: Response, *, beyond: Fields) -> Modulus:
    """The mean of the recordings' own E; its standard deviation by their scatter, and LEAST_RELATIVE_SD for
    what they have in common.
    """
    logs = -np.log(
        [max(fit.compliance, LEAST_COMPLIANCE) for _, _, fit in _fits(model, response, beyond=beyond)]
    )
    value = model.modulus_scale * float(np.exp(logs.mean()))
    scatter = float(logs.std(ddof=1) / np.sqrt(len(logs))) if len(logs) > 1 else SCATTER
    return Modulus(value=value, sd=value * float(np.hypot(scatter, LEAST_RELATIVE_SD)))


@dataclass(frozen=True, kw_only=True)
class ModulusWith:
    """E with a refitted explanation in place: at its parameters (`at`), and all in all (`known`).

    `sd`: of the parameters, `change`: d ln E / d parameter, both on the scale searched.
    """

    at: Modulus
    known: Modulus
    sd: Float[np.ndarray, " p"]
    change: Float[np.ndarray, " p"]


def modulus_with(again: Refit) -> ModulusWith:
    """What the parameters are off by is in the modulus' spread, and what the two inferences of E differ by.

    A law that is wrong by a share of its signal in any direction (LAW_ERROR of fem.mismatch.effect_spec) adds
    that share squared times the signal to the covariance, which is one for the noise.
    """
    responses = [again.response, *(ahead for _, ahead in again.ahead)]
    holds_it = any(effect.spec.holds_large_deformation for effect in again.effects)
    plain, *changed = _moduli(
        again.model,
        responses,
        _without(again.model.case.budget, again.effects),
        beyond=displacement_beyond(again.model, large_deformation=not holds_it),
    )
    widening, relation_sd = _law_widening(again), _relation_sd(again)
    parameters = slice(len(again.fit.amounts) - len(widening), None)
    laws = np.outer(widening, widening) * again.fit.covariance[parameters, parameters]
    laws += np.diag(relation_sd**2)
    change = np.array(
        [
            np.log(modulus.value / plain.value) / step
            for modulus, (step, _) in zip(changed, again.ahead, strict=True)
        ]
    )
    spread = float(np.hypot(np.sqrt(change @ laws @ change), _apart(again, plain)))
    return ModulusWith(
        at=plain,
        known=replace(plain, sd=float(np.hypot(plain.sd, plain.value * spread))),
        sd=np.hypot(widening * np.sqrt(np.diag(again.covariance)), relation_sd),
        change=change,
    )


def _apart(again: Refit, modulus: Modulus) -> float:
    """Half of what E differs by, relative, from that of the finder's own evidence with the same explanation:
    the standard deviation of two values about their mean.

    Both are of the same recordings and model and weigh them otherwise: what the model lacks moves them apart.
    That they agree proves nothing, so that this only ever widens an error bar.
    """
    compliance = again.model.compliance * (1 + float(again.fit.amounts[0]))
    if compliance <= 0:
        return 0.0
    return abs(float(np.log(modulus.value * compliance / again.model.modulus_scale))) / 2


def _without(budget: ErrorBudget, effects: Sequence[Effect]) -> ErrorBudget:
    """The budget without spreads of what these effects search for."""
    searched = {
        SPREADS[spread]: 0.0 for spread in SPREADS if spread in [effect.spec.correction for effect in effects]
    }
    return replace(budget, **searched)


def _law_widening(again: Refit) -> Float[np.ndarray, " p"]:
    """Factor of each parameter's standard deviation: the noise's own, and the error of its effect's law."""
    return np.array(
        [
            np.sqrt(SYSTEMATIC**2 + effect.spec.law_error**2 * again.signal)
            for effect in again.effects
            for _ in effect.spec.searched
        ]
    )


def _relation_sd(again: Refit) -> Float[np.ndarray, " p"]:
    """What the relation of a gel leaves open of a fault's parameters, on the scale searched: the search does
    not move them by it (HELD of fem.mismatch.gel_fault). Zero of other effects.
    """
    return np.array(
        [
            effect.relation_sd(again.model).get(spec.name, 0.0) if isinstance(effect, GelFault) else 0.0
            for effect in again.effects
            for spec in effect.spec.searched
        ]
    )
