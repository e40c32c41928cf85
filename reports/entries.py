"""Input of the reports: frozen records of one batch and its fruit.

The records hold finished numbers and words; reports compute no results. Units are in the names; ``None`` (or
an empty tuple) marks an unknown value. Every standard deviation is one sigma. Times are aware datetimes in
UTC.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime

from reports.grasp_record import GraspRecord


@dataclass(frozen=True, kw_only=True)
class ShoreCorrelation:
    """How well the graded moduli agree with Shore OO readings of the same fruit.

    ``p`` is the two-sided p-value of the Spearman rank correlation under "no relation".
    """

    n: int
    spearman: float
    pearson: float
    p: float | None = None


SHIP, HOLD, INSPECT = "ship", "hold", "inspect"
"""Keys of the three lists: staff ship a fruit, hold it back, or inspect it (or grasp it again)."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture on the page: its bytes (JPEG or WebP) and its file, a path from the page's folder (empty: no
    file). Without bytes the page only links to the file.
    """

    content: bytes = b""
    file: str = ""


@dataclass(frozen=True, kw_only=True)
class FruitPictures:
    """Pictures of one fruit; None marks a missing one."""

    photo: Picture | None = None
    outlines: Picture | None = None
    """Sheet of all photos with the outlines from which the mesh was made; the page only links to it."""
    mesh: Picture | None = None
    surface_sd: Picture | None = None
    scene: bytes = b""
    """3D model of the fruit as GLB; empty if the page has no 3D view."""


OR = "|"
"""Separates alternative effects: the recordings show one of them."""


@dataclass(frozen=True, kw_only=True)
class Suspect:
    """One effect that the screen suggests: its name, `short` (completes a sentence), and advice for staff."""

    name: str
    short: str
    advice: str


@dataclass(frozen=True, kw_only=True)
class Suspicion:
    """Suspected effect of a fruit whose E is not in doubt (`effect` is empty if the screen names none).
    `p_value`: the screen's p (`p_nominal`: not calibrated). E and class are given without and with the effect
    (None or empty: unknown).
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
    """Result of the screen for missing physics. `suspects`: most probable first, empty if it found none.
    `why_not`: why there is no result (a sentence without a full stop). `note`: inputs that the screen
    ignored. `p_nominal`: p is not calibrated.
    """

    p_value: float | None = None
    p_nominal: bool = False
    suspects: tuple[Suspect, ...] = ()
    why_not: str = ""
    note: str = ""

    @property
    def verdict(self) -> str:
        """The verdict in the ranking; "none" means the same as in `drupe explain`.

        >>> ScreenEntry(p_value=0.4).verdict, ScreenEntry(why_not="no gel").verdict
        ('none', 'not screened: no gel')
        """
        if self.why_not:
            return f"not screened: {self.why_not}"
        return OR.join(suspect.name for suspect in self.suspects) or "none"


@dataclass(frozen=True, kw_only=True)
class VerdictEntry:
    """A person's class for a fruit, the reason, and E at that time. `earlier`: it was graded again later."""

    judged_class: str
    by: str
    why: str
    at_utc: datetime
    E_MPa: float | None
    E_sd_MPa: float | None
    earlier: bool = False


