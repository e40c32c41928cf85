"""What the page of a history is told: lots over days, reference bodies, conversions."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime

import numpy as np
from jaxtyping import Float

from reports.entries import ReferenceBodyEntry


@dataclass(frozen=True, kw_only=True)
class DayEntry:
    """One lot on one day: its fruit, their geometric mean, and the interval of that mean (90 %, MPa)."""

    day: date
    fruit: int
    left_out: int
    """Fruit that are not graded, or in doubt."""
    E_MPa: float
    E_low_MPa: float
    E_high_MPa: float
    single_E_MPa: tuple[float, ...] = ()
    temperature_C: float | None = None


@dataclass(frozen=True, kw_only=True)
class LimitEntry:
    """When the lot's mean falls to a class's limit: a sentence, and the share of fruit below it now."""

    name: str
    E_max_MPa: float
    words: str
    share_below: float


@dataclass(frozen=True, kw_only=True, eq=False)
class SofteningEntry:
    """The fitted exponential: what it says, and its band (90 %) over days since the first."""

    words: str
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
    softening: SofteningEntry | None
    why_no_softening: str = ""
    limits: tuple[LimitEntry, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """As headings have it.

        >>> SeriesEntry(category="plum", cultivar="", lot="7", days=(), softening=None).name
        'plum, lot 7'
        """
        lot = f"lot {self.lot}" if self.lot else "without a lot"
        return f"{' '.join(filter(None, (self.category, self.cultivar)))}, {lot}"


@dataclass(frozen=True, kw_only=True)
class ConversionEntry:
    """A kept conversion to another instrument's reading, as a sentence; `used` where this page applies it."""

    title: str
    words: str
    used: bool = False


@dataclass(frozen=True, kw_only=True)
class HistoryEntry:
    """The whole page. `alarms`: what reference bodies say of the gripper that calls for somebody."""

    made_utc: datetime
    batches: int
    series: tuple[SeriesEntry, ...]
    bodies: tuple[ReferenceBodyEntry, ...] = ()
    alarms: tuple[str, ...] = ()
    conversions: tuple[ConversionEntry, ...] = ()
