"""Input of the history page: lots over days, reference bodies, gauge studies and quality decisions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date, datetime

import numpy as np
from jaxtyping import Float

from reports.entries import ReferenceBodyEntry

LINE_POINTS = 60
"""Points of a drawn line: one in 14 px of the widest chart."""


@dataclass(frozen=True, order=True, kw_only=True)
class LotName:
    """A cultivar; unless None, its lot ("" without a name), a day, and a size of fruit ("" if not stated)."""

    category: str
    cultivar: str
    lot: str | None = None
    day: date | None = None
    size: str | None = None


@dataclass(frozen=True, kw_only=True)
class LotStatistics:
    """Statistics of n fruit. Percentiles are 10, 25, 50, 75 and 90 %; `sd_MPa` and `needed` are None for one
    fruit. `needed`: number of fruit for which the mean's 90 % interval has at most the stated relative
    half-width, at this spread; None if out of reach.
    """

    n: int
    mean_MPa: float
    sd_MPa: float | None
    percentiles_MPa: tuple[float, ...]
    needed: int | None


@dataclass(frozen=True, kw_only=True)
class DayEntry:
    """One lot on one day: its fruit, their geometric mean, and the interval of that mean (90 %, MPa)."""

    day: date
    left_out: int
    """Number of fruit that are not graded, or in doubt."""
    E_MPa: float
    E_low_MPa: float
    E_high_MPa: float
    single_E_MPa: tuple[float, ...]
    temperature_C: float | None
    statistics: LotStatistics

    @property
    def fruit(self) -> int:
        """Number of fruit in the statistics."""
        return self.statistics.n


@dataclass(frozen=True, kw_only=True)
class LimitEntry:
    """A class limit, and when the lot's mean (`words`) and a tenth of its fruit (`tenth_words`) fall to it.
    `share_below`: share of fruit below it now; `outside`: share outside the class, with its 90 % interval.
    """

    name: str
    E_max_MPa: float
    words: str
    tenth_words: str
    share_below: float
    outside: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class SofteningEntry:
    """The fitted exponential and its band (90 %) over days since the first."""

    day: Float[np.ndarray, " t"]
    E_MPa: Float[np.ndarray, " t"]
    E_low_MPa: Float[np.ndarray, " t"]
    E_high_MPa: Float[np.ndarray, " t"]


@dataclass(frozen=True, kw_only=True)
class SeriesEntry:
    """One lot of one cultivar over its days, oldest first."""

    category: str
    cultivar: str
    lot: str
    days: tuple[DayEntry, ...]
    softening: SofteningEntry | None = None
    softening_words: str = ""
    limits: tuple[LimitEntry, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> LotName:
        """The lot without a day."""
        return LotName(category=self.category, cultivar=self.cultivar, lot=self.lot)


@dataclass(frozen=True, kw_only=True)
class DifferenceEntry:
    """Two lots of a cultivar on their last days: mean E of the first minus that of the second, MPa, with its
    90 % interval. `p`: p-value of Welch's test, adjusted for the number of pairs.
    """

    first: LotName
    second: LotName
    difference_MPa: float
    low_MPa: float
    high_MPa: float
    p: float


@dataclass(frozen=True, kw_only=True)
class GroupEntry:
    """All lots of one cultivar; `words` and `rates`: change of E in a day, %, by the mixed model."""

    series: tuple[SeriesEntry, ...]
    words: str
    rates: Mapping[str, float]
    differences: tuple[DifferenceEntry, ...] = ()

    @property
    def name(self) -> LotName:
        """The cultivar."""
        return replace(self.series[0].name, lot=None)


@dataclass(frozen=True, kw_only=True)
class GaugeEntry:
    """A gauge study of grippers or sensors. `components`: (name, % of E, % of the total variation); `biases`:
    deviation of each gripper or sensor from their mean, in % of E.
    """

    kind: str
    words: str
    components: tuple[tuple[str, float, float], ...]
    biases: tuple[tuple[str, float], ...]


@dataclass(frozen=True, kw_only=True)
class LotDecisionEntry:
    """Decision of the sampling plan on one lot, on its last day."""

    name: LotName
    verdict: str
    words: str


@dataclass(frozen=True, kw_only=True, eq=False)
class AcceptanceEntry:
    """A sampling plan. `curve`, its operating characteristic: nonconforming fruit (%), probability of
    acceptance, and by attributes also that of one lot of this size. `refusals`: lots without a decision, and
    why.
    """

    words: str
    risks: str
    class_name: str
    aql: float
    curve: Float[np.ndarray, "p _c"]
    decisions: tuple[LotDecisionEntry, ...]
    refusals: tuple[tuple[LotName, str], ...] = ()


@dataclass(frozen=True, kw_only=True)
class ObjectiveSampleEntry:
    """A lot's fruit of one size, and what a firmness test of them still lacks. `cheeks`: by fruit, E of each
    recording and its standard deviation, MPa.
    """

    name: LotName
    fruit: int
    fruit_missing: int
    cheeks_missing: tuple[str, ...]
    words: str
    cheeks: tuple[tuple[str, tuple[tuple[float, float | None], ...]], ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class FirmnessEntry:
    """Readings of a penetrometer (N) against E (MPa), with the fitted relation and its 90 % band; `line` is
    None without a fit.
    """

    name: LotName
    plunger_mm: float
    words: str
    E_MPa: Float[np.ndarray, " n"]
    reading_N: Float[np.ndarray, " n"]
    line: Float[np.ndarray, "t 4"] | None = None
    """Columns: E (MPa); fitted reading, and lower and upper limit for one more fruit (N)."""


@dataclass(frozen=True, kw_only=True)
class QualityEntry:
    """Requests of a quality manager: decisions by sampling plans, samples of firmness tests, and relations to
    penetrometers.
    """

    plans: tuple[AcceptanceEntry, ...] = ()
    samples: tuple[ObjectiveSampleEntry, ...] = ()
    firmness: tuple[FirmnessEntry, ...] = ()


@dataclass(frozen=True, kw_only=True)
class HistoryEntry:
    """Content of the page. `alarms`: sentences of reference bodies that call for action. `comparisons`:
    sentences on grippers and sensors. `precision`: relative half-width for `needed`.
    """

    made_utc: datetime
    batches: int
    series: tuple[SeriesEntry, ...]
    bodies: tuple[ReferenceBodyEntry, ...] = ()
    alarms: tuple[str, ...] = ()
    groups: tuple[GroupEntry, ...] = ()
    comparisons: tuple[str, ...] = ()
    gauges: tuple[GaugeEntry, ...] = ()
    precision: float = 0.05
    quality: QualityEntry = QualityEntry()
