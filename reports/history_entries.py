"""What the page of a history is told: lots over days and reference bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime

import numpy as np
from jaxtyping import Float

from reports.entries import ReferenceBodyEntry


@dataclass(frozen=True, kw_only=True)
class LotStatistics:
    """Of n fruit, E in MPa: percentiles are of 10, 25, 50, 75 and 90 %; `sd_MPa` and `needed` are None of one
    fruit. `needed`: fruit from which the half-width of the mean's 90 % interval is at most the stated share
    of the mean, if their spread is this one; None where that is out of reach.
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
    """Fruit that are not graded, or in doubt."""
    E_MPa: float
    E_low_MPa: float
    E_high_MPa: float
    single_E_MPa: tuple[float, ...]
    temperature_C: float | None
    statistics: LotStatistics

    @property
    def fruit(self) -> int:
        """How many count."""
        return self.statistics.n


@dataclass(frozen=True, kw_only=True)
class LimitEntry:
    """When the lot's mean, and a tenth of its fruit, fall to a class's limit: sentences; the share of fruit
    below it now, and the share outside the class with its interval (90 %).
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
    def name(self) -> str:
        """As headings have it.

        >>> SeriesEntry(category="plum", cultivar="", lot="7", days=()).name
        'plum, lot 7'
        """
        lot = f"lot {self.lot}" if self.lot else "without a lot"
        return f"{' '.join(filter(None, (self.category, self.cultivar)))}, {lot}"


@dataclass(frozen=True, kw_only=True)
class DifferenceEntry:
    """Two lots of a cultivar on their last days: mean E of the first minus that of the second, MPa, with its
    90 % interval. `p`: of Welch's test, adjusted for the number of pairs.
    """

    first: str
    second: str
    difference_MPa: float
    low_MPa: float
    high_MPa: float
    p: float


@dataclass(frozen=True, kw_only=True)
class GroupEntry:
    """Lots of one cultivar together; `words` and `rates`: how fast ln E falls a day, by the mixed model."""

    name: str
    series: tuple[SeriesEntry, ...]
    words: str
    rates: Mapping[str, float]
    differences: tuple[DifferenceEntry, ...] = ()


@dataclass(frozen=True, kw_only=True)
class GaugeEntry:
    """A gauge study of grippers or sensors: `components` by name, in % of E and in % of the total variation;
    `biases` of each gripper or sensor against their mean, in % of E.
    """

    kind: str
    words: str
    components: tuple[tuple[str, float, float], ...]
    biases: tuple[tuple[str, float], ...]


@dataclass(frozen=True, kw_only=True)
class LotDecisionEntry:
    """A lot on its last day, and what the sampling plan says of it."""

    name: str
    verdict: str
    words: str


@dataclass(frozen=True, kw_only=True, eq=False)
class AcceptanceEntry:
    """A sampling plan with its operating characteristic: nonconforming fruit in per cent, probability of
    acceptance; by attributes also that of one lot of this size. `refusals`: lots without a decision.
    """

    words: str
    risks: str
    class_name: str
    aql: float
    curve: Float[np.ndarray, "p _c"]
    decisions: tuple[LotDecisionEntry, ...]
    refusals: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ObjectiveSampleEntry:
    """Fruit of one size of a lot: what a test of firmness needs of them. `cheeks`: by fruit, E in MPa (sd) of
    each recording.
    """

    name: str
    fruit: int
    fruit_missing: int
    cheeks_missing: tuple[str, ...]
    words: str
    cheeks: tuple[tuple[str, tuple[tuple[float, float | None], ...]], ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class FirmnessEntry:
    """Readings of a penetrometer (N) against E (MPa), with the fitted relation and its 90 % band; no line
    where none was fitted.
    """

    title: str
    words: str
    E_MPa: Float[np.ndarray, " n"]
    reading_N: Float[np.ndarray, " n"]
    line: Float[np.ndarray, "t 4"] | None = None
    """E in MPa; reading, and low and high end for one more fruit, in N."""


@dataclass(frozen=True, kw_only=True)
class QualityEntry:
    """What a quality manager asked for: decisions by sampling plans, samples of the test of firmness, and
    relations to penetrometers.
    """

    plans: tuple[AcceptanceEntry, ...] = ()
    samples: tuple[ObjectiveSampleEntry, ...] = ()
    firmness: tuple[FirmnessEntry, ...] = ()


@dataclass(frozen=True, kw_only=True)
class HistoryEntry:
    """The whole page. `alarms`: what reference bodies say of the gripper that calls for somebody.
    `comparisons`: sentences on grippers and sensors. `precision`: of the mean, by which fruit are counted.
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
