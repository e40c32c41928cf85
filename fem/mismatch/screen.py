"""The screen: the finder's linear round, cheap enough for every graded fruit.

It tests whether a fruit's recordings contradict the plain model, and which effects would explain them to
first order, with the test and the posterior of fem.mismatch.selection.decision. It refits nothing, so a
name is a suggestion. To save time

- long recordings are thinned to MOST_FRAMES frames in all; a frame then represents its neighbours;
- a soft spot is searched at one radius, and is tried at its best place alone;
- history-dependent laws use PATH_SHARE of the finder's frames;
- NOT_SCREENED effects are left out.

A confirmed effect's displacement (GraspCase.correction) is part of the plain model here, so that the screen
tests for further effects.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.effect import Effect
from fem.mismatch.effects.soft_spot import SoftSpot
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.localisation.spot_search import RADIUS_MM
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.procedure import case_model, detected
from fem.mismatch.result import NONE, in_words
from fem.mismatch.selection.decision import credible_set
from fem.mismatch.selection.grasp_explanations import Hypothesis, all_explanations, ranked
from fem.mismatch.selection.screening import LinearRound, screened
from fem.solid.linear_solid import Support, UnitModulusSolid

NOT_SCREENED: Mapping[str, str] = {
    "loose_pit": "its response is a search for where flesh and pit touch, on a solid of its own",
}
"""Effects that the screen omits, and why: none has first-order signatures of the bonded flesh."""
MOST_FRAMES = 96
"""Frames of all recordings together. A fruit without mismatch with four recordings (open-01 of
benchmarks/results/mismatch.csv) has p 0.98 with 96 frames and 0.34 with 64; the finder's own p is 0.9. The
96 frames take 1 s of CPU more."""
PATH_SHARE = 0.25
"""Share of the finder's 24 to 48 frames that history-dependent laws use here: 6 to 12 frames. On fruit N02 of
the sample batch large deformation then gains 11.9, with all frames 12.4; it takes 8.4 s of CPU, not 11.6."""
TOO_FEW = (
    "one recording alone cannot tell missing physics from where the pit and the pads are; record a second "
    "grasp at another place"
)


@dataclass(frozen=True, kw_only=True)
class Amount:
    """One amount of an effect that stays with sensor or jaws, fitted together with the fruit's own effects.

    `pad`: empty for the whole gripper. `value`, `sd`: in the signature's unit (fem.mismatch.effects).
    """

    effect: str
    pad: str
    parameter: str
    value: float
    sd: float


@dataclass(frozen=True, kw_only=True)
class Screened:
    """The screen's result for one fruit. `names`: explanations that the linear round suggests, the likeliest
    first; two effects are joined by "+"; empty if nothing is found. `amounts`: for faults of a whole batch.
    `moduli`: for each known effect of `names`, E with it over E without, and the relative standard deviation
    that it adds.
    """

    p_value: float
    names: tuple[str, ...]
    statistics: dict[str, float]
    gains: dict[str, float]
    amounts: tuple[Amount, ...]
    moduli: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    note: str = ""


def screen(
    case: MismatchCase,
    *,
    solids: Mapping[Support, UnitModulusSolid] | None = None,
    beyond_small_strain: bool = True,
) -> Screened:
    """The linear round for a fruit that was just graded.

    `solids`: grading's, if still in memory. `beyond_small_strain`: as in CaseModel. Raises FemFailure if a
    recording cannot be projected, the fitted 1/E is not above zero, or there is only one recording.
    """
    if len(case.grasps) < 2:
        raise FemFailure(FemProblem.NO_LOAD, TOO_FEW)
    most_frames = max(MOST_FRAMES // len(case.grasps), 1)
    model, _ = case_model(
        case, solids=solids, most_frames=most_frames, beyond_small_strain=beyond_small_strain
    )
    if not model.compliance > 0:
        raise FemFailure(
            FemProblem.NO_MODULUS,
            f"the fitted compliance is not positive (1/E is {model.compliance:.2g} per MPa, expected above "
            "zero); check the signs of forces and poses",
        )
    model = replace(model, path_share=PATH_SHARE)
    recorded = model.each(lambda recording: GraspEquations.of(model, recording))
    linear = screened(model, recorded, _screened_effects(), noise_draws=1)
    detection = detected(linear)
    explanations = suggested(linear) if detection.mismatch else ()
    return Screened(
        p_value=detection.p_value,
        names=tuple(explanation.name for explanation in explanations),
        statistics=detection.p_values,
        gains={linear_fit.name: linear_fit.gain for linear_fit in linear.best},
        amounts=tuple(_amounts(linear)),
        moduli={
            explanation.name: explanation.modulus_change
            for explanation in explanations
            if explanation.modulus_change is not None
        },
        note="; ".join(f"{in_words(name)} could not be tried: {why}" for name, why in linear.without.items()),
    )


def suggested(linear: LinearRound) -> tuple[Hypothesis, ...]:
    """Explanations of the posterior's credible set that are likelier than no mismatch, likeliest first."""
    ranking = {hypothesis.name: hypothesis for hypothesis in ranked(all_explanations(linear))}
    none = ranking[NONE].probability
    names = credible_set(list(ranking), [hypothesis.probability for hypothesis in ranking.values()])
    return tuple(ranking[name] for name in names if ranking[name].probability > none)


def _screened_effects() -> list[Effect]:
    """The catalogue without NOT_SCREENED, with one size of soft spot at its best place."""
    return [
        replace(effect, radii_mm=(RADIUS_MM,), others=0) if isinstance(effect, SoftSpot) else effect
        for effect in EFFECTS
        if effect.spec.name not in NOT_SCREENED
    ]


def _amounts(linear: LinearRound) -> Iterator[Amount]:
    """Amounts of every effect that stays with sensor or jaws, each fitted with every effect of the fruit.

    The fruit's amounts have their priors, so that the jaws' amounts exclude what the fruit could explain.
    """
    products = linear.products
    fruit = [
        j for linear_fit in linear.best if not linear_fit.effect.spec.of_the_jaws for j in linear_fit.columns
    ]
    for linear_fit in linear.linear_fits:
        if not linear_fit.effect.spec.of_the_jaws or not linear_fit.columns:
            continue
        fit = products.fit([*linear.nuisances, *fruit, *linear_fit.columns])
        pad = linear_fit.signature.variant.pad
        for k, j in enumerate(linear_fit.columns):
            at = len(fit.amounts) - len(linear_fit.columns) + k
            name = products.columns[j].name.removeprefix(f"{pad} ")
            yield Amount(
                effect=linear_fit.effect.spec.name,
                pad=pad,
                parameter=name,
                value=float(fit.amounts[at]),
                sd=math.hypot(fit.sd[at], products.columns[j].measured_sd),
            )
