"""Baseline: sparse regression over the same library of signatures, in the manner of EUCLID.

Flaschel, Kumar and De Lorenzis 2021 (Comput. Methods Appl. Mech. Eng. 381, 113852) find the few terms of a
library by a penalty on amounts and a threshold. Here the library is each effect's best signature (with gains
of both pads in it, E itself would be free), the plain model's nuisances are eliminated with their priors,
the path of penalties is scikit-learn's LassoLarsIC with the Bayesian information criterion, and then least
squares with terms below THRESHOLD standard deviations dropped in turn (Brunton, Proctor and Kutz 2016, PNAS
113, 3932).
"""

import warnings
from typing import Any

import numpy as np
from jaxtyping import Float
from reduced_case import ReducedCase
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LassoLarsIC
from weighed_residual import weighed_squares

from fem.mismatch.result import NONE, Modulus

THRESHOLD = 3.0
"""Standard deviations below which a term is dropped: the usual level of sequential thresholding."""
MOST_NAMES = 3
"""Terms' effects that a verdict holds at most, the largest first (set by hand)."""
RIDGE = 1e-10
"""Added to the scaled Gram matrix's diagonal, for columns that are twins to the last digit."""


def sparse_regression(case: ReducedCase, E: Modulus) -> dict[str, Any]:
    """The answer for a case whose plain model has this E."""
    gram, plain = case.gram(), case.nuisances
    terms = [j for one in case.linear().best for j in one.columns]
    normal, right = eliminated(case, [0, *plain], terms)
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    seen = np.diag(normal) > 1e-9 * np.max(np.diag(normal), initial=1.0)
    terms = [j for j, ok in zip(terms, seen, strict=True) if ok]
    active = chosen_terms((normal * scale[:, None] * scale)[np.ix_(seen, seen)], (right * scale)[seen])
    columns = [terms[k] for k in active]
    fit = gram.fit([*plain, *columns])
    amounts = fit.amounts[len(fit.amounts) - len(columns) :]
    sds = fit.sd[len(fit.amounts) - len(columns) :]
    owner = {j: one["effect"] for one in case.signatures for j in one["columns"]}
    sizes: dict[str, float] = {}
    for j, amount, sd in zip(columns, amounts, sds, strict=True):
        sizes[owner[j]] = max(sizes.get(owner[j], 0.0), float((amount / sd) ** 2))
    order = sorted(sizes, key=lambda name: -sizes[name])
    share, spread = float(fit.amounts[0]), float(fit.sd[0])
    before = weighed_squares(gram, plain)
    return {
        "verdict": order[:MOST_NAMES] or [NONE],
        "order": order,
        "E": [E.value / max(1 + share, 0.1), float(np.hypot(E.sd, E.value * spread))],
        "heldout_ratio": weighed_squares(gram, [*plain, *columns]) / before,
    }


def eliminated(case: ReducedCase, plain: list[int], terms: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and right side of the terms, with 1/E and nuisances eliminated (Schur complement)."""
    size = len(case.columns)
    total, data = np.zeros((size, size)), np.zeros(size)
    for rows, products in zip(case.rows, case.products, strict=True):
        total[np.ix_(rows, rows)] += products[1:, 1:]
        data[rows] += products[1:, 0]
    own = total[np.ix_(plain, plain)] + np.diag([case.columns[j]["sd"] ** -2.0 for j in plain])
    across = total[np.ix_(plain, terms)]
    solved = np.linalg.solve(own, np.column_stack([across, data[plain]]))
    return total[np.ix_(terms, terms)] - across.T @ solved[:, :-1], data[terms] - across.T @ solved[:, -1]


def chosen_terms(normal: Float[np.ndarray, "p p"], right: Float[np.ndarray, " p"]) -> list[int]:
    """Terms of a least-squares problem in its normal form, noise variance one, that stay."""
    if not len(right):
        return []
    values, vectors = np.linalg.eigh(normal)
    kept = values > RIDGE * values[-1]
    X = (vectors[:, kept] * np.sqrt(values[kept])).T
    y = (vectors[:, kept].T @ right) / np.sqrt(values[kept])
    lasso = LassoLarsIC(criterion="bic", fit_intercept=False, noise_variance=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        active = np.flatnonzero(lasso.fit(X, y).coef_).tolist()
    while active:
        own = normal[np.ix_(active, active)] + RIDGE * np.eye(len(active))
        covariance = np.linalg.inv(own)
        t = np.abs(covariance @ right[active]) / np.sqrt(np.diag(covariance))
        if t.min() >= THRESHOLD:
            break
        active.pop(int(np.argmin(t)))
    return active
