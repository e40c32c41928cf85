"""What a quality manager asks of lots: acceptance, samples for the test of firmness, readings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import pandas as pd

from pipeline.batch.write_guard import require_new_or_ours
from pipeline.files.whole_file import put
from pipeline.history.acceptance_plans import NoPlan, operating_characteristic
from pipeline.history.firmness_relation import (
    FirmnessRelation,
    Key,
    NoReading,
    firmness_relations,
    reading_of,
)
from pipeline.history.lot_acceptance import PlanWanted, acceptance_entries, plan_words
from pipeline.history.objective_test import CHEEKS, objective_samples
from pipeline.history.stored_batch import StoredBatch
from pipeline.history.table_file import require_format, starts_with, table_bytes
from pipeline.problem import refused
from reports.history_entries import QualityEntry

OC_COLUMNS = ("nonconforming_percent", "acceptance_probability")
"""First columns of the table of an operating characteristic."""


@dataclass(frozen=True, kw_only=True)
class QualityWanted:
    """Options of `drupe history`: `accept`: the class whose fruit conform. `oecd`: cheeks that one recording
    presses. `firmness`: texts COLUMN=UNIT@PLUNGER.
    """

    accept: str = ""
    plan: PlanWanted = field(default_factory=PlanWanted)
    oecd: int | None = None
    size_column: str = ""
    firmness: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class QualityFound:
    """The page's part, sentences for the terminal, and the fitted relations."""

    entry: QualityEntry = field(default_factory=QualityEntry)
    said: tuple[str, ...] = ()
    relations: Mapping[Key, FirmnessRelation] = field(default_factory=dict)


def lots_quality(batches: Sequence[StoredBatch], wanted: QualityWanted) -> QualityFound:
    """Raises BatchRefused where an option says what cannot be."""
    if wanted.plan.lot_size and not wanted.accept:
        raise refused("drupe history", "--lot-size needs --accept CLASS.")
    if wanted.oecd is not None and not 1 <= wanted.oecd <= CHEEKS:
        raise refused(
            "drupe history", f"--oecd: found {wanted.oecd}, expected 1 or {CHEEKS} cheeks per recording."
        )
    if wanted.size_column and wanted.oecd is None:
        raise refused("drupe history", "--size-column needs --oecd.")
    try:
        plans = tuple(acceptance_entries(batches, wanted.accept, wanted.plan)) if wanted.accept else ()
    except NoPlan as reason:
        raise refused("--accept", f"{reason}.") from None
    samples = (
        ()
        if wanted.oecd is None
        else tuple(
            objective_samples(batches, cheeks_per_recording=wanted.oecd, size_column=wanted.size_column)
        )
    )
    try:
        relations = list(firmness_relations(batches, [reading_of(text) for text in wanted.firmness]))
    except NoReading as reason:
        raise refused("--firmness", f"{reason}.") from None
    if wanted.firmness and not relations:
        raise refused(
            "--firmness", "no fruit has a reading in these columns; check their names in fruits.csv."
        )
    said = [f"{one.words}. {one.risks}." for one in plans]
    said += [f"{lot.name}: {lot.verdict}: {lot.words}." for one in plans for lot in one.decisions]
    said += [f"{refusal}." for one in plans for refusal in one.refusals]
    said += [f"{sample.name}: {sample.words}." for sample in samples]
    said += [f"{entry.title}: {entry.words}." for _, entry, _ in relations]
    return QualityFound(
        entry=QualityEntry(plans=plans, samples=samples, firmness=tuple(entry for _, entry, _ in relations)),
        said=tuple(said),
        relations={key: fit for key, _, fit in relations if fit is not None},
    )


def characteristics(quality: QualityEntry) -> pd.DataFrame:
    """Operating characteristics of all plans, one below the other."""
    frames = []
    for plan in quality.plans:
        columns = dict(zip(OC_COLUMNS, (plan.percent, plan.probability), strict=True))
        frames.append(
            pd.DataFrame({**columns, "lot_acceptance_probability": plan.lot_probability, "plan": plan.words})
        )
    return pd.concat(frames, ignore_index=True).round(6)


def sampling_plan(wanted: PlanWanted, oc: Path | None) -> Iterator[str]:
    """The plan in words, and its curve as a table at `oc`. Raises BatchRefused."""
    if oc is not None:
        require_format(oc, "--oc")
        require_new_or_ours(oc, partial(starts_with, columns=OC_COLUMNS), "a table of drupe plan --oc")
    if not wanted.lot_size:
        raise refused("drupe plan", "needs --lot-size, the number of fruit in the lot.")
    try:
        plan = wanted.plan()
    except NoPlan as reason:
        raise refused("drupe plan", f"{reason}.") from None
    yield from (f"{words}." for words in plan_words(plan))
    if oc is not None:
        put(oc, table_bytes(operating_characteristic(plan), oc.suffix.lower()))
        yield f"written: {oc}"