@dataclass(frozen=True, kw_only=True)
class FruitEntry:
    """All that a report shows of one fruit, graded or not.

    A graded fruit has ``ok`` true and ``E_MPa`` set. Otherwise ``outcome`` is the failure's code and
    ``reason`` its sentence; other fields hold what was known before the failure.
    """

    fruit_id: str
    ok: bool
    outcome: str
    """Short code: ``graded``, ``too-few-views``, ``never-touches``, ..."""
    reason: str = ""
    """One sentence: what was found, what was expected."""
    rank: int | None = None
    """1 is the softest; None without a modulus."""
    rank_probability: float | None = None
    rank_low: int | None = None
    rank_high: int | None = None
    """The true rank is `rank` with `rank_probability`; with 90 % it is from `rank_low` to `rank_high`."""
    E_MPa: float | None = None
    E_sd_MPa: float | None = None
    E_scale_sd_MPa: float | None = None
    """Error from a common factor on force and gel stiffness, not in E_sd_MPa; None without a gel."""
    maturity: str | None = None
    maturity_probability: float | None = None
    class_withheld: bool = False
    """Whether it has no class because its E is in doubt."""
    other_class: str | None = None
    other_class_probability: float | None = None
    """A second possible class, if the first is less certain than the batch's `certainty`."""
    decision: str = ""
    """SHIP, HOLD or INSPECT; empty if the batch makes no decisions."""
    decision_reason: str = ""
    """Why staff must inspect it; the words complete a sentence."""
    suspicion: Suspicion | None = None
    """The numbers behind a `decision_reason` that names a suspected effect."""
    p_softer_than_next: float | None = None
    height_mm: float | None = None
    volume_mm3: float | None = None
    grasps: int = 0
    shore_oo: float | None = None
    mismatch: str | None = None
    """Name of the effect that the mechanical model lacks; OR separates effects that the recordings cannot
    distinguish, most probable first."""
    mismatch_taken: bool = False
    """Whether E accounts for `mismatch`."""
    screen: ScreenEntry | None = None
    """The screen's result for physics beyond `mismatch`; None if no screen ran."""
    reference: bool = False
    """Whether it is a reference body of known modulus, which has no rank and no class."""
    E_uncorrected_MPa: float | None = None
    """E before the correction by the reference bodies; None without a correction."""
    E_at_pulp_MPa: float | None = None
    E_at_pulp_sd_MPa: float | None = None
    """E at the pulp temperature of the grasp; None if E already refers to that temperature."""
    warnings: tuple[str, ...] = ()
    """Warnings other than doubts."""
    doubts: tuple[str, ...] = ()
    """Contradictions in the inputs of a graded fruit, each with its likely cause."""
    forced: tuple[str, ...] = ()
    """Doubts that do not widen the error bar: implausible values that --force accepted."""
    pictures: FruitPictures = FruitPictures()
    has_pit: bool = False
    """Whether the mechanics, and the picture of the mesh, have a pit."""
    recordings: tuple[GraspRecord, ...] = ()
    """Recordings that gave a modulus, in their order."""
    smaller_error: str = ""
    """Sentences on the largest part of E's error, and on how to reduce it."""
    verdicts: tuple[VerdictEntry, ...] = ()
    """Verdicts of people, latest last; E does not depend on them."""
    columns: Mapping[str, float | str] = field(default_factory=dict)
    """Cells of the user's own columns by name, without empty ones."""
    readings: Mapping[str, float] = field(default_factory=dict)
    """Simulated firmness tests by column; a name that ends in `_sd` holds a standard deviation."""
    facts: tuple[tuple[str, str], ...] = ()
    """(label, value with its unit): views used, reprojection error, pit size, mesh size, ..."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Stage name to seconds of wall time, in the order the stages ran."""
    peak_memory_MiB: float | None = None


@dataclass(frozen=True, kw_only=True)
class RatioPoint:
    """A reference body in one batch: measured over known modulus, with one standard deviation."""

    time_utc: datetime
    lot: str
    ratio: float
    sd: float


@dataclass(frozen=True, kw_only=True)
class ReferenceBodyEntry:
    """A reference body: its known and measured moduli, and their ratio."""

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
    """Sentences about the gripper from the reference bodies of a batch; ``alarm``: staff must act."""

    sentences: tuple[str, ...]
    alarm: bool
    bodies: tuple[ReferenceBodyEntry, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Unfinished:
    """Progress of an unfinished run: fruit done, fruit in total, and whether it was interrupted."""

    done: int
    total: int
    interrupted: bool = False


@dataclass(frozen=True, kw_only=True)
class BatchEntry:
    """All that a report shows of one batch: its fruit in any order, and the provenance of the figures.

    An `unfinished` run has only its finished fruit, and no exit status.
    """

    name: str
    category: str
    fruits: tuple[FruitEntry, ...]
    started_utc: datetime
    finished_utc: datetime
    """The time of these figures if the run is unfinished."""
    exit_status: int | None
    unfinished: Unfinished | None = None
    cultivar: str | None = None
    lot: str | None = None
    packer: str | None = None
    harvest_date: date | None = None
    measured_on: date | None = None
    pulp_temperature_C: float | None = None
    classes: tuple[tuple[str, float | None], ...] = ()
    """(name, highest modulus of the class in MPa), softest first; the last has no limit."""
    ships: tuple[str, ...] | None = None
    """Classes whose fruit are shipped; None if the batch makes no decisions."""
    ships_by_default: tuple[str, ...] = ()
    """Classes in `ships` for which the settings do not state whether to ship them."""
    certainty: float = 0.9
    """The probability from which a class and a decision count as certain."""
    mean_E_MPa: float | None = None
    between_sd_MPa: float | None = None
    """Mean of the graded fruit and standard deviation between them (n - 1); None for too few."""
    columns: tuple[tuple[str, str], ...] = ()
    """(name, unit or empty text) of the user's own columns."""
    readings: tuple[str, ...] = ()
    """Columns of simulated firmness tests; the unit ends the name."""
    reading_titles: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Title and unit of a simulated firmness test by its column."""
    settings: tuple[tuple[str, str], ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    inputs: tuple[tuple[str, str], ...] = ()
    """(path inside the batch folder, SHA-256 in hex)."""
    shore: ShoreCorrelation | None = None
    reference: ReferenceEntry | None = None
    faults: tuple[str, ...] = ()
    """Faults of sensors or jaws in the whole batch, one sentence each."""
    screened: bool = False
    """Whether any of its fruit was screened for missing physics."""


def ranked(fruits: tuple[FruitEntry, ...]) -> tuple[FruitEntry, ...]:
    """Fruit by rank, then without rank (graded first), ties by fruit_id; reference bodies are last.

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
    """The fruit without the reference bodies."""
    return tuple(fruit for fruit in fruits if not fruit.reference)
