"""Model selection: the posterior of all explanations, by full models of those that may matter.

Linear signatures say which do (fem.mismatch.selection.explanations, .decision). A large effect is not in
proportion to its signature, so that another one's may resemble it better. Therefore the effects that gain
nearly as much as the best one, and what the verdict holds, are refitted, MOST_REFITS of them at most. The
full models say how large each effect is, what it gains, and what it leaves of the misfit; with that the
probabilities are computed again. An explanation cannot be named where its model cannot be computed, or where
its second effect ends at the bounds of its parameters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np

from fem.fem_failure import FemFailure
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.result import NONE
from fem.mismatch.selection.decision import TEMPERATURE, verdict_of
from fem.mismatch.selection.explanations import Hypothesis, all_explanations, mean_gain, ranked
from fem.mismatch.selection.refinement import Refit, refit
from fem.mismatch.selection.screening import LinearFit, LinearRound
from fem.mismatch.signature_variant import Variant
from fem.parallel_map import parallel_map

MOST_REFITS = 8
"""Explanations that are refitted at most, the likeliest first. Set by hand, to bound time."""
NEGLIGIBLE = 0.02
"""The same effect on another pad is left out below this ratio of probabilities. Set by hand, below the share
that a verdict may lack."""
LEAST_LISTED = 1e-3
"""Probability from which a pair of effects is listed."""
NEARLY = 0.5
"""Share of the greatest linear gain from which another effect, or an effect on another pad, is refitted too.
With three misplaced pads the wrong one gained as much or a little more (`benchmarks/mismatch.py`)."""
AT_AN_END = "its second effect ends at the limit of its parameters"


@dataclass(frozen=True, kw_only=True)
class ModelSelection:
    """The ranking, likeliest first ("none" and "unknown" are in it), and the verdict.

    `without`: explanations whose model could not be computed, and why.
    """

    ranking: tuple[Hypothesis, ...]
    verdict: str | tuple[str, ...]
    without: dict[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        """Those of the verdict."""
        return (self.verdict,) if isinstance(self.verdict, str) else self.verdict


def select_model(model: CaseModel, linear: LinearRound, *, p_value: float) -> ModelSelection:
    """Ranking and verdict, with the full models of what the verdict holds."""
    in_full, without = dict[str, Hypothesis](), dict[str, str]()
    while True:
        hypotheses = all_explanations(linear, in_full)
        ranking = ranked(hypotheses)
        names = verdict_of(
            {hypothesis.name: hypothesis.probability for hypothesis in ranking}, p_value=p_value
        )
        due = [] if names == (NONE,) else _due(ranking, names, in_full)
        if not due:
            break
        for hypothesis, failed in parallel_map(
            lambda hypothesis: _in_full(model, linear, hypothesis), due, workers=model.workers
        ):
            in_full[hypothesis.name] = hypothesis
            if not hypothesis.tenable:
                without[hypothesis.name] = failed
    listed = (
        hypothesis
        for hypothesis in ranking
        if "+" not in hypothesis.name or hypothesis.probability >= LEAST_LISTED
    )
    verdict = names[0] if len(names) == 1 else names
    return ModelSelection(ranking=tuple(listed), verdict=verdict, without=without)


def _due(
    ranking: Sequence[Hypothesis], names: Sequence[str], in_full: Mapping[str, Hypothesis]
) -> list[Hypothesis]:
    """Those to refit next: effects whose signatures gain nearly as much as the best, and the verdict's."""
    effects = [hypothesis for hypothesis in ranking if hypothesis.linear_fits]
    singles = [] if in_full else [hypothesis for hypothesis in effects if "+" not in hypothesis.name]
    most = max((single.gain for single in singles), default=0.0)
    near = {single.name for single in singles if single.gain > NEARLY * most > 0}
    due = (
        hypothesis
        for hypothesis in effects
        if hypothesis.name not in in_full and hypothesis.name in near.union(names)
    )
    return list(islice(due, MOST_REFITS - len(in_full)))


def _in_full(model: CaseModel, linear: LinearRound, hypothesis: Hypothesis) -> tuple[Hypothesis, str]:
    """With its full models over the pads in question, what an effect gains by them, and what they leave of
    the misfit; else untenable, and why.
    """
    refits, failed = list[tuple[float, Refit]](), ""
    for fits in product(*(_pads_that_may_be(linear, fit) for fit in hypothesis.linear_fits)):
        try:
            again = refit(model, linear, fits)
        except FemFailure as failure:
            failed = failure.detail
            continue
        if any(again.at_an_end[1:]):
            failed = AT_AN_END
            continue
        refits.append((_gain(linear, again), again))
    if not refits:
        return replace(hypothesis, tenable=False), failed
    (most, best), *others = sorted(refits, key=lambda tried: -tried[0])
    weight = [(float(np.exp((gain - most) / TEMPERATURE)), again) for gain, again in others]
    kept = [(share, again) for share, again in weight if share >= NEGLIGIBLE]
    total = 1 + sum(share for share, _ in kept)
    return replace(
        hypothesis,
        gain=_mean_gain(linear, hypothesis, refits),
        refit=best,
        misfit=best.fit.chi2 / linear.numbers,
        alternatives=tuple((share / total, again) for share, again in kept),
    ), ""


def _mean_gain(linear: LinearRound, hypothesis: Hypothesis, refits: Sequence[tuple[float, Refit]]) -> float:
    """Of one effect over the ways that a search keeps to, those refitted by their full models; of a pair by
    signatures.
    """
    if len(hypothesis.linear_fits) > 1:
        return hypothesis.gain
    ways: dict[tuple[str, bool | None], list[float]] = {}
    for fit in linear.linear_fits:
        if fit.name == hypothesis.name:
            ways.setdefault(_kept(fit.signature.variant), []).append(fit.gain)
    gains = {way: mean_gain(each) for way, each in ways.items()}
    gains |= {_kept(again.variants[0]): gain for gain, again in refits}
    return mean_gain(list(gains.values()))


def _kept(variant: Variant) -> tuple[str, bool | None]:
    """What a search keeps of a variant; its parameters' values it moves."""
    return variant.pad, variant.pit_turns


def _pads_that_may_be(linear: LinearRound, chosen: LinearFit) -> list[LinearFit]:
    """A signature, and where it is a pad's those of other pads that gain nearly as much.

    One pad moved and the other turned leave the forces balanced alike: only the full model parts them.
    """
    if not chosen.signature.variant.pad:
        return [chosen]
    same = [fit for fit in linear.linear_fits if fit.name == chosen.name]
    most = max(fit.gain for fit in same)
    others = (
        fit for fit in same if fit.signature.variant != chosen.signature.variant and fit.gain > NEARLY * most
    )
    return [chosen, *others]


def _gain(linear: LinearRound, again: Refit) -> float:
    """Log Bayes factor of a full model over the plain model, all channels."""
    said = sum(
        effect.auxiliary_log_likelihood(again.model, values, variant)
        for effect, values, variant in zip(again.effects, again.parameters, again.variants, strict=True)
    )
    moved = again.log_evidence - linear.null.log_evidence
    direct = sum(effect.direct_evidence(again.model) for effect in again.effects)
    return moved + min(said, max(moved, 0.0)) + direct
