"""Statistics of the fruit of one lot on one day, and the difference of two lots.

Mean and standard deviation (n - 1) refer to E in MPa. Percentiles interpolate linearly between order
statistics (Hyndman and Fan, Am. Stat. 50, 1996, 361, definition 7). The share of fruit outside a class has
the exact interval of Clopper and Pearson (Biometrika 26, 1934, 404). Welch's test compares two lots
(Biometrika 34, 1947, 28); Holm's method adjusts p of several pairs (Scand. J. Stat. 6, 1979, 65).
"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.stats import binomtest, ttest_ind
from scipy.stats import t as student

from pipeline.history.softening import COVERAGE
from reports.history_entries import DifferenceEntry, LotName, LotStatistics

PERCENTILES = (10, 25, 50, 75, 90)
"""Percentiles of a lot's fruit: a tenth at either end, quartiles and median."""
FAR_SD, NEAR_SD = 3.0, 2.0
"""Action and warning limits of a Shewhart chart (Montgomery, Introduction to Statistical Quality Control)."""
MOST_FRUIT = 10_000
"""Largest number of fruit that drupe states; beyond it the precision is out of reach."""


def lot_statistics(E_MPa: Sequence[float], *, precision: float) -> LotStatistics:
    """Statistics of at least one fruit; `precision`: half-width of the mean's 90 % interval over the mean."""
    E = np.asarray(E_MPa, dtype=float)
    mean, sd = float(E.mean()), float(E.std(ddof=1)) if len(E) > 1 else None
    return LotStatistics(
        n=len(E),
        mean_MPa=mean,
        sd_MPa=sd,
        percentiles_MPa=tuple(np.percentile(E, PERCENTILES).tolist()),
        needed=None if sd is None else needed_fruit(mean, sd, precision=precision),
    )


def needed_fruit(mean: float, sd: float, *, precision: float) -> int | None:
    """The least n with t(0.95, n - 1) sd / sqrt(n) <= precision mean; None beyond MOST_FRUIT.

    >>> needed_fruit(1.0, 0.15, precision=0.05)
    27
    """
    n = np.arange(2, MOST_FRUIT + 1)
    enough = student.ppf(0.5 + COVERAGE / 2, n - 1) * sd / np.sqrt(n) <= precision * mean
    return int(n[enough.argmax()]) if enough.any() else None


def share_outside(
    E_MPa: Sequence[float], *, above_MPa: float, up_to_MPa: float | None
) -> tuple[float, float, float]:
    """Share of fruit outside the class (above_MPa, up_to_MPa], and both ends of its 90 % interval."""
    outside = sum(not above_MPa < E <= (math.inf if up_to_MPa is None else up_to_MPa) for E in E_MPa)
    interval = binomtest(outside, len(E_MPa)).proportion_ci(COVERAGE, method="exact")
    return outside / len(E_MPa), float(interval.low), float(interval.high)


def class_ranges(
    limits: Sequence[tuple[str, float | None]],
) -> list[tuple[str, float, float | None]]:
    """Each class with its lower and upper modulus, MPa, softest first.

    Raises ValueError if a class before the last has no upper limit, which the settings refuse.

    >>> class_ranges([("ready", 0.5), ("firm", None)])
    [('ready', 0.0, 0.5), ('firm', 0.5, None)]
    """
    if any(limit is None for _, limit in limits[:-1]):
        raise ValueError("a class before the last has no upper limit")
    lower = [0.0, *(limit for _, limit in limits if limit is not None)]
    return [(name, below, limit) for (name, limit), below in zip(limits, lower, strict=False)]


def lot_differences(E_MPa: Mapping[LotName, Sequence[float]]) -> list[DifferenceEntry]:
    """Mean difference (first - second), 90 % interval and Holm's p of all pairs of lots with 2+ fruit."""
    from statsmodels.stats.multitest import multipletests  # slow to import

    pairs = []
    for first, second in combinations([name for name, E in E_MPa.items() if len(E) > 1], 2):
        welch = ttest_ind(E_MPa[first], E_MPa[second], equal_var=False)
        interval = welch.confidence_interval(COVERAGE)
        difference = float(np.mean(E_MPa[first]) - np.mean(E_MPa[second]))
        pairs.append((first, second, difference, interval.low, interval.high, float(welch.pvalue)))
    if not pairs:
        return []
    adjusted = multipletests([pair[-1] for pair in pairs], method="holm")[1].tolist()
    return [
        DifferenceEntry(first=a, second=b, difference_MPa=d, low_MPa=float(low), high_MPa=float(high), p=p)
        for (a, b, d, low, high, _), p in zip(pairs, adjusted, strict=True)
    ]


def out_of_control(z: Float[np.ndarray, " n"]) -> str:
    """The alarm of a control chart's last point, as a clause; "" if the process is in control.

    `z`: ln r over its standard deviation, oldest first. Western Electric's first two rules (Montgomery,
    Introduction to Statistical Quality Control, ch. 5): the last is beyond 3; the last and one of the two
    before it are beyond 2 on the same side.

    >>> out_of_control(np.array([2.1, -0.3, 2.4]))
    'two of the last three batches deviate by more than 2 standard deviations on the same side'
    """
    last = float(z[-1])
    if abs(last) > FAR_SD:
        return f"the last batch deviates by more than {FAR_SD:g} standard deviations ({last:+.1f})"
    same_side = z[-3:] * math.copysign(1.0, last) > NEAR_SD
    if same_side[-1] and same_side.sum() >= 2:
        return (
            f"two of the last three batches deviate by more than {NEAR_SD:g} standard deviations "
            "on the same side"
        )
    return ""
