"""How often the decision would name an effect if the linear model were exact: drawn, without any recording.

Products of a case with one effect of amounts a are b = N a + N^1/2 eps (SignatureEquations): eps holds
noise, nuisances and the model's own error, drawn from their priors. Amounts lie k bounds from zero,
a'N a = k^2 with N of the effect's own columns, in a direction drawn uniformly. The misfit is that of the
stored case plus what a adds. Explanations are none, single effects and "unknown"; pairs are left out, and
effects that only the gel's force shows, which have no columns.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection.decision import Weighed, probabilities
from fem.mismatch.selection.screening import LinearRound

FirstNames = dict[tuple[str, int], Counter[str]]
"""By effect and number of bounds, how often each name came first."""


def ideal_names(
    rounds: Sequence[LinearRound], *, multiples: Sequence[int], draws: int, rng: np.random.Generator
) -> FirstNames:
    """First names of `draws` draws, or a little more, spread evenly over the rounds."""
    named: FirstNames = {}
    for linear in rounds:
        truths, amounts = drawn_amounts(linear, multiples=multiples, count=-(-draws // len(rounds)), rng=rng)
        noise = linear.equations.drawn(len(truths), rng)
        signal = amounts @ linear.equations.normal
        added = ((2 * noise + signal) * amounts).sum(axis=1)
        for truth, name in zip(
            truths, first_names(linear, noise + signal, linear.null.chi2 + added), strict=True
        ):
            named.setdefault(truth, Counter())[name] += 1
    return named


def drawn_amounts(
    linear: LinearRound, *, multiples: Sequence[int], count: int, rng: np.random.Generator
) -> tuple[list[tuple[str, int]], Float[np.ndarray, "d c"]]:
    """Effects with their number of bounds, `count` times each, and the amounts of all columns."""
    equations = linear.equations
    truths = [(name, k) for name, ways in equations.ways.items() if len(ways) for k in multiples] * count
    amounts = np.zeros((len(truths), len(equations.right)))
    for row, (name, multiple) in zip(amounts, truths, strict=True):
        at = list(equations.ways[name][rng.integers(len(equations.ways[name]))])
        size, axes = np.linalg.eigh(equations.normal[np.ix_(at, at)])
        direction = rng.standard_normal(len(at))
        change = multiple * axes @ (direction / np.linalg.norm(direction) / np.sqrt(size))
        row[at] = np.where(equations.positive[at], abs(change), change)
    return truths, amounts


def first_names(
    linear: LinearRound, right: Float[np.ndarray, "d c"], misfit: Float[np.ndarray, " d"]
) -> list[str]:
    """The likeliest of none, every effect and "unknown" of each b; `misfit`: chi-square of none."""
    names, gains, drops = [], [], []
    for name, ways in linear.equations.ways.items():
        if len(ways):
            each = [_gain_and_drop(linear, list(columns), right) for columns in ways]
            of_ways, fall = np.array([gain for gain, _ in each]), np.array([drop for _, drop in each])
            names.append(name)
            gains.append(logsumexp(of_ways, axis=0) - np.log(len(ways)))
            drops.append(np.take_along_axis(fall, of_ways.argmax(axis=0)[None], axis=0)[0])
    first = []
    for k, whole in enumerate(misfit):
        explanations = [
            Weighed(name=name, gain=float(gain[k]), misfit=float(whole - drop[k]) / linear.numbers)
            for name, gain, drop in zip(names, gains, drops, strict=True)
        ]
        explanations.append(Weighed(name=NONE, gain=0.0, misfit=float(whole) / linear.numbers))
        shares, unknown = probabilities(explanations)
        first.append([*names, NONE, UNKNOWN][int(np.argmax([*shares, unknown]))])
    return first


def _gain_and_drop(
    linear: LinearRound, at: list[int], right: Float[np.ndarray, "d c"]
) -> tuple[np.ndarray, np.ndarray]:
    """Log Bayes factor and fall of chi-square of one signature; none with an amount that has no meaning."""
    equations = linear.equations
    normal = equations.normal[np.ix_(at, at)] + np.diag(equations.sd[at] ** -2.0)
    amounts = np.linalg.solve(normal, right[:, at].T).T
    gain, drop = equations.log_bayes_factor(at, right), (right[:, at] * amounts).sum(axis=1)
    least = np.array([linear.products.columns[equations.columns[j]].least for j in at])
    wrong = (equations.positive[at] & (amounts < least)).any(axis=1)
    return np.where(wrong, np.minimum(gain, 0.0), gain), np.where(wrong, 0.0, drop)
