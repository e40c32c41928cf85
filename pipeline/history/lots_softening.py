"""Lots of one cultivar: their softening rates by a mixed model, and their differences on the last days.

    ln E_ij = (a + a_i) - (k + k_i) t_ij + e_ij

Lot i has its own start a_i and rate k_i, jointly normal with covariance D; t is days since the lot's first
day. Restricted maximum likelihood fits the model (statsmodels MixedLM; Lindstrom and Bates, J. Am. Stat.
Assoc. 83, 1988, 1014). Let b_i be the least-squares fit of lot i alone, X_i its design and
S_i = s^2 (X_i' X_i)^-1. The fixed effects b then have the covariance (sum (D + S_i)^-1)^-1. A lot's rate is
its best linear unbiased prediction, b + D (D + S_i)^-1 (b_i - b). Both hold for a singular D.
"""

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from scipy.stats import norm

from pipeline.history.lot_statistics import lot_differences
from pipeline.history.softening import COVERAGE, change_per_day
from reports.history_entries import GroupEntry, SeriesEntry

FEWEST_LOTS = 3
"""Fewest lots with at least two days: two lots hardly determine the spread between lots. Set by hand."""

METHOD = "powell"
"""Optimiser: a spread of zero is a boundary optimum, at which gradient methods do not converge."""

ON_THE_BORDER = (
    "The MLE may be on the boundary",
    "The random effects covariance matrix is singular",
    "The Hessian matrix at the estimated parameter values is not positive definite",
)
"""First words of statsmodels' warnings at a spread of zero. This module uses no Hessian."""

MOST_COMPARED = 20
"""Most lots that are compared in pairs (190 rows): those measured last. Set by hand."""

NO_LAW = (
    f"There is no common rate of softening yet. The mixed model needs {FEWEST_LOTS} lots with two days each, "
    "and must converge."
)


@dataclass(frozen=True, kw_only=True)
class LotsSoftening:
    """k, its 90 % interval, the standard deviation `lot_sd` of k_i, and k + k_i by lot; all in 1/day."""

    rate: float
    low: float
    high: float
    lot_sd: float
    rates: dict[str, float]


def lots_softening(E_MPa: Mapping[str, Mapping[float, Sequence[float]]]) -> LotsSoftening | None:
    """The model of E by lot and day since its first; None below FEWEST_LOTS or without convergence."""
    lots = {name: by_day for name, by_day in E_MPa.items() if sum(bool(E) for E in by_day.values()) > 1}
    if len(lots) < FEWEST_LOTS:
        return None
    from statsmodels.regression.mixed_linear_model import MixedLM

    span = max(day for by_day in lots.values() for day in by_day)  # the optimiser needs numbers of one order
    designs, logs = {}, {}
    for name, by_day in lots.items():
        rows = [(1.0, -day / span, math.log(E)) for day, fruit in by_day.items() for E in fruit]
        designs[name], logs[name] = np.array(rows)[:, :2], np.array(rows)[:, 2]
    design = np.concatenate(list(designs.values()))
    groups = np.repeat(list(lots), [len(ln_E) for ln_E in logs.values()])
    with warnings.catch_warnings():
        # A spread of zero is on the boundary, and is a valid result.
        for said in ON_THE_BORDER:
            warnings.filterwarnings("ignore", message=said)
        model = MixedLM(np.concatenate(list(logs.values())), design, groups=groups, exog_re=design)
        try:
            fit = model.fit(reml=True, method=METHOD)
        except np.linalg.LinAlgError:
            return None
    if not fit.converged:
        return None
    between, coefficients = np.asarray(fit.cov_re), np.asarray(fit.fe_params)
    within = {name: fit.scale * np.linalg.inv(X.T @ X) for name, X in designs.items()}
    covariance = np.linalg.inv(sum(np.linalg.inv(between + of_lot) for of_lot in within.values()))
    single = {name: np.linalg.lstsq(X, logs[name], rcond=None)[0] for name, X in designs.items()}
    predicted = {
        name: coefficients + between @ np.linalg.solve(between + within[name], single[name] - coefficients)
        for name in lots
    }
    rate = float(coefficients[1]) / span
    half = float(norm.ppf(0.5 + COVERAGE / 2)) * math.sqrt(covariance[1, 1]) / span
    return LotsSoftening(
        rate=rate,
        low=rate - half,
        high=rate + half,
        lot_sd=math.sqrt(max(float(between[1, 1]), 0.0)) / span,
        rates={name: float(of_lot[1]) / span for name, of_lot in predicted.items()},
    )


def lot_groups(series: Sequence[SeriesEntry]) -> Iterator[GroupEntry]:
    """An entry per cultivar with at least two lots. `series`: sorted by category and cultivar."""
    for _, of_group in groupby(series, key=lambda lot: (lot.category, lot.cultivar)):
        lots = tuple(of_group)
        if len(lots) < 2:
            continue
        words, rates = _law(lots)
        last = sorted(lots, key=lambda lot: lot.days[-1].day)[-MOST_COMPARED:]
        days = {replace(lot.name, day=lot.days[-1].day): lot.days[-1] for lot in lots if lot in last}
        last_E = {name: day.single_E_MPa for name, day in days.items()}
        yield GroupEntry(
            series=lots,
            words=words,
            rates=rates,
            differences=tuple(lot_differences(last_E)),
        )


def _law(lots: Sequence[SeriesEntry]) -> tuple[str, dict[str, float]]:
    E_MPa = {
        lot.lot: {float((day.day - lot.days[0].day).days): day.single_E_MPa for day in lot.days}
        for lot in lots
    }
    law = lots_softening(E_MPa)
    if law is None:
        return NO_LAW, {}
    common, low, high = (change_per_day(-rate) for rate in (law.rate, law.high, law.low))
    sd = 100 * law.lot_sd * math.exp(-law.rate)
    return (
        f"E of this cultivar changes by {common:+.1f} % a day ({low:+.1f} to {high:+.1f} %, 90 %). The "
        f"standard deviation of this change between lots is {sd:.1f} %.",
        {name: change_per_day(-rate) for name, rate in law.rates.items()},
    )
