"""Other methods on a case's linear problem: E alone, Gaussian process, sparse regression, random forest.

Each answer holds `verdict`, `order` (names, likeliest first) and `E` (value and sd, MPa). None of them was
written for this problem; each is the textbook method with the finder's own signatures or residuals.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ideal_confusion import drawn_amounts
from jaxtyping import Float
from sklearn.ensemble import RandomForestClassifier
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import LassoLarsIC

from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection.screening import LinearRound

LENGTHS, LENGTH_BOUNDS = (4.0, 4.0, 0.5, 3.0), (0.1, 100.0)
"""First lengths of the kernel: mm along the patch twice, share of the load, s; bounds of all."""
RIDGE = 1e-10
"""Added to a scaled Gram matrix's diagonal, for columns that are twins to the last digit."""
MOST_NAMES = 3
"""Names of a verdict at most, the largest term first. Set by hand."""
LEAST_SHARE = 0.1
"""Of the plain model's 1/E: a method that wants less has no answer, and E stays the plain model's."""
TREES, MULTIPLES, DRAWS, FOLDS = 200, (2, 4, 8, 16, 64, 256), 4, 3
"""Of the forest: trees, sizes of the drawn effects in full bounds, draws of each size and round, and parts of
the cross-validation."""


def sparse_regression(linear: LinearRound, E: tuple[float, float], *, threshold: float) -> dict[str, Any]:
    """The few terms of the library of signatures by lasso, then by thresholded least squares.

    Flaschel, Kumar, De Lorenzis 2021 (Comput. Methods Appl. Mech. Eng. 381, 113852); Brunton, Proctor, Kutz
    2016 (PNAS 113, 3932). Terms below `threshold` standard deviations are dropped in turn. The library is
    each effect's best signature, with the nuisances integrated out.
    """
    equations = linear.equations
    owner = {at: fit.name for fit in linear.best for at in equations.numbers(fit.columns)}
    terms = [at for at in owner if equations.normal[at, at] > 0]
    normal, right = equations.normal[np.ix_(terms, terms)], equations.right[terms]
    scale = 1 / np.sqrt(np.diag(normal))
    active = chosen_terms(normal * scale[:, None] * scale, right * scale, threshold)
    columns = [equations.columns[terms[k]] for k in active]
    sizes: dict[str, float] = {}
    for k, t in zip(active, t_values(normal, right, active), strict=True):
        name = owner[terms[k]]
        sizes[name] = max(sizes.get(name, 0.0), t**2)
    order = sorted(sizes, key=lambda name: -sizes[name])
    plain = 1 + float(linear.null.amounts[0])
    fit = linear.products.fit([*linear.nuisances, *columns])
    share, spread = (1 + float(fit.amounts[0])) / plain, float(fit.sd[0]) / plain
    return {
        "verdict": order[:MOST_NAMES] or [NONE],
        "order": order,
        "E": modulus_with(E, share, spread),
    }


def modulus_with(E: tuple[float, float], share: float, spread: float) -> list[float]:
    """E and its sd where 1/E is `share` +- `spread` of the plain model's."""
    value, sd = E
    if share < LEAST_SHARE:
        return [value, sd]
    return [value / share, float(np.hypot(sd / share, value * spread / share**2))]


def threshold_of(rounds: Sequence[LinearRound], *, false_alarms: float) -> float:
    """The threshold at which this share of rounds without mismatch keeps a term."""
    levels = np.arange(1.0, 60.0, 0.5)
    for level in levels:
        kept = [sparse_regression(each, (1.0, 0.0), threshold=level)["order"] != [] for each in rounds]
        if np.mean(kept) <= false_alarms:
            return float(level)
    return float(levels[-1])


