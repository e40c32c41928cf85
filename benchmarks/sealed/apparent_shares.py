"""The model's own error, measured on stored rounds of fruit without mismatch."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date

import numpy as np
from jaxtyping import Float, Int
from reduced_case import ReducedCase
from scipy.optimize import minimize, minimize_scalar
from scipy.special import logsumexp
from scipy.stats import invgamma

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence.beyond_small_strain import LARGE_DEFORMATION
from fem.mismatch.evidence.model_error import (
    FREEDOM,
    SIZE,
    NullDraws,
    ScalePrior,
    model_error_shares,
    scale_prior,
)
from fem.mismatch.gel_fault import GelFault
from fem.mismatch.selection.screening import LinearRound

SCALES = np.geomspace(0.05, 20.0, 61)
"""Grid of the scale of the error."""
MOST_FREEDOM = 50
"""Degrees of freedom that are tried: a larger one is a scale without spread."""
USUAL_SHARES, LOG_SPREAD = (0.02, 0.01, 0.005, 0.002, 0.001, 0.0005), 1.0
"""Prior of a share: log-normal. Medians that are tried, and the standard deviation of the logarithm, which is
set by hand, wide."""
LEAST_SHARE, MOST_SHARE = 1e-4, 1.0
"""Shares that are tried."""
ORIGIN = """\
# Standard deviation of the model's own error along each effect, over its prior standard deviation and the
# compliance ratio: all shares together, by the likelihood of all cases (each fruit counts once). The scale of
# all of them in one case: k^2 ~ freedom size^2 / chi-square(freedom), by the shares of the other fruit.
# {cases} cases of {fruit} fruit of other solvers (`simulate` and `disturb` of benchmarks/mismatch_bank.py).
# Written by: {command}, {written:%Y-%m-%d}
"""


@dataclass(frozen=True, kw_only=True)
class ModelError:
    """The share of each effect, and the prior of the scale of all."""

    shares: Mapping[str, float]
    prior: ScalePrior

    @classmethod
    def shipped(cls) -> "ModelError":
        """That of the finder."""
        return cls(shares=model_error_shares(), prior=scale_prior())

    @classmethod
    def of(cls, cases: "Sequence[NullCase]") -> "ModelError":
        """As these cases show it."""
        usual = usual_share_of(cases)
        return cls(
            shares=model_error_of(cases, usual=usual),
            prior=likeliest_scale_prior(held_out(cases, usual=usual)),
        )

    def linear(self, case: ReducedCase) -> LinearRound:
        """The linear round of a case with this error for its own."""
        linear = case.with_model_error(self.shares).linear()
        return replace(linear, null_draws=replace(linear.null_draws, prior=self.prior))


@dataclass(frozen=True, kw_only=True)
class NullCase:
    """A case without mismatch beside a plain model without error: N, b, the standard deviation of each
    column's amount by a share of one and by the surface's error, and of each column the number of its effect
    in `effects`.
    """

    fruit: str
    normal: Float[np.ndarray, "c c"]
    right: Float[np.ndarray, " c"]
    unit_sd: Float[np.ndarray, " c"]
    surface_sd: Float[np.ndarray, " c"]
    effect: Int[np.ndarray, " c"]
    effects: tuple[str, ...]

    @classmethod
    def of(cls, name: str, case: ReducedCase, effects: tuple[str, ...]) -> "NullCase":
        """A stored round; `effects`: all that have a signature in any case."""
        surface = case.with_model_error({}).linear().null_draws.error_sd
        draws: NullDraws = case.with_model_error(dict.fromkeys(effects, 1.0)).linear().null_draws
        effect = np.zeros(len(draws.error_sd), dtype=np.int64)
        for word, ways in draws.bare.ways.items():
            effect[[column for way in ways for column in way]] = effects.index(word)
        return cls(
            fruit=fruit_of(name, case),
            normal=draws.bare.normal,
            right=draws.bare.right,
            unit_sd=np.sqrt(draws.error_sd**2 - surface**2),
            surface_sd=surface,
            effect=effect,
            effects=effects,
        )

    def log_density(self, shares: Mapping[str, float], scale: float = 1.0) -> float:
        """ln p(b), up to what the error does not change. With S the diagonal of scale, share and unit sd:

        u'A^-1 u / 2 - ln det(A) / 2,      u = S b,   A = I + S N S
        """
        sd = scale * np.hypot(self._share_sd(shares), self.surface_sd)
        u = sd * self.right
        matrix = np.eye(len(sd)) + sd[:, None] * self.normal * sd
        return float(u @ np.linalg.solve(matrix, u) - np.linalg.slogdet(matrix)[1]) / 2

    def gradient(self, shares: Mapping[str, float]) -> Float[np.ndarray, " e"]:
        """Of ln p(b) by the logarithm of each share. With x the variances, x + z those with the surface's
        error, and M = I + N diag(x + z), the sum of

        x (w^2 - diag(M^-1 N)),      w = M^-1 b

        over the effect's columns.
        """
        variance = self._share_sd(shares) ** 2
        total = variance + self.surface_sd**2
        solved = np.linalg.solve(np.eye(len(total)) + self.normal * total, np.c_[self.right, self.normal])
        by_column = variance * (solved[:, 0] ** 2 - np.diag(solved[:, 1:]))
        return np.bincount(self.effect, by_column, minlength=len(self.effects))

    def _share_sd(self, shares: Mapping[str, float]) -> Float[np.ndarray, " c"]:
        return np.asarray(
            self.unit_sd * np.array([shares.get(name, 0.0) for name in self.effects])[self.effect]
        )


def of_the_flesh(case: ReducedCase) -> ReducedCase:
    """The case without faults of a gel: the gel gives their amounts, without the model of the flesh."""
    faults = {effect.spec.name for effect in EFFECTS if isinstance(effect, GelFault)}
    return replace(case, signatures=[words for words in case.signatures if words["effect"] not in faults])


def null_cases(cases: Mapping[str, ReducedCase]) -> list[NullCase]:
    """Stored rounds without mismatch, by name."""
    cases = {name: of_the_flesh(case) for name, case in cases.items()}
    effects = sorted({words["effect"] for case in cases.values() for words in case.signatures})
    return [NullCase.of(name, case, tuple(effects)) for name, case in cases.items()]


def model_error_of(cases: Sequence[NullCase], *, usual: float = USUAL_SHARES[0]) -> dict[str, float]:
    """The share of each effect, by name: the likeliest of all together, each with a log-normal prior about
    `usual`.

    ln p of a fruit is the mean over its cases. One effect alone would take what others explain as well.
    """
    effects, count = cases[0].effects, Counter(case.fruit for case in cases)
    start = np.full(len(effects), np.log(usual))

    def loss(logs: Float[np.ndarray, " e"]) -> tuple[float, Float[np.ndarray, " e"]]:
        shares = dict(zip(effects, np.exp(logs), strict=True))
        away = (logs - start) / LOG_SPREAD
        value = away @ away / 2 - sum(case.log_density(shares) / count[case.fruit] for case in cases)
        slope = away / LOG_SPREAD - sum(case.gradient(shares) / count[case.fruit] for case in cases)
        return float(value), slope

    bounds = [(np.log(LEAST_SHARE), np.log(MOST_SHARE))] * len(effects)
    fitted = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds)
    return dict(zip(effects, map(float, np.exp(fitted.x)), strict=True))


def usual_share_of(cases: Sequence[NullCase]) -> float:
    """The largest median of the shares' prior whose ln p of held-out fruit is within a standard error of the
    best one's; two fruit or more. It is the one-standard-error rule (Breiman et al. 1984, section 3.4.3) with
    the error of the difference, paired by fruit.
    """
    usual_scale = int(np.argmin(np.abs(np.log(SCALES))))
    by_fruit = np.array([held_out(cases, usual=usual)[:, usual_scale] for usual in USUAL_SHARES])
    less = by_fruit[by_fruit.sum(axis=1).argmax()] - by_fruit
    within = less.sum(axis=1) <= np.sqrt(less.shape[1]) * less.std(axis=1, ddof=1)
    return USUAL_SHARES[int(within.argmax())]


def held_out(cases: Sequence[NullCase], *, usual: float) -> Float[np.ndarray, "n s"]:
    """ln p(b | k) of n fruit at SCALES, with the shares of the other fruit; the mean over a fruit's cases."""
    by_fruit = []
    for fruit in dict.fromkeys(case.fruit for case in cases):
        shares = model_error_of([case for case in cases if case.fruit != fruit], usual=usual)
        curves = [
            [case.log_density(shares, scale) for scale in SCALES] for case in cases if case.fruit == fruit
        ]
        by_fruit.append(np.mean(curves, axis=0))
    return np.array(by_fruit)


