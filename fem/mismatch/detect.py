"""Is there a mismatch at all: a few statistics, and how they come out where there is none.

Gain (ln evidence) of the best single effect over the flesh's softness (Ground.softness), beyond what that
effect gains on nine of ten sound recordings; of the best pair over softness squared; and what the plain model
leaves per number. So gains grow on sound recordings, and some effects are sooner seen there than others.
Each is ranked among the same statistic of sound recordings of other fruits (fem.mismatch.null_bank, made
by a solver of its own); the best of those ranks is ranked once more among the bank's own best, so that
many looks do not add up to a false alarm (conformal p-value, Vovk et al. 2005,
Algorithmic Learning in a Random World):

    p = (1 + #{bank at least as extreme}) / (n + 1)

Beyond the bank's greatest it falls on, exponentially, with the slope of the bank's upper end: there it is an
extrapolation.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from fem.mismatch.null_bank import NAMES, NULLS, USUAL

LEVEL = 0.05
"""p-values below it are a mismatch."""


def best_beyond_usual(gains: Mapping[str, float], softness: float) -> float:
    """The first statistic, from the gain of each effect."""
    return max((gain / softness - USUAL.get(name, 0.0) for name, gain in gains.items()), default=0.0)


def usual_gain(name: str, softness: float) -> float:
    """What an effect, or the more usual of two joined by "+", gains on most sound recordings at most."""
    return softness * max(USUAL.get(part, 0.0) for part in name.split("+"))


def p_values(statistics: Mapping[str, float]) -> tuple[float, dict[str, float]]:
    """The one p-value, and each statistic's own."""
    bank = np.array(NULLS)
    n, count = bank.shape
    values = np.array([statistics[name] for name in NAMES])
    above = (bank >= values).sum(axis=0)
    beyond = np.array([_beyond(bank[:, k], values[k]) for k in range(count)])
    own_best = ((bank[None] >= bank[:, None]).sum(axis=1) - 1).min(axis=1)
    p = (1 + int((own_best <= above.min()).sum())) / (n + 1) * float(beyond.min())
    each = (1 + above) / (n + 1) * beyond
    return float(p), dict(zip(NAMES, each.tolist(), strict=True))


def of_sound(name: str, share: float = 0.5) -> float:
    """What a share of the bank's recordings stay below in one statistic."""
    return float(np.quantile(np.array(NULLS)[:, NAMES.index(name)], share))


def _beyond(bank: Float[np.ndarray, " n"], value: float) -> float:
    """How much rarer than the bank's greatest a value is: one within, falling with the upper end's slope.

    The slope is the mean excess over the bank's upper quartile, as of an exponential tail.
    """
    if value <= bank.max():
        return 1.0
    quartile = np.quantile(bank, 0.75)
    slope = max(float(np.mean(bank[bank >= quartile] - quartile)), 1e-9)
    return float(np.exp(-min((value - bank.max()) / slope, 600.0)))
