"""Detection: is there a mismatch at all, by a few statistics and their distribution on null cases.

Statistics: gain (ln evidence) of the best single effect over the compliance ratio of flesh to gel
(ForwardModel.compliance_ratio), less the effect's null quantile (what it gains on nine of ten null
recordings); gain of the best pair over the ratio squared; and the plain model's chi-square per number. So
they are scaled as gains grow on null recordings. Each is compared with the same statistic of null recordings
of other fruits (fem.mismatch.selection.null_reference, by a solver of its own), on a scale x on which those
are about normal (asinh of gains, ln of shares). The reference set has few fruits and several correlated
recordings of each; with a fruit's own deviation b and a recording's w,

    x = m + b + w,      z = (x - m) / sd(x of another fruit),      sd^2 = B (1 + 1/F) + W (1 + 1/n)

m: mean over F fruits, B and W: variances between and within fruits (one-way random effects: Searle, Casella
and McCulloch 1992, Variance Components, chapter 3), n recordings. The greatest z is compared with the
reference set's own greatest in the same way, so that several statistics do not add up to a false alarm; its
tail probability in Student's distribution with F - 1 degrees of freedom is the p-value.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float, Int
from scipy.special import stdtr

from fem.mismatch.selection.null_reference import STATISTICS, null_reference


def best_beyond_quantile(gains: Iterable[tuple[str, float]], compliance_ratio: float) -> float:
    """The first statistic, from what every signature gains, by its effect."""
    null_quantiles = null_reference().quantiles
    return max(
        (gain / compliance_ratio - null_quantiles.get(effect, 0.0) for effect, gain in gains), default=0.0
    )


def null_gain(effect: str, compliance_ratio: float) -> float:
    """What an effect's signature gains on most sound recordings at most; nothing where none was seen."""
    return compliance_ratio * null_reference().quantiles.get(effect, 0.0)


def null_gain_in_full(effects: Iterable[str], compliance_ratio: float) -> float:
    """What a model of one effect does, or the more usual of two."""
    return max((null_gain(effect, compliance_ratio) for effect in effects), default=0.0)


def p_values(statistics: Mapping[str, float]) -> tuple[float, dict[str, float]]:
    """The one p-value, and each statistic's own."""
    known = null_reference()
    return p_values_against(statistics, known.statistics, known.fruits)


def statistic_p(name: str, value: float) -> float:
    """What share of sound recordings of other fruits have a greater value of one statistic."""
    return p_values({**dict.fromkeys(STATISTICS, 1.0), name: value})[1][name]


def p_values_against(
    statistics: Mapping[str, float], bank: Float[np.ndarray, "n 3"], fruits: Int[np.ndarray, " n"]
) -> tuple[float, dict[str, float]]:
    """The same beside any bank: a row per recording, columns as in STATISTICS, and whose it is."""
    known = _scaled(bank)
    mean, spread, freedom = _of_another_fruit(known, fruits)
    z = (_scaled(np.array([[statistics[name] for name in STATISTICS]]))[0] - mean) / spread
    most = ((known - mean) / spread).max(axis=1, keepdims=True)
    null_quantiles, sd_greatest, _ = _of_another_fruit(most, fruits)
    p = float(stdtr(freedom, (null_quantiles[0] - z.max()) / sd_greatest[0]))
    each = stdtr(freedom, -z)
    return p, dict(zip(STATISTICS, each.tolist(), strict=True))


def _scaled(values: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return np.column_stack([np.arcsinh(values[:, :2]), np.log(values[:, 2])])


def _of_another_fruit(
    values: Float[np.ndarray, "n k"], fruits: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], int]:
    """Mean and standard deviation of a recording of a fruit that is not in the bank; degrees of freedom."""
    own = [values[fruits == fruit] for fruit in np.unique(fruits)]
    means = np.stack([one.mean(axis=0) for one in own])
    within = np.stack([one.var(axis=0, ddof=1) for one in own]).mean(axis=0)
    each, count = len(values) / len(own), len(own)
    between = np.maximum(means.var(axis=0, ddof=1) - within / each, 0.0)
    spread = np.sqrt(between * (1 + 1 / count) + within * (1 + 1 / len(values)))
    return means.mean(axis=0), spread, count - 1


def null_statistic(name: str, share: float = 0.5) -> float:
    """What a share of the bank's recordings stay below in one statistic."""
    return float(np.quantile(null_reference().statistics[:, STATISTICS.index(name)], share))
