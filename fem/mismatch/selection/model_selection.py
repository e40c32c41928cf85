"""Model selection: the short list of the screening refitted with full models, and the verdict.

Probabilities are by evidence divided by TEMPERATURE, since models of different effects share errors; that of
a hypothesis which was not refitted is by its linear evidence. Hypotheses whose probability is within
EQUAL_PROBABILITY of the best cannot be told apart. Two effects at once must add enough. Thresholds:
fem.mismatch.thresholds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from fem.fem_failure import FemFailure
from fem.mismatch.effect import AuxiliaryLikelihood, Effect, Signature
from fem.mismatch.gel_fault import faults_of_relation
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection.detection import null_gain, null_gain_in_full, null_statistic
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
    CLEAR_EXCESS,
    CLEAR_GAIN,
    CLEARLY_LARGELY,
    ENOUGH_GAIN,
    EQUAL_PROBABILITY,
    MOST_NULLS,
    MOST_PAIRS,
    MOST_SINGLES,
    NEAR_EQUAL,
    NOT_DETECTED_GAIN,
    OTHER_PAD_SHARE,
    PAIR_GAIN,
    PAIR_LEFT,
    PAIR_PLAIN_GAIN,
    PAIR_SHARE,
    PAIR_SHARE_ELSE,
    REFIT_SHARE,
    SIDE_BY_SIDE,
    TEMPERATURE,
    UNKNOWN_EXCESS,
    UNKNOWN_LEFT,
)
from fem.parallel_map import parallel_map


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """One explanation: its name, its gain in ln evidence (all channels, beyond what is usual on sound
    recordings), its probability, its refit. `alternatives`: the same with another pad, where that gains about
    as much: its share of the explanation's probability, and its refit.
    """

    name: str
    gain: float
    probability: float
    linear_fits: tuple[LinearFit, ...]
    refit: Refit | None
    alternatives: tuple[tuple[float, Refit], ...] = ()


@dataclass(frozen=True, kw_only=True)
class ModelSelection:
    """The ranking, best first (none is one of them), and the verdict.

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
        """Of others that cannot be told from this the share of both, and the refit."""
        weight = {k: np.exp((gain - self.gain) / TEMPERATURE) for k, (gain, _) in enumerate(self.others)}
        kept = {k: one for k, one in weight.items() if one >= EQUAL_PROBABILITY}
        return tuple((float(one / (1 + sum(kept.values()))), self.others[k][1]) for k, one in kept.items())

    @property
    def always_refitted(self) -> bool:
        return any(one.effect.spec.always_refitted for one in self.linear_fits)


@dataclass(frozen=True, kw_only=True)
class NullCase:
    """What null recordings of this size and flesh show (fem.mismatch.selection.null_reference).

    `chi2`, `most_chi2`: what the plain model leaves of them usually, and of all but a few;
    `compliance_ratio`: of this flesh (fem.mismatch.model.forward_model).
    """

    chi2: float
    most_chi2: float
    compliance_ratio: float

    def excess_gain(self, one: LinearFit, gain: float | None = None) -> float:
        """A signature's gain (or the given one) less its null quantile."""
        return (one.gain if gain is None else gain) - null_gain(one.name, self.compliance_ratio)

    def in_full(self, effects: Sequence[Effect]) -> float:
        """Null quantile of a refitted effect's gain; of two effects the greater."""
        return null_gain_in_full([effect.spec.name for effect in effects], self.compliance_ratio)

    @property
    def least(self) -> float:
        """MOST_NULLS quantile of the best effect's excess gain on null cases: less selects nothing."""
        return self.compliance_ratio * max(null_statistic("best single", MOST_NULLS), 0.0)


def select_likelier_model(
    forward: ForwardModel, linear: LinearRound, *, detected: bool, null_case: NullCase
) -> tuple[LinearRound, ModelSelection]:
    """`select_model`, and the linear round that it rests on: of flesh that deforms largely or of flesh that
    moves little, whose best full model has more evidence. Where signatures say clearly which, the other is
    not tried; a strong effect's own signature may be too weak for that.
    """
    other = linear.other
    both = detected and other is not None and abs(linear.largely) <= CLEARLY_LARGELY
    found, *others = parallel_map(
        lambda one: select_model(forward, one, detected=detected, null_case=null_case),
        [linear, other] if both and other is not None else [linear],
        workers=forward.workers,
    )
    if other is None or not others:
        return linear, found
    (again,) = others
    evidence, of_other = (
        one.null.log_evidence + max([0.0, *(own.gain for own in selected.ranking)])
        for one, selected in ((linear, found), (other, again))
    )
    more = evidence - of_other if linear.largely > 0 else of_other - evidence
    if of_other <= evidence:
        return replace(linear, largely=more), found
    return replace(other, largely=more, other=linear), again


