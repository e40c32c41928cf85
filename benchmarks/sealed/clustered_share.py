"""Interval of a share whose cases come in clusters, as records of one fruit do.

Counts of a cluster are beta-binomial with mean m and correlation r between its cases; the interval holds
every m whose profile likelihood max_r L(m, r) is within half a chi-square of the greatest. With a single case
in each cluster it is the binomial likelihood interval, and so it is with clusters that are all or nothing.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.stats import betabinom, chi2

NINETY_FIVE = 0.95
"""Of the interval."""
MEANS = np.linspace(0.0, 1.0, 4001)[1:-1]
"""Means tried: the interval's ends are known to 0.00025."""
CORRELATIONS = np.r_[np.linspace(0.0, 1.0, 41)[1:-1], 1e-6, 1 - 1e-6]
"""Correlations tried, from independent cases to all or nothing."""


def clustered_interval(clusters: Sequence[str], truths: Sequence[bool]) -> tuple[float, float]:
    """Of the share of `truths`; `clusters` names the cluster of each case.

    >>> clustered_interval(["a", "a", "b", "b"], [True] * 4)[1]
    1.0
    """
    totals = Counter(clusters)
    counts = dict.fromkeys(totals, 0) | Counter(
        cluster for cluster, truth in zip(clusters, truths, strict=True) if truth
    )
    mean, correlation = MEANS[:, None], CORRELATIONS[None]
    spread = (1 - correlation) / correlation
    log_likelihood = np.zeros((len(MEANS), len(CORRELATIONS)))
    for (count, total), times in Counter((counts[name], totals[name]) for name in totals).items():
        log_likelihood += times * betabinom.logpmf(count, total, mean * spread, (1 - mean) * spread)
    profile = log_likelihood.max(axis=1)
    share = sum(counts.values()) / len(clusters)
    most = 0.0 if share in (0.0, 1.0) else float(profile.max())
    inside = MEANS[profile >= most - chi2.ppf(NINETY_FIVE, 1) / 2]
    low, high = (float(inside.min()), float(inside.max())) if len(inside) else (share, share)
    return (0.0 if share == 0.0 else low), (1.0 if share == 1.0 else high)