def chosen_terms(
    normal: Float[np.ndarray, "p p"], right: Float[np.ndarray, " p"], threshold: float
) -> list[int]:
    """Terms of a least-squares problem in normal form, noise variance one, that stay."""
    values, vectors = np.linalg.eigh(normal)
    kept = values > RIDGE * values[-1]
    X = (vectors[:, kept] * np.sqrt(values[kept])).T
    y = (vectors[:, kept].T @ right) / np.sqrt(values[kept])
    lasso = LassoLarsIC(criterion="bic", fit_intercept=False, noise_variance=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        active = [int(k) for k in np.flatnonzero(lasso.fit(X, y).coef_)]
    while active:
        t = np.abs(t_values(normal, right, active))
        if t.min() >= threshold:
            break
        active.pop(int(np.argmin(t)))
    return active


def t_values(
    normal: Float[np.ndarray, "p p"], right: Float[np.ndarray, " p"], active: Sequence[int]
) -> Float[np.ndarray, " a"]:
    """Amounts of these terms over their standard deviations."""
    active_normal = normal[np.ix_(active, active)]
    covariance = np.linalg.inv(active_normal + RIDGE * np.diag(np.diag(active_normal)))
    return np.asarray(covariance @ right[active] / np.sqrt(np.diag(covariance)))


def gaussian_process(
    samples: Float[np.ndarray, "s 6"], E: tuple[float, float], *, least_gain: float
) -> dict[str, Any]:
    """A Gaussian-process discrepancy beside E (Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425).

    y(x) = s c(x) + delta(x) + noise. `samples` holds x (place on the patch twice, mm; share of the load; s),
    the plain model's residual y and its response c (mm). Hyperparameters have the greatest marginal
    likelihood. Something is missing from `least_gain` on (ln marginal likelihood over that of noise alone).
    The method never says what.
    """
    X = samples[:, :4]
    scale = float(samples[:, 4].std()) or 1.0
    y, c = samples[:, 4] / scale, samples[:, 5] / scale
    kernel = ConstantKernel(0.3, (1e-4, 1e2)) * RBF(LENGTHS, LENGTH_BOUNDS) + WhiteKernel(0.7, (1e-3, 10.0))
    process = GaussianProcessRegressor(kernel, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(X, y)
    variance = float(np.mean(y**2))
    gain = process.log_marginal_likelihood_value_ + len(y) / 2 * (np.log(2 * np.pi * variance) + 1)
    weighed = np.linalg.solve(process.kernel_(X), np.column_stack([c, y]))
    information = max(float(c @ weighed[:, 0]), 1e-12)
    share = 1 + float(c @ weighed[:, 1]) / information
    return {
        "verdict": [UNKNOWN if gain > least_gain else NONE],
        "order": [],
        "E": modulus_with(E, share, 1 / np.sqrt(information)),
        "gain": float(gain),
    }


@dataclass(frozen=True)
class Forest:
    """A random forest (Breiman 2001, Machine Learning 45, 5) on the log Bayes factors of all effects.

    It learns from effects that are drawn on rounds without mismatch by the linear model. `none_at`:
    probability of "none" below which a case has a mismatch.
    """

    model: RandomForestClassifier
    names: tuple[str, ...]
    none_at: float

    @classmethod
    def grown(cls, rounds: Sequence[LinearRound], *, false_alarms: float) -> "Forest":
        """`none_at` gives the rounds this share of false alarms, each by a forest of other rounds."""
        names = tuple(sorted({name for linear in rounds for name in linear.equations.ways}))
        rng = np.random.default_rng(0)
        drawn = [_drawn(linear, names, rng) for linear in rounds]
        p_none: list[float] = []
        for fold in range(FOLDS):
            others = _fitted([each for j, each in enumerate(drawn) if j % FOLDS != fold])
            p_none += [_probabilities(others, linear, names)[NONE] for linear in rounds[fold::FOLDS]]
        return cls(_fitted(drawn), names, float(np.quantile(p_none, false_alarms)))

    def answer(self, linear: LinearRound, E: tuple[float, float]) -> dict[str, Any]:
        """Verdict and order of one case. E is the plain model's."""
        p = _probabilities(self.model, linear, self.names)
        alarm = p.pop(NONE) < self.none_at
        order = sorted(p, key=lambda name: -p[name]) if alarm else []
        return {"verdict": order[:1] or [NONE], "order": [str(name) for name in order], "E": list(E)}


def _drawn(
    linear: LinearRound, names: Sequence[str], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "d f"], list[str]]:
    """Features and names of effects drawn on this round, and of as many draws without one."""
    truths, amounts = drawn_amounts(linear, multiples=MULTIPLES, count=DRAWS, rng=rng)
    none = linear.null_draws.drawn(len(truths), rng)
    noise = linear.null_draws.drawn(len(truths), rng)
    right = np.vstack([none, noise + amounts @ linear.equations.normal])
    return _features(linear, names, right), [NONE] * len(truths) + [name for name, _ in truths]


def _features(
    linear: LinearRound, names: Sequence[str], right: Float[np.ndarray, "d c"]
) -> Float[np.ndarray, "d f"]:
    """asinh of the log Bayes factors; zero for an effect that the round does not have."""
    factors = linear.equations.log_bayes_factors(right)
    return np.arcsinh(np.column_stack([factors.get(name, np.zeros(len(right))) for name in names]))


def _fitted(drawn: Sequence[tuple[Float[np.ndarray, "d f"], list[str]]]) -> RandomForestClassifier:
    model = RandomForestClassifier(TREES, random_state=0, class_weight="balanced")
    return model.fit(np.vstack([X for X, _ in drawn]), [name for _, labels in drawn for name in labels])


def _probabilities(
    model: RandomForestClassifier, linear: LinearRound, names: Sequence[str]
) -> dict[str, float]:
    features = _features(linear, names, linear.equations.right[None])
    return dict(zip(model.classes_, model.predict_proba(features)[0], strict=True))