def select_model(
    forward: ForwardModel, linear: LinearRound, *, detected: bool, null_case: NullCase
) -> ModelSelection:
    """Ranking and verdict after refitting the best single effects and pairs; none first if nothing was
    detected.
    """
    best: dict[str, LinearFit] = {}
    for one in sorted(linear.linear_fits, key=null_case.excess_gain, reverse=True):
        best.setdefault(one.effect.spec.name, one)
    found = [_Candidate(name, null_case.excess_gain(one), (one,)) for name, one in best.items()]
    polished, failed = None, list[_Candidate]()
    if detected:
        found = refitted_singles(forward, linear, found, null_case)
        if found and found[0].refit is not None:
            # first: a second effect must not stand for what more rounds would still gain
            found[0] = polished = _polished(forward, linear, found[0], found[0].refit, null_case)
        if found and found[0].refit is not None:
            pairs = _pairs(forward, linear, found[0], found[0].refit, null_case)
            found += [one for one in pairs if one.refit is not None]
            failed = [one for one in pairs if one.refit is None]
    none = 0.0 if detected else max([null_case.least, *(one.gain for one in found)]) + NOT_DETECTED_GAIN
    found = sorted([*found, _Candidate(NONE, none)], key=lambda one: -one.gain)
    if found[0].refit is not None and found[0] is not polished:
        found[0] = _polished(forward, linear, found[0], found[0].refit, null_case)
    weight = np.exp((np.array([one.gain for one in found]) - found[0].gain) / TEMPERATURE)
    weight /= weight.sum()
    ranking = tuple(
        Hypothesis(
            name=one.name,
            gain=one.gain,
            probability=float(p),
            linear_fits=one.linear_fits,
            refit=one.refit,
            alternatives=one.alternatives,
        )
        for one, p in zip(found, weight, strict=True)
    )
    verdict = verdict_of(linear, ranking, null_case) if detected else NONE
    without = {one.name: one.failed for one in (*found, *failed) if one.failed and one.refit is None}
    return ModelSelection(ranking=ranking, verdict=verdict, without=without)


def refitted_singles(
    forward: ForwardModel, linear: LinearRound, found: Sequence[_Candidate], null_case: NullCase
) -> list[_Candidate]:
    """Promising candidates refitted, best first; the best of all is refitted wherever it can be.

    The first alone, as its gain spares others their way to the end; then SIDE_BY_SIDE at once, each held
    against those before them alone, so that threads change no answer.
    """
    most = max((one.gain for one in found), default=0.0)
    best, at_once, tried, waiting = 0.0, 1, list[_Candidate](), list(enumerate(found))
    while waiting:
        enough = best > ENOUGH_GAIN * (linear.null.chi2 - null_case.chi2) / 2
        share = NEAR_EQUAL if enough else REFIT_SHARE
        due: list[_Candidate] = []
        while waiting and len(due) < at_once:
            number, one = waiting.pop(0)
            hopeful = number < MOST_SINGLES and one.gain > share * most
            (due if hopeful or one.always_refitted else tried).append(one)
        in_full = partial(_refitted, forward, linear, best=best, null_case=null_case)
        refitted, at_once = parallel_map(in_full, due, workers=forward.workers), SIDE_BY_SIDE
        tried += refitted
        best = max([best, *(one.gain for one in refitted if one.refit is not None)])
    for _ in found:
        tried.sort(key=lambda one: -one.gain)
        if tried[0].refit is not None:
            break
        again = _refitted(forward, linear, tried[0], best=best, null_case=null_case)
        tried[0] = again if again.refit is not None else replace(again, gain=min(again.gain, 0.0))
    return tried


def _refitted(
    forward: ForwardModel, linear: LinearRound, one: _Candidate, *, best: float, null_case: NullCase
) -> _Candidate:
    """The best refit over the pads in question; unchanged where no model can be computed."""
    found, failed = [], ""
    for linear_fit in _pads_that_may_be([(own.gain, own) for own in linear.linear_fits], *one.linear_fits):
        try:
            again = refit(forward, linear, (linear_fit,), beat=best)
        except FemFailure as failure:
            failed = failure.detail
            continue
        gain = _gain(linear, again, null_case)
        found.append(replace(one, gain=gain, linear_fits=(linear_fit,), refit=again))
        best = max(best, gain)
    if not found:
        return replace(one, failed=failed)
    first, *rest = sorted(found, key=lambda tried: -tried.gain)
    return replace(
        first, others=tuple((other.gain, other.refit) for other in rest if other.refit is not None)
    )


def _pads_that_may_be(gains: Sequence[tuple[float, LinearFit]], one: LinearFit) -> list[LinearFit]:
    """A signature, and where it is a pad's those of other pads that gain nearly as much.

    One pad moved and the other turned leave the forces balanced alike: only the full model parts them.
    """
    if not isinstance(one.signature.variant, OfPad):
        return [one]
    same = [(gain, own) for gain, own in gains if own.effect.spec.name == one.effect.spec.name]
    most = max(gain for gain, _ in same)
    return [
        one,
        *(
            own
            for gain, own in same
            if own.signature.variant != one.signature.variant and gain > OTHER_PAD_SHARE * most
        ),
    ]


