"""Model selection: the posterior of all explanations, and full models of those that the verdict holds.

Linear signatures decide (fem.mismatch.selection.linear_explanations, .decision). The full nonlinear models of
the verdict's explanations, MOST_REFITS of them at most, then say how large each effect is, and what it leaves
of the misfit; with that the probabilities are computed again. An explanation cannot be named where its model
cannot be computed, or where its second effect ends at the bounds of its parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from fem.fem_failure import FemFailure
from fem.mismatch.effect import AuxiliaryLikelihood, SeenDirectly
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection.decision import TEMPERATURE, Weighed, probabilities, verdict_of
from fem.mismatch.selection.linear_explanations import LinearExplanation, linear_explanations
from fem.mismatch.selection.refinement import Refit, refit
from fem.mismatch.selection.screening import LinearFit, LinearRound
from fem.mismatch.signature_variant import OfPad
from fem.mismatch.thresholds import LEAST_LISTED, MOST_REFITS, NEGLIGIBLE, OTHER_PAD_SHARE
from fem.parallel_map import parallel_map

AT_AN_END = "its second effect ends at the limit of its parameters"


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """One explanation: its name, its log Bayes factor over the plain model (all channels), its probability,
    its refit. `modulus_change`: E with it over E without, and the relative standard deviation that it adds,
    by linear signatures; None for unknown physics. `alternatives`: the same with another pad, where that
    gains about as much: its share of the explanation's probability, and its refit.
    """

    name: str
    gain: float
    probability: float
    linear_fits: tuple[LinearFit, ...]
    refit: Refit | None
    modulus_change: tuple[float, float] | None = None
    alternatives: tuple[tuple[float, Refit], ...] = ()


@dataclass(frozen=True, kw_only=True)
class ModelSelection:
    """The ranking, likeliest first ("none" and "unknown" are in it), and the verdict.

    `without`: explanations whose model could not be computed, and why.
    """

    ranking: tuple[Hypothesis, ...]
    verdict: str | tuple[str, ...]
    without: dict[str, str]


@dataclass(frozen=True)
class _InFull:
    """Full models of one explanation on the pads in question, with their log Bayes factors, best first."""

    refits: tuple[tuple[float, Refit], ...] = ()
    failed: str = ""

    @property
    def alternatives(self) -> tuple[tuple[float, Refit], ...]:
        """Of other pads that cannot be told from the best: the share of the probability, and the refit."""
        (most, _), *others = self.refits
        weight = [(float(np.exp((gain - most) / TEMPERATURE)), again) for gain, again in others]
        kept = [(share, again) for share, again in weight if share >= NEGLIGIBLE]
        total = 1 + sum(share for share, _ in kept)
        return tuple((share / total, again) for share, again in kept)


def select_model(forward: ForwardModel, linear: LinearRound, *, p_value: float) -> ModelSelection:
    """Ranking and verdict, with the full models of what the verdict holds."""
    left = linear_explanations(linear)
    in_full: dict[str, _InFull] = {}
    without: dict[str, str] = {}

    while True:
        ranking = _ranking(linear, left, in_full)
        names = verdict_of(
            {hypothesis.name: hypothesis.probability for hypothesis in ranking}, p_value=p_value
        )
        due = [
            explanation
            for name in names
            for explanation in left
            if explanation.name == name != NONE and name not in in_full
        ][: MOST_REFITS - len(in_full)]
        if not due:
            break
        full_models = parallel_map(
            lambda explanation: _in_full(forward, linear, explanation), due, workers=forward.workers
        )
        for explanation, full in zip(due, full_models, strict=True):
            in_full[explanation.name] = full
            if full.failed:
                without[explanation.name] = full.failed
    verdict = names[0] if len(names) == 1 else names
    listed = (
        hypothesis
        for hypothesis in ranking
        if "+" not in hypothesis.name or hypothesis.probability >= LEAST_LISTED
    )
    return ModelSelection(ranking=tuple(listed), verdict=verdict, without=without)


def _ranking(
    linear: LinearRound, left: Sequence[LinearExplanation], in_full: dict[str, _InFull]
) -> list[Hypothesis]:
    """All explanations with their probabilities, likeliest first."""
    shares, unknown = probabilities(
        [_weighed(linear, explanation, in_full.get(explanation.name)) for explanation in left]
    )
    hypotheses = [
        Hypothesis(
            name=explanation.name,
            gain=explanation.weighed.gain,
            probability=float(share),
            linear_fits=explanation.linear_fits,
            refit=in_full[explanation.name].refits[0][1] if explanation.name in in_full else None,
            modulus_change=explanation.modulus_change,
            alternatives=in_full[explanation.name].alternatives if explanation.name in in_full else (),
        )
        for explanation, share in zip(left, shares, strict=True)
        if explanation.name not in in_full or in_full[explanation.name].refits
    ]
    most = max(explanation.weighed.gain for explanation in left)
    hypotheses.append(Hypothesis(name=UNKNOWN, gain=most, probability=unknown, linear_fits=(), refit=None))
    return sorted(hypotheses, key=lambda hypothesis: -hypothesis.probability)


def _weighed(linear: LinearRound, explanation: LinearExplanation, full: _InFull | None) -> Weighed:
    """With what the full model leaves of the misfit, where there is one."""
    if full is None:
        return explanation.weighed
    if not full.refits:
        return replace(explanation.weighed, tenable=False)
    _, best = full.refits[0]
    return replace(explanation.weighed, misfit=best.fit.chi2 / linear.numbers)


def _in_full(forward: ForwardModel, linear: LinearRound, explanation: LinearExplanation) -> _InFull:
    """The full models over the pads in question."""
    refits, failed = list[tuple[float, Refit]](), ""
    for fits in product(*(_pads_that_may_be(linear, fit) for fit in explanation.linear_fits)):
        try:
            again = refit(forward, linear, fits)
        except FemFailure as failure:
            failed = failure.detail
            continue
        if any(again.at_an_end[1:]):
            failed = AT_AN_END
            continue
        refits.append((_gain(linear, again), again))
    if not refits:
        return _InFull(failed=failed)
    return _InFull(refits=tuple(sorted(refits, key=lambda tried: -tried[0])))


def _pads_that_may_be(linear: LinearRound, chosen: LinearFit) -> list[LinearFit]:
    """A signature, and where it is a pad's those of other pads that gain nearly as much.

    One pad moved and the other turned leave the forces balanced alike: only the full model parts them.
    """
    if not isinstance(chosen.signature.variant, OfPad):
        return [chosen]
    same = [fit for fit in linear.linear_fits if fit.name == chosen.name]
    most = max(fit.gain for fit in same)
    others = (
        fit
        for fit in same
        if fit.signature.variant != chosen.signature.variant and fit.gain > OTHER_PAD_SHARE * most
    )
    return [chosen, *others]


def _gain(linear: LinearRound, again: Refit) -> float:
    """Log Bayes factor of a full model over the plain model, all channels."""
    said = sum(
        effect.auxiliary_log_likelihood(again.forward, values, variant)
        for effect, values, variant in zip(again.effects, again.parameters, again.variants, strict=True)
        if isinstance(effect, AuxiliaryLikelihood)
    )
    moved = again.log_evidence - linear.null.log_evidence
    direct = sum(
        effect.direct_evidence(again.forward) for effect in again.effects if isinstance(effect, SeenDirectly)
    )
    return moved + min(said, max(moved, 0.0)) + direct
