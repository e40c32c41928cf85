"""What the reports are told: frozen records of one batch and its fruits.

The records hold finished figures and ready words; nothing here or behind them computes a result.
Units are in the names; ``None`` (or an empty tuple) says that a figure is not known. Every standard
deviation is one sigma. Times are aware datetimes in UTC.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime

from reports.grasp_record import GraspRecord


@dataclass(frozen=True, kw_only=True)
class ShoreCorrelation:
    """How the graded moduli agree with Shore OO readings of the same fruits.

    ``p`` is the two-sided p-value of the Spearman rank correlation under "no relation".
    """

    n: int
    spearman: float
    pearson: float
    p: float | None = None


SHIP, HOLD, INSPECT = "ship", "hold", "inspect"
"""Lists that a fruit may be on: to be shipped, to be held back, to be inspected (or grasped again)."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture that the page holds: its bytes, JPEG or WebP, and the file of it, as a path from the page's
    folder (empty: there is none). Without bytes the page only links to the file.
    """

    content: bytes = b""
    file: str = ""


@dataclass(frozen=True, kw_only=True)
class FruitPictures:
    """Those that a fruit has."""

    photo: Picture | None = None
    outlines: Picture | None = None
    """All photos with the outlines that the shape was made from; the page has a link to it alone."""
    mesh: Picture | None = None
    surface_sd: Picture | None = None
    scene: bytes = b""
    """The fruit in three dimensions, as GLB; empty where the page is not to hold it."""


OR = "|"
"""Between effects of which one is there."""


@dataclass(frozen=True, kw_only=True)
class Suspect:
    """One effect that the screen suggests: its name, what it is (to complete a sentence), what to do."""

    name: str
    short: str
    advice: str


@dataclass(frozen=True, kw_only=True)
class Suspicion:
    """Why a fruit is to be inspected although its E is not in doubt: the suspected effect (empty: none is
    named), the screen's p (`p_nominal`: not calibrated), and E and class without and with the effect (None,
    empty: not known).
    """

    effect: str
    p_value: float | None
    E_MPa: float
    E_sd_MPa: float
    p_nominal: bool = False
    maturity: str = ""
    E_with_MPa: float | None = None
    E_with_sd_MPa: float | None = None
    maturity_with: str = ""


@dataclass(frozen=True, kw_only=True)
class ScreenEntry:
    """What the screen for missing physics says of a fruit: suspects, the likeliest first, none where nothing
    was found; or in `why_not` why it says nothing (a sentence without a full stop). `note`: what was left
    out. `p_nominal`: p is not calibrated.
    """

    p_value: float | None = None
    p_nominal: bool = False
    suspects: tuple[Suspect, ...] = ()
    why_not: str = ""
    note: str = ""

    @property
    def verdict(self) -> str:
        """As the ranking has it; "none" as `drupe explain` says it.

        >>> ScreenEntry(p_value=0.4).verdict, ScreenEntry(why_not="no gel").verdict
        ('none', 'not screened: no gel')
        """
        if self.why_not:
            return f"not screened: {self.why_not}"
        return OR.join(suspect.name for suspect in self.suspects) or "none"


@dataclass(frozen=True, kw_only=True)
class VerdictEntry:
    """A person's class for a fruit, why, and E as it was then. `earlier`: it was graded again since."""

    judged_class: str
    by: str
    why: str
    at_utc: datetime
    E_MPa: float | None
    E_sd_MPa: float | None
    earlier: bool = False


@dataclass(frozen=True, kw_only=True)
class FruitEntry:
    """All that a report says of one fruit, graded or not.

    A graded fruit has ``ok`` true and ``E_MPa`` set. One that is not has ``outcome``, the short code of
    what stopped it, ``reason``, the sentence, and whatever was known before it stopped.
    """

    fruit_id: str
    ok: bool
    outcome: str
    """Short code: ``graded``, ``too-few-views``, ``never-touches``, ..."""
    reason: str = ""
    """One sentence: what was found, what was expected."""
    rank: int | None = None
    """1 is the softest; None where there is no modulus."""
    rank_probability: float | None = None
    rank_low: int | None = None
    rank_high: int | None = None
    """The true rank is `rank` with `rank_probability`, and from `rank_low` to `rank_high` with 90 %."""
    E_MPa: float | None = None
    E_sd_MPa: float | None = None
    E_scale_sd_MPa: float | None = None
    """Beside E_sd_MPa, by a common factor on force and gel stiffness; None where there is no gel."""
    maturity: str | None = None
    maturity_probability: float | None = None
    class_withheld: bool = False
    """Whether it has no class because its E is in doubt."""
    other_class: str | None = None
    other_class_probability: float | None = None
    """The class that it may have as well, where its own is less certain than the batch's `certainty`."""
    decision: str = ""
    """SHIP, HOLD or INSPECT; empty where nothing parts the fruit."""
    decision_reason: str = ""
    """Why it is to be inspected, to complete a sentence."""
    suspicion: Suspicion | None = None
    """What `decision_reason` says of a suspected effect, in numbers."""
    p_softer_than_next: float | None = None
    height_mm: float | None = None
    volume_mm3: float | None = None
    grasps: int = 0
    shore_oo: float | None = None
    mismatch: str | None = None
    """What the mechanical model is found to leave out, as a name of the effect vocabulary; several that
    cannot be told apart with OR between them, the likeliest first."""
    mismatch_taken: bool = False
    """Whether E takes that into account."""
    screen: ScreenEntry | None = None
    """What the screen says of what is left beyond that; None where it was left out."""
    reference: bool = False
    """Whether it is no fruit but a body of known modulus, which has no rank and no class."""
    E_uncorrected_MPa: float | None = None
    """E before it was divided by what the reference bodies say; None where it was not."""
    E_at_pulp_MPa: float | None = None
    E_at_pulp_sd_MPa: float | None = None
    """E at the temperature at which the fruit was grasped; None where E is that."""
    warnings: tuple[str, ...] = ()
    """Beyond the doubts."""
    doubts: tuple[str, ...] = ()
    """What cannot be right in the inputs, with its likely cause, of a fruit that is graded all the same."""
    forced: tuple[str, ...] = ()
    """Of the doubts, those that do not widen its error bar: numbers that no fruit has, graded by --force."""
    pictures: FruitPictures = FruitPictures()
    has_pit: bool = False
    """Whether the mechanics, and the picture of the mesh, have a pit."""
    recordings: tuple[GraspRecord, ...] = ()
    """Those that gave a modulus, in their order."""
    smaller_error: str = ""
    """What E's error bar is made of for the most part, and what would make it smaller; sentences."""
    verdicts: tuple[VerdictEntry, ...] = ()
    """What people say of it, the latest last; E does not depend on them."""
    columns: Mapping[str, float | str] = field(default_factory=dict)
    """Cells of the user's own columns, by name; empty ones are left out."""
    readings: Mapping[str, float] = field(default_factory=dict)
    """Of simulated firmness tests, by column; with `_sd` at its end, a standard deviation."""
    facts: tuple[tuple[str, str], ...] = ()
    """(label, value with its unit): views used, reprojection error, pit size, mesh size, ..."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Stage name to seconds of wall time, in the order the stages ran."""
    peak_memory_MiB: float | None = None


