"""Is there a mismatch at all: a few statistics, and how they come out where there is none.

Gain of the best single effect and of the best pair (ln evidence), what the plain model leaves per number, and
the friction cone's pile-up. Each is ranked among the same statistic of sound recordings of many fruits
(fem.mismatch.null_bank, made by a solver of its own); the smallest of those ranks is ranked once more among
the bank's own smallest, so that many looks do not add up to a false alarm (conformal p-value, Vovk et al.
2005, Algorithmic Learning in a Random World):

    p = (1 + #{bank at least as extreme}) / (n + 1)
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from fem.mismatch.null_bank import NAMES, NULLS

LEVEL = 0.05
"""p-values below it are a mismatch."""


def p_values(statistics: Mapping[str, float]) -> tuple[float, dict[str, float]]:
    """The one p-value, and each statistic's own. Beyond the bank's greatest p falls with the tail's slope."""
    bank = np.array(NULLS)
    values = np.array([statistics[name] for name in NAMES])
    own = np.array([_tail(bank[:, k], value) for k, value in enumerate(values)])
    least = np.array(
        [
            min(_tail(np.delete(bank[:, k], row), bank[row, k]) for k in range(len(NAMES)))
            for row in range(len(bank))
        ]
    )
    smallest = float(own.min())
    p = (1 + int((least <= smallest).sum())) / (len(bank) + 1)
    if not (least <= smallest).any():
        p = min(p, smallest * len(NAMES))
    return p, dict(zip(NAMES, own.tolist(), strict=True))


def usual(name: str) -> float:
    """The median of one statistic over the bank."""
    return float(np.median(np.array(NULLS)[:, NAMES.index(name)]))


def _tail(bank: Float[np.ndarray, " n"], value: float) -> float:
    """Share of the bank at or above the value; beyond its greatest an exponential tail of its upper tenth."""
    n = len(bank)
    above = int((bank >= value).sum())
    if above:
        return (1 + above) / (n + 1)
    upper = np.sort(bank)[-max(n // 10, 3) :]
    slope = max(float(np.mean(upper - upper[0])), 1e-9)
    return float(np.exp(-min((value - upper[-1]) / slope, 600.0)) / (n + 1))
