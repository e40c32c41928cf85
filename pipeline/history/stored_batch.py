"""Reads one graded batch from its results for the history, without pictures and meshes."""

import hashlib
import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, field, replace
from datetime import date, datetime
from pathlib import Path, PurePosixPath
from typing import Any

from pydantic.dataclasses import dataclass

from pipeline.batch.firmness_columns import firmness_readings
from pipeline.batch.layout import Results
from pipeline.batch.provenance import require_finished
from pipeline.batch.records import FruitRecord, read_record
from pipeline.files.manifest import why_damaged
from pipeline.files.plain_file import composed_texts, printable
from pipeline.problem import BatchRefused, Problem, refused
from reports.history_entries import LotName

DESCRIPTIONS = frozenset({".toml", ".json"})
"""Suffixes of files beside a recording's frames that describe sensor and pads; many recordings share them."""
GRADE_AGAIN = "move it away and run `drupe grade` again to rebuild it."


@dataclass(frozen=True, kw_only=True)
class StoredGrasp:
    """A recording by its name and SHA-256; its E alone, None if it has none."""

    grasp: str = ""
    recording: str = ""
    E_MPa: float | None = None
    E_sd_MPa: float | None = None
    peak_force_N: float | None = None


@dataclass(frozen=True, kw_only=True)
class StoredFruit:
    """One fruit, or reference body (`E_known_MPa`), with its measured E; missing readings are None.

    `doubted`: whether its inputs contain a contradiction; the page shows such fruit, and no fit uses them.
    """

    fruit_id: str
    E_MPa: float
    E_sd_MPa: float
    doubted: bool = False
    E_known_MPa: float | None = None
    E_known_sd_MPa: float | None = None
    shore_oo: float | None = None
    penetrometer_N: float | None = None
    grasps: tuple[StoredGrasp, ...] = ()
    columns: dict[str, float | str] = field(default_factory=dict)
    """Readings of `drupe firmness`, and cells of the user's columns."""

    @property
    def recordings(self) -> tuple[str, ...]:
        """The SHA-256 of each recording, sorted."""
        return tuple(sorted(grasp.recording for grasp in self.grasps if grasp.recording))

    @property
    def fitted(self) -> bool:
        """Whether it counts for its lot: it is no reference body and not in doubt."""
        return self.E_known_MPa is None and not self.doubted


@dataclass(frozen=True, kw_only=True)
class StoredBatch:
    """A batch on its day. `key`: in a store, its name there; otherwise a SHA-256 of category, cultivar, lot,
    day and the fruit's input files. `limits`: (name, highest E in MPa or None) of its maturity classes.
    `lost`: fruit without E. `dated`: whether the settings state the day. `revisions`: number of earlier
    results in the store. `listed`: ids of all fruit in its latest results.
    """

    key: str
    folder: str
    measured: date
    graded_utc: str
    category: str
    cultivar: str = ""
    lot: str = ""
    orchard: str = ""
    operator: str = ""
    gripper: str = ""
    gripper_serial: str = ""
    sensor: str = ""
    sensor_serial: str = ""
    calibration: str = ""
    calibrated_on: date | None = None
    harvest: date | None = None
    temperature_C: float | None = None
    limits: tuple[tuple[str, float | None], ...] = ()
    fruit: tuple[StoredFruit, ...] = ()
    lost: tuple[str, ...] = ()
    dated: bool = False
    revisions: int = 0
    listed: tuple[str, ...] = ()

    @property
    def missing(self) -> tuple[str, ...]:
        """Fruit of earlier results that the latest lack; they still count."""
        ids = (*(fruit.fruit_id for fruit in self.fruit), *self.lost)
        return tuple(name for name in ids if name not in self.listed) if self.listed else ()

    @property
    def group(self) -> LotName:
        """The cultivar, whose fruit share one relation to other instruments."""
        return LotName(category=self.category, cultivar=self.cultivar)

    @property
    def lot_day(self) -> LotName:
        """The lot on the day of the batch."""
        return replace(self.group, lot=self.lot, day=self.measured)

    @property
    def series(self) -> tuple[str, str, str]:
        """Category, cultivar and lot, which identify the days of one lot."""
        return self.category, self.cultivar, self.lot


def stored_batch(out: Path) -> StoredBatch:
    """The batch with results in `out`. Raises BatchRefused if they are missing, unfinished or damaged."""
    results = Results(out)
    if results.provenance.is_file() and (why := why_damaged(results.provenance)):
        raise refused(results.provenance, f"{why}; {GRADE_AGAIN}")
    said = require_finished(results)
    try:
        return composed_batch(_batch(out, results, said))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        why = f"{type(error).__name__}: {printable(str(error))[:80]}"
        sentence = f"is damaged or from another version ({why}); grade the batch again."
        raise refused(results.provenance, sentence) from None


def composed_batch(batch: StoredBatch) -> StoredBatch:
    """The batch with composed letters (Unicode NFC) in all names, but not in its folder, which is a path."""
    return StoredBatch(**composed_texts(asdict(batch)) | {"folder": batch.folder})


