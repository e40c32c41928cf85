"""All explanations: none, every effect, and every pair that the data support.

An effect's evidence is the mean over its signatures, or that of its full model after a refit. A pair is the
effect of the greater evidence and a second one, which counts by the evidence that its signature adds to the
first. A second effect that adds nothing makes no pair. Laws of effects are not exact (`law_error` of
fem.mismatch.effect_spec). Evidence against an explanation that the errors of its laws explain does not count
(`hidden`): otherwise another effect would be named for them. The best explanation counts in full against
"none".
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from fem.mismatch.effect_spec import LAW_ERROR
from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.gel_fault import is_of_relation
from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection.decision import Weighed, probabilities
from fem.mismatch.selection.refinement import Refit
from fem.mismatch.selection.screening import (
    LinearFit,
    LinearRound,
    modulus_change,
    violates_sign_constraint,
    without_model_error,
)


@dataclass(frozen=True, kw_only=True)
class _Law:
    """The equations of all signatures given an effect, the error of its law as a share of its signal, and
    the signal: the chi-square that it explains. `apart`: the effects that make no pair with it, and itself.
    """

    equations: SignatureEquations
    share: float
    signal: float
    apart: frozenset[str]

    def noise(self, columns: Sequence[int]) -> float:
        """Variance of the law's error along a signature, over that of the noise."""
        return self.share**2 * max(self.signal, 0.0) * self.equations.resemblance[tuple(columns)]


@dataclass(frozen=True, kw_only=True)
class Hypothesis(Weighed):
    """One explanation, and the linear fits of its effects: none for "none", two for a pair.

    `modulus_change`: E with the effects over E without, and the relative standard deviation that they add, by
    linear signatures; None for unknown physics, which leaves any `misfit`. `probability`: among all, from
    `ranked`. `refit`: its full model, which then gives `misfit`, and `gain` for a single effect.
    `alternatives`: the same effects on another pad with a similar gain: share of the explanation's
    probability, and refit.
    """

    misfit: float = float("nan")
    linear_fits: tuple[LinearFit, ...] = ()
    modulus_change: tuple[float, float] | None = (1.0, 0.0)
    probability: float = float("nan")
    refit: Refit | None = None
    alternatives: tuple[tuple[float, Refit], ...] = ()


