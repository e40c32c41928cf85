"""One graded batch as history keeps it: read from its results, without pictures and meshes."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path
from typing import Any

from pipeline.batch.layout import Results
from pipeline.batch.records import FruitRecord, read_record
from pipeline.files.manifest import json_in
from pipeline.problem import BatchRefused, Problem
from recon.plain_file import printable

SCALES = ("shore_oo", "penetrometer_N")
"""Columns of fruits.csv with the reading of another instrument."""


@dataclass(frozen=True, kw_only=True)
class StoredFruit:
    """One fruit, or reference body (`E_known_MPa`), with its measured E; readings None where not taken.

    `doubted`: whether something in its inputs cannot be right; such fruit are shown and not fitted.
    """

    fruit_id: str
    E_MPa: float
    E_sd_MPa: float
    doubted: bool = False
    E_known_MPa: float | None = None
    E_known_sd_MPa: float | None = None
    shore_oo: float | None = None
    penetrometer_N: float | None = None


@dataclass(frozen=True, kw_only=True)
class StoredBatch:
    """A batch on its day. `key`: SHA-256 of its photos and recordings, by which the same batch graded again
    takes its own place; `limits`: (name, highest E in MPa or None) of its maturity classes.
    """

    key: str
    folder: str
    measured: date
    graded_utc: str
    category: str
    cultivar: str
    lot: str
    harvest: date | None
    temperature_C: float | None
    limits: tuple[tuple[str, float | None], ...]
    not_graded: int
    fruit: tuple[StoredFruit, ...]

    @property
    def group(self) -> str:
        """Category and cultivar, by which conversions are kept."""
        return f"{self.category} {self.cultivar}".strip()

    @property
    def series(self) -> tuple[str, str, str]:
        """Category, cultivar and lot, whose days belong together."""
        return self.category, self.cultivar, self.lot


def stored_batch(out: Path) -> StoredBatch:
    """The batch whose results are in `out`. Raises BatchRefused where there are none that can be read."""
    results = Results(out)
    said = json_in(results.provenance)
    if not isinstance(said, dict) or said.get("format") != "drupe-batch-result":
        where = out / "results"
        hint = f"; did you mean {where}?" if Results(where).provenance.is_file() else ""
        sentence = (
            f"holds no results of drupe grade (batch.json){hint or '; give the folder that --out named'}."
        )
        raise BatchRefused([Problem(str(out), sentence)])
    if said.get("exit_status") is None:
        sentence = "is of a run that has not ended; let `drupe grade` finish it first."
        raise BatchRefused([Problem(str(results.provenance), sentence)])
    try:
        return _batch(out, results, said)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        sentence = f"is damaged or of another version ({type(error).__name__}: {printable(str(error))[:80]})"
        raise BatchRefused(
            [Problem(str(results.provenance), f"{sentence}; grade the batch again.")]
        ) from None


def _batch(out: Path, results: Results, said: Mapping[str, Any]) -> StoredBatch:
    settings = said["settings"]
    started = datetime.fromisoformat(said["started_utc"])
    records = [read_record(results.fruit(str(name)).record) for name in said["outcomes"]]
    lost = [name for name, one in zip(said["outcomes"], records, strict=True) if one is None]
    if lost:
        raise ValueError(f"no record.json of {', '.join(map(printable, lost[:3]))}")
    fruit = [stored for one in records if one is not None and (stored := _fruit(one)) is not None]
    classes = (settings.get("grading") or {}).get("classes") or ()
    return StoredBatch(
        key=_key(said["inputs"], settings),
        folder=str(said.get("batch") or out.resolve()),
        measured=_date(settings.get("measured_on")) or started.date(),
        graded_utc=str(said["started_utc"]),
        category=str(settings["category"]),
        cultivar=str(settings.get("cultivar") or ""),
        lot=str(settings.get("lot") or ""),
        harvest=_date(settings.get("harvest_date")),
        temperature_C=settings.get("pulp_temperature_C"),
        limits=tuple((str(one["name"]), one.get("E_max_MPa")) for one in classes),
        not_graded=len(records) - len(fruit),
        fruit=tuple(fruit),
    )


def _fruit(record: FruitRecord) -> StoredFruit | None:
    """The fruit as ranked (divided by what reference bodies say, where it was); a body as it was measured."""
    if not record.graded or record.modulus is None:
        return None
    given, found = record.given, record.modulus
    E_MPa, sd_MPa = found.E_MPa, found.E_sd_MPa
    if record.reference is not None and not given.reference:
        E_MPa, sd_MPa = record.reference.E_MPa, record.reference.E_sd_MPa
    if not (math.isfinite(E_MPa) and E_MPa > 0):
        return None
    return StoredFruit(
        fruit_id=record.fruit_id,
        E_MPa=E_MPa,
        E_sd_MPa=sd_MPa,
        doubted=bool(record.doubts),
        E_known_MPa=given.reference_E_MPa if given.reference else None,
        E_known_sd_MPa=given.reference_E_sd_MPa if given.reference else None,
        shore_oo=given.shore_oo,
        penetrometer_N=given.penetrometer_N,
    )


def _key(inputs: Mapping[str, str], settings: Mapping[str, Any]) -> str:
    """Of what was measured, and of the lot and day that it is said to be of."""
    measured = sorted(digest for path, digest in inputs.items() if path.startswith("fruits/"))
    said = [str(settings.get(name)) for name in ("category", "cultivar", "lot", "measured_on")]
    return hashlib.sha256("\n".join([*said, *measured]).encode()).hexdigest()


def _date(text: object) -> date | None:
    return date.fromisoformat(text) if isinstance(text, str) else None