def _batch(out: Path, results: Results, said: Mapping[str, Any]) -> StoredBatch:
    settings, outcomes, inputs = said["settings"], said["outcomes"], said["inputs"]
    paths = [results.fruit(str(name)).record for name in outcomes]
    damaged = [(path, why) for path in paths if path.is_file() and (why := why_damaged(path))]
    if damaged:
        raise BatchRefused(Problem(str(path), f"{why}; {GRADE_AGAIN}") for path, why in damaged)
    records = [record for path in paths if (record := read_record(path)) is not None]
    if unread := [name for name in outcomes if name not in {record.fruit_id for record in records}]:
        raise ValueError(f"no record.json of {', '.join(map(printable, unread[:3]))}")
    recordings, firmness = _recordings(inputs), firmness_readings(results)
    fruit = [
        _fruit(record, recordings.get(record.fruit_id, {}), firmness.of(record))
        for record in records
        if record.graded and record.modulus is not None and 0 < record.modulus.E_MPa < math.inf
    ]
    graded = {specimen.fruit_id for specimen in fruit}
    classes = (settings.get("grading") or {}).get("classes") or ()
    gripper, sensor = settings.get("gripper") or {}, settings.get("sensor") or {}
    return StoredBatch(
        key=_key(inputs, settings),
        folder=str(said.get("batch") or out.resolve()),
        measured=settings.get("measured_on") or datetime.fromisoformat(said["started_utc"]).date(),
        graded_utc=said["started_utc"],
        category=settings["category"],
        cultivar=settings.get("cultivar") or "",
        lot=settings.get("lot") or "",
        orchard=settings.get("orchard") or "",
        operator=settings.get("operator") or "",
        gripper=gripper.get("name") or "",
        gripper_serial=gripper.get("serial") or "",
        sensor=sensor.get("name") or "",
        sensor_serial=sensor.get("serial") or "",
        calibration=sensor.get("calibration") or "",
        calibrated_on=sensor.get("calibrated_on"),
        harvest=settings.get("harvest_date"),
        temperature_C=settings.get("pulp_temperature_C"),
        limits=tuple((grade["name"], grade.get("E_max_MPa")) for grade in classes),
        lost=tuple(name for name in outcomes if name not in graded),
        dated=bool(settings.get("measured_on")),
        listed=tuple(sorted(outcomes)),
        fruit=tuple(fruit),
    )


def _recordings(inputs: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """By fruit and recording, the SHA-256 of the sorted SHA-256 of its files (without DESCRIPTIONS)."""
    by_recording: dict[tuple[str, str], list[str]] = defaultdict(list)
    for name, digest in inputs.items():
        path = PurePosixPath(name)
        of_a_grasp = len(path.parts) > 3 and (path.parts[0], path.parts[2]) == ("fruits", "grasps")
        if of_a_grasp and path.suffix.lower() not in DESCRIPTIONS:
            by_recording[path.parts[1], path.parts[3]].append(digest)
    by_fruit: dict[str, dict[str, str]] = defaultdict(dict)
    for (fruit_id, recording), digests in by_recording.items():
        by_fruit[fruit_id][recording] = hashlib.sha256("\n".join(sorted(digests)).encode()).hexdigest()
    return by_fruit


def _grasps(record: FruitRecord, recordings: Mapping[str, str]) -> tuple[StoredGrasp, ...]:
    """The fruit's recordings with E from the record, which names each by its file or the file's stem."""
    by_name = {grasp.grasp: grasp for grasp in record.grasps}
    grasps = []
    for name, digest in recordings.items():
        known = by_name.get(name, by_name.get(PurePosixPath(name).stem))
        numbers = {} if known is None else known.model_dump(include={"E_MPa", "E_sd_MPa", "peak_force_N"})
        grasps.append(StoredGrasp(grasp=name, recording=digest, **numbers))
    return tuple(sorted(grasps, key=lambda grasp: (grasp.recording, grasp.grasp)))


def _fruit(record: FruitRecord, recordings: Mapping[str, str], readings: Mapping[str, float]) -> StoredFruit:
    """The fruit with its ranked E (corrected by reference bodies and temperature); a body as measured."""
    given = record.given
    E_MPa, E_sd_MPa = record.ranked_modulus
    if E_MPa is None or E_sd_MPa is None:
        raise ValueError(f"{record.fruit_id} has no modulus")
    return StoredFruit(
        fruit_id=record.fruit_id,
        E_MPa=E_MPa,
        E_sd_MPa=E_sd_MPa,
        doubted=bool(record.doubts),
        E_known_MPa=given.reference_E_MPa if given.reference else None,
        E_known_sd_MPa=given.reference_E_sd_MPa if given.reference else None,
        shore_oo=given.shore_oo,
        penetrometer_N=given.penetrometer_N,
        grasps=_grasps(record, recordings),
        columns={**readings, **given.columns},
    )


def _key(inputs: Mapping[str, str], settings: Mapping[str, Any]) -> str:
    """SHA-256 of category, cultivar, lot, stated day and the hashes of the fruit's input files."""
    measured = sorted(digest for path, digest in inputs.items() if path.startswith("fruits/"))
    said = [str(settings.get(name)) for name in ("category", "cultivar", "lot", "measured_on")]
    return hashlib.sha256("\n".join([*said, *measured]).encode()).hexdigest()