def ranked(hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
    """All tenable explanations with their probabilities, and "unknown", the likeliest first."""
    weighed = list(hypotheses)
    shares, unknown = probabilities(weighed)
    ranking = [
        replace(hypothesis, probability=float(share))
        for hypothesis, share in zip(weighed, shares, strict=True)
        if hypothesis.tenable
    ]
    most = max(hypothesis.gain for hypothesis in weighed)
    ranking.append(Hypothesis(name=UNKNOWN, gain=most, probability=unknown, modulus_change=None))
    return sorted(ranking, key=lambda hypothesis: -hypothesis.probability)


def all_explanations(
    linear: LinearRound, in_full: Mapping[str, Hypothesis] | None = None
) -> list[Hypothesis]:
    """The explanations, "none" last. `in_full`: those with a full model, by name. In a pair the second effect
    still counts by its signature, but the pair for no more than its full model.
    """
    known = in_full or {}
    singles = [known.get(fits[0].name) or _single(linear, fits) for fits in _ways(linear.linear_fits)]
    singles.sort(key=lambda single: -single.gain)
    laws = {single.name: _law(linear, single) for single in singles}
    pairs = [_no_better_than(known.get(pair.name), pair) for pair in _pairs(linear, singles, laws)]
    singles = [replace(single, hidden=_hidden_single(single.name, pairs, laws)) for single in singles]
    none = Hypothesis(name=NONE, gain=0.0, misfit=misfit_left(linear, ()))
    best = max((none, *singles, *pairs), key=lambda each: each.gain + each.hidden)
    return [*(replace(each, hidden=each.hidden - best.hidden) for each in (*singles, *pairs)), none]


def _no_better_than(in_full: Hypothesis | None, pair: Hypothesis) -> Hypothesis:
    if in_full is None:
        return pair
    return replace(in_full, gain=min(pair.gain, in_full.gain), direct=pair.direct, hidden=pair.hidden)


def misfit_left(linear: LinearRound, fits: Sequence[LinearFit]) -> float:
    """The chi-square per number that these linear fits leave."""
    return (linear.null.chi2 - sum(fit.chi2_drop for fit in fits)) / linear.numbers


def _ways(fits: Sequence[LinearFit]) -> list[list[LinearFit]]:
    """The signatures of each effect, the best first."""
    ways: dict[str, list[LinearFit]] = {}
    for fit in sorted(fits, key=lambda fit: -fit.gain):
        ways.setdefault(fit.name, []).append(fit)
    return list(ways.values())


def mean_gain(gains: Sequence[float]) -> float:
    """ln of the mean Bayes factor."""
    return float(logsumexp(gains) - np.log(len(gains)))


def _single(linear: LinearRound, fits: Sequence[LinearFit]) -> Hypothesis:
    best = fits[0]
    return Hypothesis(
        name=best.name,
        gain=mean_gain([fit.gain for fit in fits]),
        misfit=misfit_left(linear, (best,)),
        direct=best.direct,
        read_correctly=best.direct if is_of_relation(best.effect) else None,
        linear_fits=(best,),
        modulus_change=_mixture(fits),
    )


def _mixture(fits: Sequence[LinearFit]) -> tuple[float, float]:
    """Mixture of `modulus_change` over the signatures, weighted by evidence: the pad may be unknown."""
    gains = np.array([fit.gain for fit in fits])
    share = np.exp(gains - logsumexp(gains))
    changes, added = np.array([fit.modulus_change for fit in fits]).T
    mean = float(share @ changes)
    return mean, float(np.sqrt(share @ (added**2 + (changes - mean) ** 2)))


def _pairs(linear: LinearRound, singles: Sequence[Hypothesis], laws: Mapping[str, _Law]) -> list[Hypothesis]:
    """Each effect with every one of smaller evidence that adds evidence to it."""
    pairs = []
    ways = {fits[0].name: fits for fits in _ways(linear.linear_fits)}
    for number, first in enumerate(singles):
        (fit,) = first.linear_fits
        law = laws[first.name]
        for second in singles[number + 1 :]:
            if second.name in law.apart:
                continue
            added = [_second(linear, law.equations, way) for way in ways[second.name]]
            gain = mean_gain([way.gain for way in added])
            best = max(added, key=lambda way: way.gain)
            if gain > 0 and best.gain > 0:
                columns, remaining, drop = (*fit.columns, *best.columns), law.equations, 0.0
                if best.columns:
                    remaining, drop = remaining.given(remaining.numbers(best.columns))
                pairs.append(
                    Hypothesis(
                        name="+".join(sorted((first.name, second.name))),
                        gain=first.gain + gain,
                        hidden=max(
                            _hidden(
                                remaining,
                                {first.name: law, second.name: replace(laws[second.name], signal=drop)},
                            ).values(),
                            default=0.0,
                        ),
                        misfit=first.misfit - drop / linear.numbers,
                        direct=first.direct + best.direct,
                        read_correctly=_read_correctly(first, second),
                        linear_fits=(fit, best),
                        modulus_change=modulus_change(
                            linear.products,
                            without_model_error(linear.products, linear.nuisances),
                            linear.products.fit([*linear.nuisances, *columns]),
                            columns,
                        ),
                    )
                )
    return pairs


def _read_correctly(first: Hypothesis, second: Hypothesis) -> float | None:
    """Of a pair: the direct evidence of the fault of a gel, and all evidence of the other effect."""
    for fault, other in ((first, second), (second, first)):
        if fault.read_correctly is not None:
            return fault.read_correctly + other.gain
    return None


def _law(linear: LinearRound, single: Hypothesis) -> _Law:
    """By the effect's full model if there is one, else by its signature, which is not exact for any law."""
    (fit,) = single.linear_fits
    again, apart = single.refit, _apart(linear, fit)
    if again is not None and again.others is not None:
        share = fit.effect.spec.law_error
        return _Law(equations=again.others, share=share, signal=again.signal, apart=apart)
    if not fit.columns:  # its evidence is direct: it does not change the motion
        return _Law(equations=linear.equations, share=0.0, signal=0.0, apart=apart)
    equations, _ = linear.equations.given(linear.equations.numbers(fit.columns))
    return _Law(equations=equations, share=LAW_ERROR, signal=fit.chi2_drop, apart=apart)


def _apart(linear: LinearRound, fit: LinearFit) -> frozenset[str]:
    """The effect and those that make no pair with it: two faults of one gel relation resemble each other."""
    faults = frozenset(other.name for other in linear.linear_fits if is_of_relation(other.effect))
    return faults if fit.name in faults else frozenset({fit.name})


def _hidden(equations: SignatureEquations, laws: Mapping[str, _Law]) -> dict[str, float]:
    """Log evidence against an explanation that the errors of its effects' `laws` explain, by the other effect
    that speaks against it: what the data say for that effect beside the explanation if these laws are exact,
    less what they say in the noise of the errors. `equations`: given the explanation.
    """
    hidden = {}
    for name, ways in equations.ways.items():
        if not len(ways) or any(name in law.apart for law in laws.values()):
            continue
        exact = _added(equations, ways, [0.0] * len(ways))
        if exact > 0:
            noise = [sum(law.noise(way) for law in laws.values()) for way in ways]
            hidden[name] = exact - max(_added(equations, ways, noise), 0.0)
    return hidden


def _hidden_single(name: str, pairs: Sequence[Hypothesis], laws: Mapping[str, _Law]) -> float:
    """The greatest `_hidden` of a single effect. What a pair hides is hidden from its effects, too."""
    by_effect = _hidden(laws[name].equations, {name: laws[name]})
    by_pair = {pair.name: pair.hidden for pair in pairs}
    return max(
        (alone + by_pair.get("+".join(sorted((name, other))), 0.0) for other, alone in by_effect.items()),
        default=0.0,
    )


def _added(equations: SignatureEquations, ways: Sequence[Sequence[int]], noise: Sequence[float]) -> float:
    """Log Bayes factor of an effect in additional noise, the mean over its signatures."""
    return mean_gain(
        [
            float(equations.log_bayes_factor(way, equations.right[None], noise=1 + more)[0])
            for way, more in zip(ways, noise, strict=True)
        ]
    )


def _second(linear: LinearRound, equations: SignatureEquations, fit: LinearFit) -> LinearFit:
    """A signature's fit given a first effect; its gain is the evidence that it adds."""
    if not fit.columns:
        return fit
    numbers = equations.numbers(fit.columns)
    amounts = equations.amounts(numbers)
    moved = float(equations.log_bayes_factor(numbers, equations.right[None])[0])
    wrong = violates_sign_constraint(linear.products, fit.columns, amounts)
    said = min(fit.auxiliary_log_likelihood - fit.direct, max(moved, 0.0))
    return replace(fit, amounts=amounts, gain=-np.inf if wrong else moved + said + fit.direct)
