"""The model's own error: apparent amounts of effects in stored rounds of fruit without mismatch."""

import csv
import io
from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any

import numpy as np
from jaxtyping import Float
from reduced_case import ReducedCase
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp
from scipy.stats import invgamma

from fem.mismatch.evidence.model_error import FREEDOM, SIZE, NullDraws, ScalePrior
from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.selection.screening import LinearRound

SCALES = np.geomspace(0.05, 20.0, 61)
"""Grid of the scale of the error; fruit without mismatch have 0.25 to 3.4."""
MOST_FREEDOM = 50
"""Degrees of freedom that are tried: a larger one is a scale without spread."""
LEAST_SHARE = 0.001
"""Smaller shares are left out of the file. Set by hand: a thousandth of an effect's prior changes nothing."""
ORIGIN = """\
# Apparent amount of each effect without mismatch, over its prior standard deviation and the compliance ratio:
# root mean square over fruit (mean over the cases of a fruit first). The scale of all of them in one case:
# k^2 ~ freedom size^2 / chi-square(freedom), by the shares of the other fruit.
# {cases} cases of {fruit} fruit, simulated by another solver (benchmarks/mismatch_bank.py).
# Written by: {command}, {written:%Y-%m-%d}
"""


def apparent_row(name: str, case: ReducedCase) -> dict[str, Any]:
    """A case without mismatch: its fruit, and the square of each effect's apparent share."""
    squares = squared_shares(
        equations_without_model_error(case.linear()), compliance_ratio=float(case.facts["compliance_ratio"])
    )
    return {"case": name, "fruit": fruit_of(name, case), "squared_shares": squares}


def equations_without_model_error(linear: LinearRound) -> SignatureEquations:
    """Equations of all signatures beside a plain model without model error columns."""
    signatures: dict[str, list[tuple[int, ...]]] = {}
    for fit in linear.linear_fits:
        signatures.setdefault(fit.name, []).append(fit.columns)
    nuisances = [j for j in linear.nuisances if linear.products.columns[j].same_as is None]
    return SignatureEquations.of(linear.products, nuisances, signatures)


def squared_shares(equations: SignatureEquations, *, compliance_ratio: float) -> dict[str, float]:
    """Square of each effect's apparent amount over prior standard deviation and compliance ratio, noise
    removed: the mean over all columns of its signatures, each signature fitted alone.

        a = (N + L)^-1 b,      x = max(a^2 - v, 0) / (sd ratio)^2,      v = diag (N + L)^-1
    """
    squares = {}
    for effect, ways in equations.ways.items():
        each: list[float] = []
        for columns in ways:
            at, sd = list(columns), equations.sd[list(columns)]
            covariance = np.linalg.inv(equations.normal[np.ix_(at, at)] + np.diag(sd**-2.0))
            amounts = covariance @ equations.right[at]
            each += list(np.maximum(amounts**2 - np.diag(covariance), 0.0) / (sd * compliance_ratio) ** 2)
        if each:
            squares[effect] = float(np.mean(each))
    return squares


def model_error_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The share of each effect, by name: root mean square over fruit, of each the mean over its cases.

    A case that shows no signature of an effect, as of a third contact in forces that balance, counts as zero.
    """
    effects = {effect for row in rows for effect in row["squared_shares"]}
    squares: dict[str, dict[str, list[float]]] = {effect: {} for effect in effects}
    for effect in effects:
        for row in rows:
            squares[effect].setdefault(row["fruit"], []).append(row["squared_shares"].get(effect, 0.0))
    return {
        effect: float(np.sqrt(np.mean([np.mean(cases) for cases in fruit.values()])))
        for effect, fruit in sorted(squares.items())
    }


def scale_prior_of(cases: Mapping[str, ReducedCase], rows: Sequence[Mapping[str, Any]]) -> ScalePrior:
    """The prior of the error's scale by cases without mismatch, with the shares of the other fruit.

    ln p(b | k) of a fruit is the mean over its cases.
    """
    curves: dict[str, list[list[float]]] = {}
    for name, case in cases.items():
        fruit = fruit_of(name, case)
        shares = model_error_of([row for row in rows if row["fruit"] != fruit])
        draws = case.with_model_error(shares).linear().null_draws
        curves.setdefault(fruit, []).append([log_density(draws, scale) for scale in SCALES])
    return scale_prior(np.array([np.mean(each, axis=0) for each in curves.values()]))


def scale_prior(by_fruit: Float[np.ndarray, "n s"]) -> ScalePrior:
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


def log_density(draws: NullDraws, scale: float) -> float:
    """ln p(b | k) of recordings without mismatch, up to what k does not change. With S = diag(k error_sd):

    u'A^-1 u / 2 - ln det(A) / 2,      u = S b,   A = I + S N S
    """
    sd = scale * draws.error_sd
    u = sd * draws.bare.right
    matrix = np.eye(len(sd)) + sd[:, None] * draws.bare.normal * sd
    return float(u @ np.linalg.solve(matrix, u) - np.linalg.slogdet(matrix)[1]) / 2


def file_text(rows: Sequence[Mapping[str, Any]], prior: ScalePrior, *, command: str, written: date) -> str:
    """Text of model_error.csv; its first lines say from how many cases it is, and by which command."""
    fruit = len({row["fruit"] for row in rows})
    with io.StringIO() as file:
        file.write(ORIGIN.format(cases=len(rows), fruit=fruit, command=command, written=written))
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(["effect", "share"])
        lines.writerows([[SIZE, f"{prior.size:.3g}"], [FREEDOM, f"{prior.freedom:.3g}"]])
        lines.writerows(
            [effect, f"{size:.3g}"] for effect, size in model_error_of(rows).items() if size >= LEAST_SHARE
        )
        return file.getvalue()


def fruit_of(name: str, case: ReducedCase) -> str:
    """The fruit that a case was drawn from: all its cases share the model's error."""
    origin = case.facts["answer"].get("drawn_from", {})
    return str(origin.get("fruit", name.rsplit("-", 1)[0]))
