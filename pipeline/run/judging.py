"""`drupe judge`: a person's verdict on a graded fruit, stored beside its E."""

import re
from datetime import datetime
from pathlib import Path
from typing import Any

from pipeline.batch.fruits_table import SAFE_ID
from pipeline.batch.layout import Results
from pipeline.batch.provenance import require_provenance
from pipeline.batch.records import FruitRecord, read_record
from pipeline.batch.verdicts import Verdict, add_verdict
from pipeline.files.plain_file import composed, printable, read_head
from pipeline.problem import known_names, refused
from reports.language import LANGUAGES


def judge_fruit(
    results: Results,
    fruit_id: str,
    *,
    judged_class: str,
    by: str,
    why: str,
    now: datetime,
    device: str = "",
) -> Verdict:
    """Adds the verdict to the results' verdicts. Names are the same if their composed letters are.

    Raises BatchRefused if the fruit has no result there, or the batch has other classes; and NotWritten.
    """
    judged_class = composed(judged_class)
    record, classes = judged_record(results, composed(fruit_id))
    if classes and judged_class not in classes:
        hint = known_names(judged_class, classes, "class", "classes")
        raise refused("--class", f'found "{judged_class[:80]}"; {hint}')
    return add_verdict(
        results.verdicts, record, judged_class=judged_class, by=by, why=why, now=now, device=device
    )


def judged_record(results: Results, fruit_id: str) -> tuple[FruitRecord, tuple[str, ...]]:
    """The fruit's record and the classes of its batch. Raises BatchRefused if it has no record."""
    said = require_provenance(results)
    record = read_record(results.fruit(fruit_id).record) if SAFE_ID.fullmatch(fruit_id) else None
    if record is None:
        known = sorted(str(name) for name in said.get("outcomes") or ())
        hint = known_names(fruit_id, known, "fruit", "fruit")
        raise refused("FRUIT", f'found "{printable(fruit_id[:80])}"; {hint}')
    return record, _classes(said)


def _classes(said: dict[str, Any]) -> tuple[str, ...]:
    grading = (said.get("settings") or {}).get("grading") or {}
    return tuple(str(grade["name"]) for grade in grading.get("classes") or ())


def language_of(report: Path, otherwise: str) -> str:
    """The language of a report that drupe wrote, so that a new one keeps it; else `otherwise`."""
    head = read_head(report, 200) if report.is_file() and not report.is_symlink() else b""
    html_tag = re.search(rb'<html lang="(\w+)">', head)
    language = html_tag[1].decode() if html_tag else otherwise
    return language if language in LANGUAGES else otherwise
