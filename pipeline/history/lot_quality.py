"""The quality part of a history: acceptance of lots, samples for the firmness test, firmness relations."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from pipeline.batch.write_guard import require_new_or_ours
from pipeline.history.acceptance_plans import OC_COLUMNS, NoPlan, operating_characteristic
from pipeline.history.firmness_relation import (
    FirmnessRelation,
    Key,
    NoReading,
    firmness_relations,
    reading_of,
)
from pipeline.history.lot_acceptance import PlanWanted, acceptance_entries, plan_words
from pipeline.history.objective_test import objective_samples
from pipeline.history.stored_batch import StoredBatch
from pipeline.history.table_file import put_table, require_format, table_of
from pipeline.problem import refused
from reports.history_entries import QualityEntry
from reports.words import lot_words, plunger_words

COMMAND = "drupe history"


@dataclass(frozen=True, kw_only=True)
class QualityWanted:
    """Options of `drupe history`. `accept`: the class of conforming fruit. `oecd`: cheeks that one recording
    presses, 0 without the test. `firmness`: texts COLUMN=UNIT@PLUNGER.
    """

    accept: str = ""
    plan: PlanWanted = field(default_factory=PlanWanted)
    oecd: int = 0
    size_column: str = ""
    firmness: tuple[str, ...] = ()


def lots_quality(
    batches: Sequence[StoredBatch], wanted: QualityWanted
) -> tuple[QualityEntry, dict[Key, FirmnessRelation]]:
    """The quality part of the page, and the fitted relations. Raises BatchRefused for unusable options."""
    if wanted.plan.lot_size and not wanted.accept:
        raise refused(COMMAND, "--lot-size needs --accept CLASS.")
    if wanted.size_column and not wanted.oecd:
        raise refused(COMMAND, "--size-column needs --oecd.")
    try:
        plans = tuple(acceptance_entries(batches, wanted.accept, wanted.plan)) if wanted.accept else ()
        relations = list(firmness_relations(batches, [reading_of(text) for text in wanted.firmness]))
    except (NoPlan, NoReading) as reason:
        raise refused(COMMAND, f"{reason}.") from None
    samples = objective_samples(batches, wanted.oecd, size_column=wanted.size_column) if wanted.oecd else ()
    firmness = tuple(entry for _, entry, _ in relations)
    fitted = {key: fit for key, _, fit in relations if fit is not None}
    return QualityEntry(plans=plans, samples=tuple(samples), firmness=firmness), fitted


def quality_lines(quality: QualityEntry) -> Iterator[str]:
    """Lines for the terminal."""
    for plan in quality.plans:
        yield f"{plan.words}. {plan.risks}."
        yield from (f"  {lot_words(lot.name)}: {lot.verdict}: {lot.words}." for lot in plan.decisions)
        yield from (f"  no decision: {lot_words(lot)}: {reason}." for lot, reason in plan.refusals)
    yield from (f"{lot_words(sample.name)}: {sample.words}." for sample in quality.samples)
    yield from (f"{plunger_words(entry)}: {entry.words}." for entry in quality.firmness)


def characteristics(quality: QualityEntry) -> pd.DataFrame:
    """Operating characteristics of all plans in one table; the column `plan` names the plan."""
    curves = [
        pd.DataFrame(plan.curve, columns=list(OC_COLUMNS[: plan.curve.shape[1]])).assign(plan=plan.words)
        for plan in quality.plans
    ]
    return pd.concat(curves, ignore_index=True)


def sampling_plan(wanted: PlanWanted, oc: Path | None) -> Iterator[str]:
    """Yields the plan in sentences; writes its curve to `oc`. Raises BatchRefused and NotWritten."""
    if oc is not None:
        require_format(oc, "--oc")
        require_new_or_ours(oc, table_of(OC_COLUMNS[:2]), "a table of drupe plan --oc")
    if not wanted.lot_size:
        raise refused("drupe plan", "needs --lot-size, the number of fruit in the lot.")
    try:
        plan = wanted.plan()
    except NoPlan as reason:
        raise refused("drupe plan", f"{reason}.") from None
    yield from (f"{words}." for words in plan_words(plan))
    if oc is not None:
        put_table(oc, operating_characteristic(plan))
        yield f"written: {oc}"
