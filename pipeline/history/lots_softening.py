"""How fast lots of one cultivar soften: a mixed model with random effects per lot.

    ln E_ij = (a + a_i) - (k + k_i) t_ij + e_ij

Lot i has its own start a_i and rate k_i, normal with a covariance of their own; t is days since the lot's
first day. Fitted by restricted maximum likelihood (statsmodels MixedLM; Lindstrom and Bates, J. Am. Stat.
Assoc. 83, 1988, 1014). The rate of a lot is its best linear unbiased prediction.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from pipeline.history.softening import COVERAGE

FEWEST_LOTS = 3
"""With at least two days each: two lots say next to nothing of the spread between lots. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class LotsSoftening:
    """k and its 90 % interval, 1/day; the standard deviation of k_i; and k + k_i by lot."""

    rate: float
    low: float
    high: float
    lot_sd: float
    rates: dict[str, float]


def lots_softening(E_MPa: Mapping[str, Mapping[float, Sequence[float]]]) -> LotsSoftening | None:
    """Of fruit by lot and day (since the lot's first); None with fewer lots, or without convergence."""
    lots = {name: by_day for name, by_day in E_MPa.items() if sum(bool(E) for E in by_day.values()) > 1}
    if len(lots) < FEWEST_LOTS:
        return None
    from statsmodels.regression.mixed_linear_model import MixedLM

    rows = [
        (name, day, math.log(E))
        for name, by_day in lots.items()
        for day, fruit in by_day.items()
        for E in fruit
    ]
    design = np.array([(1.0, -day) for _, day, _ in rows])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a spread of zero lies on the border, and is a right answer
        try:
            fit = MixedLM(
                np.array([ln_E for *_, ln_E in rows]),
                design,
                groups=np.array([name for name, *_ in rows]),
                exog_re=design,
            ).fit(reml=True)
        except np.linalg.LinAlgError:
            return None
    rate, rate_sd = float(fit.fe_params[1]), float(fit.bse_fe[1])
    if not fit.converged or not math.isfinite(rate_sd):
        return None
    half = float(norm.ppf(0.5 + COVERAGE / 2)) * rate_sd
    return LotsSoftening(
        rate=rate,
        low=rate - half,
        high=rate + half,
        lot_sd=math.sqrt(max(float(np.asarray(fit.cov_re)[1, 1]), 0.0)),
        rates={name: rate + float(np.asarray(fit.random_effects[name])[1]) for name in lots},
    )
