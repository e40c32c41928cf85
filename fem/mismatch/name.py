"""Which explanation: the linear round's short list refitted in full, and what to call it.

Probabilities are those of the refitted explanations and of none, by evidence tempered by TEMPER: sound
recordings show spurious gains that many times what independent noise would. Explanations whose probability is
within LIKE of the best cannot be told apart. Two effects at once must earn it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fem.mismatch.explanation import NONE, UNKNOWN
from fem.mismatch.ground import Ground
from fem.mismatch.refit import Refit, refit
from fem.mismatch.singles import LinearRound, Shown

SINGLES, PAIRS = 5, 2
TEMPER = 1.5
HOPE = 0.15
"""Share of the best linear gain from which an effect is worth its nonlinear refit."""
ALWAYS = ("pit_size",)
"""Refitted however little the linear round makes of them: a pit a quarter smaller is far from linear."""
LIKE = 1 / 20
PAIR_GAIN, PAIR_SHARE = 10.0, 0.05
"""ln evidence, and share of the best single's, that a pair must add to it."""
LEFT, MUCH = 0.6, 0.2
"""Share of the excess chi-square that the best explanation may leave, and the excess as a share of what sound
recordings leave; where it leaves more of both, it is none of the catalogue."""


@dataclass(frozen=True, kw_only=True)
class Ranked:
    """One explanation: its name, its gain in ln evidence (all channels), its probability, its refit."""

    name: str
    gain: float
    probability: float
    shown: tuple[Shown, ...]
    refit: Refit | None


@dataclass(frozen=True, kw_only=True)
class Named:
    """The ranking, best first (none is one of them), and the verdict."""

    ranking: tuple[Ranked, ...]
    verdict: str | tuple[str, ...]


def named(
    ground: Ground, linear: LinearRound, *, cone_gain: float, detected: bool, sound_chi2: float
) -> Named:
    """Refits the best singles and pairs.

    `cone_gain`: what the friction cone adds to slip's evidence; `sound_chi2`: what sound recordings
    of this size leave.
    """

    def bonus(shown: Sequence[Shown]) -> float:
        return max(cone_gain, 0.0) if any(one.effect.name == "slip" for one in shown) else 0.0

    singles = sorted(linear.best, key=lambda one: -(one.gain + bonus([one])))
    found: list[tuple[str, float, tuple[Shown, ...], Refit | None]] = []
    first = max((one.gain + bonus([one]) for one in singles), default=0.0)
    for number, one in enumerate(singles):
        again = None
        hopeful = number < SINGLES and one.gain + bonus([one]) > HOPE * first
        if detected and (hopeful or one.effect.name in ALWAYS):
            again = refit(ground, linear, [one])
        gain = one.gain if again is None else again.log_evidence - linear.null.log_evidence
        found.append((one.effect.name, gain + bonus([one]), (one,), again))
    best = max((entry[1] for entry in found), default=0.0)
    if detected:
        for gain, a, b in linear.pairs[:PAIRS]:
            if gain + bonus([a, b]) < best + PAIR_GAIN:
                continue
            again = refit(ground, linear, [a, b])
            if again is not None:
                own = again.log_evidence - linear.null.log_evidence + bonus([a, b])
                if own > best + max(PAIR_GAIN, PAIR_SHARE * best):
                    found.append((again.name, own, (a, b), again))
    found.append((NONE, 0.0, (), None))
    found.sort(key=lambda entry: -entry[1])
    name, gain, shown, winner = found[0]
    if winner is not None:
        polished = refit(ground, linear, shown, known=winner)
        if polished is not None and polished.log_evidence > winner.log_evidence:
            found[0] = (name, gain + polished.log_evidence - winner.log_evidence, shown, polished)
    weight = np.exp((np.array([entry[1] for entry in found]) - found[0][1]) / TEMPER)
    weight /= weight.sum()
    ranking = tuple(
        Ranked(name=name, gain=gain, probability=float(p), shown=shown, refit=again)
        for (name, gain, shown, again), p in zip(found, weight, strict=True)
    )
    return Named(ranking=ranking, verdict=_verdict(linear, ranking, detected=detected, sound_chi2=sound_chi2))


def _verdict(
    linear: LinearRound, ranking: Sequence[Ranked], *, detected: bool, sound_chi2: float
) -> str | tuple[str, ...]:
    if not detected:
        return NONE
    first = next((one for one in ranking if one.name != NONE), None)
    if first is None or first.gain <= 0:
        return UNKNOWN
    if first.refit is not None:
        before, after = linear.null.chi2 - sound_chi2, first.refit.fit.chi2 - sound_chi2
        if after > max(LEFT * before, MUCH * sound_chi2):
            return UNKNOWN
    alike = tuple(
        one.name
        for one in ranking
        if one.name != NONE and one.probability >= LIKE * first.probability and one.gain > 0
    )
    return alike[0] if len(alike) == 1 else alike