@dataclass(frozen=True, kw_only=True)
class RatioPoint:
    """A reference body in one batch: its modulus found over known, and one standard deviation of that."""

    time_utc: datetime
    lot: str
    ratio: float
    sd: float


@dataclass(frozen=True, kw_only=True)
class ReferenceBodyEntry:
    """A body of known modulus: known and found, and their ratio."""

    fruit_id: str
    E_known_MPa: float
    E_known_sd_MPa: float
    E_found_MPa: float
    E_found_sd_MPa: float
    ratio: float
    ratio_sd: float
    history: tuple[RatioPoint, ...] = ()
    """The body's points of the control chart of `drupe history`, oldest first."""


@dataclass(frozen=True, kw_only=True)
class ReferenceEntry:
    """What the reference bodies of a batch say of the gripper, in words; ``alarm`` where staff must act."""

    sentences: tuple[str, ...]
    alarm: bool
    bodies: tuple[ReferenceBodyEntry, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Unfinished:
    """How far a run is that has not come to its end: fruit done and in all; whether it was interrupted."""

    done: int
    total: int
    interrupted: bool = False


@dataclass(frozen=True, kw_only=True)
class BatchEntry:
    """All that a report says of one batch: its fruits in any order, and where the figures come from.

    Of an `unfinished` run: the fruits that are done, and no exit status.
    """

    name: str
    category: str
    fruits: tuple[FruitEntry, ...]
    started_utc: datetime
    finished_utc: datetime
    """Of an unfinished run, the time of these figures."""
    exit_status: int | None
    unfinished: Unfinished | None = None
    cultivar: str | None = None
    lot: str | None = None
    packer: str | None = None
    harvest_date: date | None = None
    pulp_temperature_C: float | None = None
    classes: tuple[tuple[str, float | None], ...] = ()
    """(name, highest modulus of the class in MPa), softest first; the last has no limit."""
    ships: tuple[str, ...] | None = None
    """The classes whose fruit are shipped; None where nothing parts the fruit."""
    ships_by_default: tuple[str, ...] = ()
    """Those of them of which the settings do not say whether they are shipped."""
    certainty: float = 0.9
    """The probability from which a class and a decision count as certain."""
    mean_E_MPa: float | None = None
    between_sd_MPa: float | None = None
    """Mean of the graded fruit and standard deviation between them (n - 1); None for too few."""
    columns: tuple[tuple[str, str], ...] = ()
    """(name, unit or empty text) of the user's own columns."""
    readings: tuple[str, ...] = ()
    """Columns of simulated firmness tests; the unit ends the name."""
    settings: tuple[tuple[str, str], ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    inputs: tuple[tuple[str, str], ...] = ()
    """(path inside the batch folder, SHA-256 in hex)."""
    shore: ShoreCorrelation | None = None
    reference: ReferenceEntry | None = None
    faults: tuple[str, ...] = ()
    """What sensors or jaws have wrong in the whole batch, a sentence each."""
    screened: bool = False
    """Whether fruit of it were screened for missing physics."""


def ranked(fruits: tuple[FruitEntry, ...]) -> tuple[FruitEntry, ...]:
    """In reading order: fruits by rank, those without a rank, ties by fruit_id; reference bodies after all.

    >>> from reports.entries import FruitEntry, ranked
    >>> hard = FruitEntry(fruit_id="a", ok=True, outcome="graded", rank=2)
    >>> lost = FruitEntry(fruit_id="b", ok=False, outcome="no-photos")
    >>> soft = FruitEntry(fruit_id="c", ok=True, outcome="graded", rank=1)
    >>> [fruit.fruit_id for fruit in ranked((hard, lost, soft))]
    ['c', 'a', 'b']
    """

    def place(fruit: FruitEntry) -> tuple[object, ...]:
        return fruit.reference, fruit.rank is None, fruit.rank or 0, not fruit.ok, fruit.fruit_id

    return tuple(sorted(fruits, key=place))


def without_references(fruits: tuple[FruitEntry, ...]) -> tuple[FruitEntry, ...]:
    """The fruit alone."""
    return tuple(fruit for fruit in fruits if not fruit.reference)