def _gain(linear: LinearRound, again: Refit, null_case: NullCase) -> float:
    """ln evidence over that of the plain model, less the null quantile."""
    auxiliary_log_likelihood = sum(
        effect.auxiliary_log_likelihood(again.forward, own, variant)
        for effect, own, variant in zip(again.effects, again.parameters, again.variants, strict=True)
        if isinstance(effect, AuxiliaryLikelihood)
    )
    moved = again.log_evidence - linear.null.log_evidence
    direct = direct_evidence(again.forward, again.effects)
    return moved + min(auxiliary_log_likelihood, max(moved, 0.0)) + direct - null_case.in_full(again.effects)


def _pairs(
    forward: ForwardModel, linear: LinearRound, best: _Candidate, single: Refit, null_case: NullCase
) -> list[_Candidate]:
    """Pairs of the best single with what adds most to it, refitted, that earn their place; and those of which
    no model could be computed, without a refit.
    """
    found = []
    least = max(PAIR_GAIN, null_case.least)
    if single.fit.chi2 <= null_case.most_chi2:
        least = max(least, PAIR_PLAIN_GAIN * null_case.compliance_ratio)
    bends = any(spec.strain_power for effect in single.effects for spec in effect.spec.searched)
    least = max(least, (PAIR_SHARE if bends else PAIR_SHARE_ELSE) * best.gain)
    may_leave = null_case.most_chi2 + PAIR_LEFT * (single.fit.chi2 - null_case.chi2)
    gains = added_gains(linear, single)
    best_of: dict[str, tuple[float, LinearFit]] = {}
    for gain, other in sorted(
        ((null_case.excess_gain(other, gain), other) for gain, other in gains), key=lambda g: -g[0]
    ):
        best_of.setdefault(other.effect.spec.name, (gain, other))
    second = second_faults(linear, single)
    if faults_of_relation(single.effects):
        # what a fault shows alone says little beside another
        best_of = {name: own for name, own in best_of.items() if not faults_of_relation([own[1].effect])}
    of_gels = [(own.evidence, _without_signature(own)) for own in second.values()]
    for gain, other in [*list(best_of.values())[:MOST_PAIRS], *of_gels]:
        if gain < least:
            continue
        tried, failed = [], ""
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
                tried.append((_gain(linear, again, null_case), again, both))
        if not tried:
            if failed:
                found.append(_Candidate(f"{best.name}+{other.effect.spec.name}", -np.inf, failed=failed))
            continue
        (gained, again, both), *rest = sorted(tried, key=lambda pair: -pair[0])
        if gained > best.gain + least and again.fit.chi2 < may_leave:
            others = tuple((gain, refitted) for gain, refitted, _ in rest)
            found.append(_Candidate(again.name, gained, both, again, others=others))
    return found


def _without_signature(own: SecondFault) -> LinearFit:
    """A fault of the gel by what the relation shows of it beside another, whatever it shows alone."""
    return LinearFit(
        effect=own.fault,
        signature=Signature(variant=ONE_WAY, columns=()),
        columns=(),
        amounts=np.zeros(0),
        gain=own.evidence,
        auxiliary_log_likelihood=own.evidence,
        chi2_drop=0.0,
        modulus_spread=0.0,
        direct=own.evidence,
    )


def _polished(
    forward: ForwardModel, linear: LinearRound, one: _Candidate, first: Refit, null_case: NullCase
) -> _Candidate:
    """The refit carried on for as long as it gains."""
    try:
        again = refit(forward, linear, one.linear_fits, known=first)
    except FemFailure:
        return one
    if again.log_evidence <= first.log_evidence:
        return replace(one, refit=replace(first, last_gain=again.last_gain))
    if again.at_an_end[-1] and not first.at_an_end[-1]:
        return one
    return replace(one, gain=_gain(linear, again, null_case), refit=again)


def verdict_of(
    linear: LinearRound, ranking: Sequence[Hypothesis], null_case: NullCase
) -> str | tuple[str, ...]:
    """The name of the one likely effect, or all that cannot be told apart, or "unknown": where nothing gains
    more than effects do on null cases, or the best leaves more chi-square than those do. What the recordings
    themselves show plainly (SeenDirectly) is named whatever is left beside it.
    """
    first = next((one for one in ranking if one.name != NONE), None)
    if first is None or first.refit is None or first.gain <= null_case.least:
        return UNKNOWN
    before, after = linear.null.chi2 - null_case.chi2, first.refit.fit.chi2 - null_case.chi2
    direct = direct_evidence(first.refit.forward, first.refit.effects)
    excess = CLEAR_EXCESS if first.gain > CLEAR_GAIN else UNKNOWN_EXCESS
    if direct < CLEAR_GAIN and after > max(UNKNOWN_LEFT * before, excess * null_case.chi2):
        return UNKNOWN
    indistinguishable = tuple(
        one.name
        for one in ranking
        if one.name != NONE and one.probability >= EQUAL_PROBABILITY * first.probability and one.gain > 0
    )
    return indistinguishable[0] if len(indistinguishable) == 1 else indistinguishable
