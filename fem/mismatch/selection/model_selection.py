"""Model selection: the promising effects and pairs refitted with full models, and the verdict.

What each explanation is worth, and which of them the verdict holds: fem.mismatch.selection.decision.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fem.fem_failure import FemFailure
from fem.mismatch.effect import AuxiliaryLikelihood, Signature
from fem.mismatch.gel_fault import faults_of_relation
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection.decision import (
    TEMPERATURE,
    Weighed,
    credible_set,
    log_prior,
    log_usual,
    probabilities,
)
from fem.mismatch.selection.forward_selection import (
    SecondFault,
    added_gains,
    direct_evidence,
    second_faults,
)
from fem.mismatch.selection.refinement import Refit, refit
from fem.mismatch.selection.screening import LinearFit, LinearRound
from fem.mismatch.signature_variant import ONE_WAY, OfPad
from fem.mismatch.thresholds import (
    CLEARLY_LARGELY,
    MOST_PAIRS,
    MOST_SINGLES,
    NEGLIGIBLE,
    OTHER_PAD_SHARE,
    REFIT_SHARE,
    SIDE_BY_SIDE,
)
from fem.parallel_map import parallel_map


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """One explanation: its name, its log Bayes factor over the plain model (all channels), its probability,
    its refit. `alternatives`: the same with another pad, where that gains about as much: its share of the
    explanation's probability, and its refit.
    """

    name: str
    gain: float
    probability: float
    linear_fits: tuple[LinearFit, ...]
    refit: Refit | None
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
class _Candidate:
    name: str
    gain: float
    linear_fits: tuple[LinearFit, ...] = ()
    refit: Refit | None = None
    failed: str = ""
    others: tuple[tuple[float, Refit], ...] = ()
    """Gains and refits of the same with another pad."""

    @property
    def alternatives(self) -> tuple[tuple[float, Refit], ...]:
        """Of others that cannot be told apart from this the share of both, and the refit."""
        weight = {k: np.exp((gain - self.gain) / TEMPERATURE) for k, (gain, _) in enumerate(self.others)}
        kept = {k: share for k, share in weight.items() if share >= NEGLIGIBLE}
        return tuple(
            (float(share / (1 + sum(kept.values()))), self.others[k][1]) for k, share in kept.items()
        )

    @property
    def always_refitted(self) -> bool:
        return any(fit.effect.spec.always_refitted for fit in self.linear_fits)

    def weighed(self, linear: LinearRound) -> Weighed:
        """With the chi-square per number that it leaves, and its direct marks."""
        chi2 = linear.null.chi2 - sum(fit.chi2_drop for fit in self.linear_fits)
        direct = sum(fit.direct for fit in self.linear_fits)
        if self.refit is not None:
            chi2 = self.refit.fit.chi2
            direct = direct_evidence(self.refit.forward, self.refit.effects)
        return Weighed(name=self.name, gain=self.gain, misfit=chi2 / linear.numbers, direct=direct)


def select_likelier_model(
    forward: ForwardModel, linear: LinearRound, *, detected: bool
) -> tuple[LinearRound, ModelSelection]:
    """`select_model`, and the linear round that it rests on: of flesh that deforms largely or of flesh that
    moves little, whose best full model has more evidence. Where signatures say clearly which, the other is
    not tried; a strong effect's own signature may be too weak for that.
    """
    other = linear.other
    both = detected and other is not None and abs(linear.largely) <= CLEARLY_LARGELY
    found, *others = parallel_map(
        lambda tried: select_model(forward, tried, detected=detected),
        [linear, other] if both and other is not None else [linear],
        workers=forward.workers,
    )
    if other is None or not others:
        return linear, found
    (again,) = others
    evidence, of_other = (
        tried.null.log_evidence + max([0.0, *(hypothesis.gain for hypothesis in selected.ranking)])
        for tried, selected in ((linear, found), (other, again))
    )
    more = evidence - of_other if linear.largely > 0 else of_other - evidence
    if of_other <= evidence:
        return replace(linear, largely=more), found
    return replace(other, largely=more, other=linear), again


def select_model(forward: ForwardModel, linear: LinearRound, *, detected: bool) -> ModelSelection:
    """Ranking and verdict after refitting the best effects and pairs; "none" where nothing was detected."""
    candidates = [_Candidate(fit.name, fit.gain, (fit,)) for fit in linear.best]
    failed = list[_Candidate]()
    if detected:
        candidates = refitted_singles(forward, linear, candidates)
        if candidates and candidates[0].refit is not None:
            # first: a second effect must not stand for what more rounds would still gain
            candidates[0] = _polished(forward, linear, candidates[0], candidates[0].refit)
        if candidates and candidates[0].refit is not None:
            pairs = _pairs(forward, linear, candidates[0], candidates[0].refit)
            candidates += [pair for pair in pairs if pair.refit is not None]
            failed = [pair for pair in pairs if pair.refit is None]
    candidates.append(_Candidate(NONE, 0.0))
    shares, unknown = probabilities([candidate.weighed(linear) for candidate in candidates])
    hypotheses = [
        Hypothesis(
            name=candidate.name,
            gain=candidate.gain,
            probability=float(share),
            linear_fits=candidate.linear_fits,
            refit=candidate.refit,
            alternatives=candidate.alternatives,
        )
        for candidate, share in zip(candidates, shares, strict=True)
    ]
    most = max(candidate.gain for candidate in candidates)
    hypotheses.append(Hypothesis(name=UNKNOWN, gain=most, probability=unknown, linear_fits=(), refit=None))
    ranking = tuple(sorted(hypotheses, key=lambda hypothesis: -hypothesis.probability))
    names = credible_set(
        [hypothesis.name for hypothesis in ranking], [hypothesis.probability for hypothesis in ranking]
    )
    verdict = NONE if not detected else names[0] if len(names) == 1 else names
    without = {
        candidate.name: candidate.failed
        for candidate in (*candidates, *failed)
        if candidate.failed and candidate.refit is None
    }
    return ModelSelection(ranking=ranking, verdict=verdict, without=without)


def refitted_singles(
    forward: ForwardModel, linear: LinearRound, candidates: Sequence[_Candidate]
) -> list[_Candidate]:
    """Promising candidates refitted, best first; the best of all is refitted wherever it can be.

    The first alone, as its gain spares others their way to the end; then SIDE_BY_SIDE at once, each compared
    with those before them alone, so that threads change no answer.
    """
    most = max((candidate.gain for candidate in candidates), default=0.0)
    best, at_once, tried, waiting = 0.0, 1, list[_Candidate](), list(enumerate(candidates))
    while waiting:
        due: list[_Candidate] = []
        while waiting and len(due) < at_once:
            number, candidate = waiting.pop(0)
            hopeful = number < MOST_SINGLES and candidate.gain > REFIT_SHARE * most
            (due if hopeful or candidate.always_refitted else tried).append(candidate)
        in_full = partial(_refitted, forward, linear, best=best)
        refitted, at_once = parallel_map(in_full, due, workers=forward.workers), SIDE_BY_SIDE
        tried += refitted
        best = max([best, *(candidate.gain for candidate in refitted if candidate.refit is not None)])
    for _ in candidates:
        tried.sort(key=lambda candidate: -candidate.gain)
        if tried[0].refit is not None:
            break
        again = _refitted(forward, linear, tried[0], best=best)
        tried[0] = again if again.refit is not None else replace(again, gain=min(again.gain, 0.0))
    return tried


def _refitted(forward: ForwardModel, linear: LinearRound, single: _Candidate, *, best: float) -> _Candidate:
    """The best refit over the pads in question; unchanged where no model can be computed."""
    found, failed = [], ""
    for linear_fit in _pads_that_may_be([(fit.gain, fit) for fit in linear.linear_fits], *single.linear_fits):
        try:
            again = refit(forward, linear, (linear_fit,), beat=best)
        except FemFailure as failure:
            failed = failure.detail
            continue
        gain = _gain(linear, again)
        found.append(replace(single, gain=gain, linear_fits=(linear_fit,), refit=again))
        best = max(best, gain)
    if not found:
        return replace(single, failed=failed)
    first, *rest = sorted(found, key=lambda tried: -tried.gain)
    return replace(
        first, others=tuple((other.gain, other.refit) for other in rest if other.refit is not None)
    )


def _pads_that_may_be(gains: Sequence[tuple[float, LinearFit]], chosen: LinearFit) -> list[LinearFit]:
    """A signature, and where it is a pad's those of other pads that gain nearly as much.

    One pad moved and the other turned leave the forces balanced alike: only the full model parts them.
    """
    if not isinstance(chosen.signature.variant, OfPad):
        return [chosen]
    same = [(gain, fit) for gain, fit in gains if fit.effect.spec.name == chosen.effect.spec.name]
    most = max(gain for gain, _ in same)
    return [
        chosen,
        *(
            fit
            for gain, fit in same
            if fit.signature.variant != chosen.signature.variant and gain > OTHER_PAD_SHARE * most
        ),
    ]


def _gain(linear: LinearRound, again: Refit) -> float:
    """Log Bayes factor over the plain model, all channels."""
    auxiliary_log_likelihood = sum(
        effect.auxiliary_log_likelihood(again.forward, values, variant)
        for effect, values, variant in zip(again.effects, again.parameters, again.variants, strict=True)
        if isinstance(effect, AuxiliaryLikelihood)
    )
    moved = again.log_evidence - linear.null.log_evidence
    return (
        moved + min(auxiliary_log_likelihood, max(moved, 0.0)) + direct_evidence(again.forward, again.effects)
    )


def _pairs(forward: ForwardModel, linear: LinearRound, best: _Candidate, single: Refit) -> list[_Candidate]:
    """The best single beside each of the effects that add most to it, refitted, where the pair's probability
    is not negligible beside the single's; a pair whose model cannot be computed has no refit.

    The model error does not hold that of the first effect's own law, which grows with the effect. A second
    effect therefore counts for no more than the misfit itself says: the usual one of the pair against the
    unusual one of the single.
    """

    def log_misfit_ratio(first: Refit, both: Refit) -> float:
        before, after = (log_usual(refitted.fit.chi2 / linear.numbers) for refitted in (first, both))
        return max(after - before, 0.0)

    found = []
    gains = added_gains(linear, single)
    shown = direct_evidence(single.forward, single.effects)
    best_of: dict[str, tuple[float, LinearFit]] = {}
    for gain, other in gains:
        best_of.setdefault(other.effect.spec.name, (gain, other))
    second = second_faults(linear, single)
    if faults_of_relation(single.effects):
        # what a fault shows alone says little beside another
        best_of = {name: pair for name, pair in best_of.items() if not faults_of_relation([pair[1].effect])}
    of_gels = [(fault.evidence, _without_signature(fault)) for fault in second.values()]
    for gain, other in [*list(best_of.values())[:MOST_PAIRS], *of_gels]:
        name = "+".join(sorted((best.name, other.name)))
        of_pair, of_single = (log_prior(own, effects=len(linear.best)) for own in (name, best.name))
        if gain / TEMPERATURE + of_pair - of_single < np.log(NEGLIGIBLE):
            continue
        tried, failed = [], ""
        gain_with = {id(fit): added_gain for added_gain, fit in gains} | {id(other): gain}
        fault = second.get(other.name)
        starts = [*single.parameters, None] if fault is None else fault.starts
        for added in _pads_that_may_be(gains, other):
            both = (*best.linear_fits, added)
            try:
                again = refit(forward, linear, both, starts=starts, near=single.forward)
            except FemFailure as failure:
                failed = failure.detail
                continue
            disagrees = fault is not None and again.log_evidence <= single.log_evidence
            if not again.at_an_end[-1] and not disagrees:
                direct = direct_evidence(again.forward, again.effects) - shown
                moved = min(gain_with[id(added)] - direct, log_misfit_ratio(single, again))
                tried.append((best.gain + moved + direct, again, both))
        if not tried:
            if failed:
                found.append(_Candidate(name, -np.inf, failed=failed))
            continue
        (gained, again, both), *rest = sorted(tried, key=lambda pair: -pair[0])
        others = tuple((gain, refitted) for gain, refitted, _ in rest)
        found.append(_Candidate(again.name, gained, both, again, others=others))
    return found


def _without_signature(second: SecondFault) -> LinearFit:
    """A fault of the gel by what the relation shows of it beside another, whatever it shows alone."""
    return LinearFit(
        effect=second.fault,
        signature=Signature(variant=ONE_WAY, columns=()),
        columns=(),
        amounts=np.zeros(0),
        gain=second.evidence,
        auxiliary_log_likelihood=second.evidence,
        chi2_drop=0.0,
        modulus_change=(1.0, 0.0),
        direct=second.evidence,
    )


def _polished(forward: ForwardModel, linear: LinearRound, single: _Candidate, first: Refit) -> _Candidate:
    """The refit carried on for as long as it gains."""
    try:
        again = refit(forward, linear, single.linear_fits, known=first)
    except FemFailure:
        return single
    if again.log_evidence <= first.log_evidence:
        return replace(single, refit=replace(first, last_gain=again.last_gain))
    if again.at_an_end[-1] and not first.at_an_end[-1]:
        return single
    return replace(single, gain=_gain(linear, again), refit=again)