def likeliest_scale_prior(by_fruit: Float[np.ndarray, "n s"]) -> ScalePrior:
    """The prior of k by ln p(b | k) of n fruit at SCALES; each has the likelihood

        integral p(b | k) p(k) dk,      k^2 ~ freedom size^2 / chi-square(freedom).

    Of all priors within a standard error of the likeliest (half a unit of ln likelihood) the lightest tail.
    """

    def loss(log_size: float, freedom: int) -> float:
        squares = invgamma.logpdf(SCALES**2, freedom / 2, scale=freedom * np.exp(2 * log_size) / 2)
        weights = squares + 2 * np.log(SCALES)  # of ln k, on whose grid the integral is
        return -float(logsumexp(by_fruit + weights - logsumexp(weights), axis=1).sum())

    bounds = np.log([SCALES[0], SCALES[-1]])
    fits = {
        freedom: minimize_scalar(loss, bounds=bounds, args=(freedom,), method="bounded")
        for freedom in range(1, MOST_FREEDOM + 1)
    }
    least = min(fit.fun for fit in fits.values())
    freedom = max(freedom for freedom, fit in fits.items() if fit.fun <= least + 0.5)
    return ScalePrior(size=float(np.exp(fits[freedom].x)), freedom=float(freedom))


def large_deformation_line(cases: Sequence[ReducedCase]) -> str:
    """Amounts of large deformation in cases without mismatch, beside a plain model without an error of its
    own, and their root mean square difference from 1, in words. Where it was not found, a case has no column.
    """
    amounts = list[float]()
    for case in cases:
        plain = [j for j, column in enumerate(case.columns) if column["role"] == "nuisance"]
        fit = case.gram().fit(plain)
        amounts += [
            case.columns[j]["mean"] + float(fit.amounts[fit.chosen.index(j)])
            for j in plain
            if case.columns[j]["name"] == LARGE_DEFORMATION
        ]
    if not amounts:
        return "large deformation: no case without mismatch has it"
    off = float(np.sqrt(((np.array(amounts) - 1) ** 2).mean()))
    return f"large deformation: {min(amounts):.2f} to {max(amounts):.2f}, {off:.3f} off 1 (rms)"


def file_text(cases: Sequence[NullCase], error: ModelError, *, command: str, written: date) -> str:
    """Text of model_error.csv; its first lines say from how many cases it is, and by which command."""
    fruit = len({case.fruit for case in cases})
    listed = {SIZE: error.prior.size, FREEDOM: error.prior.freedom, **error.shares}
    lines = [f"{name},{number:.3g}\n" for name, number in listed.items()]
    origin = ORIGIN.format(cases=len(cases), fruit=fruit, command=command, written=written)
    return origin + "".join(["effect,share\n", *lines])


def fruit_of(name: str, case: ReducedCase) -> str:
    """The fruit that a case was drawn from: all its cases share the model's error."""
    origin = case.facts["answer"].get("drawn_from", {})
    return str(origin.get("fruit", name.rsplit("-", 1)[0]))
