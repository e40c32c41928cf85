"""What a run says on the terminal when it ends."""

import math
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from reports.entries import BatchEntry, FruitEntry, ranked, without_references
from reports.words import remarks, screen_words

MOST_CHARACTERS = 160
"""Of a cause on the terminal; the whole sentence stands in the report."""
MOST_IDS = 5
"""That a line names of the fruit that share a cause."""


def decimals(sd_MPa: float) -> int:
    """How many a modulus is printed with: three, and more for what is known to less than a kPa.

    >>> decimals(0.014), decimals(0.001), decimals(0.0004)
    (3, 3, 4)
    """
    return max(3, math.ceil(-math.log10(sd_MPa))) if 0 < sd_MPa < 1 else 3


def cause(doubts: Sequence[str]) -> str:
    """The first of a fruit's doubts or warnings, not too long for a line, and how many more there are.

    >>> cause(["grasp-1: forces look like grams.", "pit.ply is turned."])
    'grasp-1: forces look like grams (and 1 more)'
    """
    said = doubts[0].rstrip(".")
    if len(said) > MOST_CHARACTERS:
        said = f"{said[:MOST_CHARACTERS].rsplit(' ', 1)[0].rstrip(',;:')} ..."
    return said if len(doubts) == 1 else f"{said} (and {len(doubts) - 1} more)"


def doubted(fruits: Sequence[FruitEntry]) -> list[str]:
    """A line for each fruit whose E is in doubt, or for all that share their doubts: ids and cause."""
    by_doubts: dict[tuple[str, ...], list[str]] = {}
    for fruit in fruits:
        if fruit.ok and fruit.doubts:
            by_doubts.setdefault(fruit.doubts, []).append(fruit.fruit_id)
    return [f"E in doubt: {_ids(ids)}: {cause(doubts)}" for doubts, ids in by_doubts.items()]


def warned(fruits: Sequence[FruitEntry]) -> list[str]:
    """A line for each graded fruit with warnings, or for all that share theirs: ids and the first warning."""
    by_warnings: dict[tuple[str, ...], list[str]] = {}
    for fruit in fruits:
        if fruit.ok and fruit.warnings:
            by_warnings.setdefault(tuple(fruit.warnings), []).append(fruit.fruit_id)
    return [f"warning: {_ids(ids)}: {cause(warnings)}" for warnings, ids in by_warnings.items()]


def suspected(fruits: Sequence[FruitEntry]) -> list[str]:
    """A line for all fruit of which the screen suggests the same, or that could not be screened for one
    reason.
    """
    by_line: dict[str, list[str]] = {}
    for fruit in fruits:
        if fruit.ok and fruit.screen is not None and (said := screen_words(fruit.screen)):
            by_line.setdefault(said, []).append(fruit.fruit_id)
    return [f"{line}: {_ids(ids)}" for line, ids in by_line.items()]


def to_inspect(fruits: Sequence[FruitEntry]) -> list[str]:
    """A line for each fruit that is to be inspected although its E is not in doubt: the suspected effect, p,
    and E without and with it.
    """
    return [
        f"inspect: {fruit.fruit_id}: {fruit.decision_reason}"
        for fruit in fruits
        if fruit.suspicion is not None
    ]


def _ids(ids: Sequence[str]) -> str:
    more = f" and {len(ids) - MOST_IDS} more" if len(ids) > MOST_IDS else ""
    return f"{', '.join(ids[:MOST_IDS])}{more}"


def print_summary(batch: BatchEntry, out: Path, *, console: Console) -> None:
    """The ranking as a table, failures with their reasons, doubts and warnings, where the files are."""
    table = Table(box=None, pad_edge=False)
    for name in ("rank", "fruit", "E (MPa)", "±"):
        table.add_column(name, justify="left" if name == "fruit" else "right")
    table.add_column("maturity")
    table.add_column("remarks")
    for fruit in ranked(batch.fruits):
        if fruit.E_MPa is None or fruit.E_sd_MPa is None:
            continue
        sure = "" if fruit.maturity_probability is None else f" ({fruit.maturity_probability:.0%})"
        table.add_row(
            "" if fruit.rank is None else str(fruit.rank),
            escape(fruit.fruit_id),
            f"{fruit.E_MPa:.{decimals(fruit.E_sd_MPa)}f}",
            f"{fruit.E_sd_MPa:.{decimals(fruit.E_sd_MPa)}f}",
            "withheld" if fruit.class_withheld else escape(f"{fruit.maturity or ''}{sure}"),
            escape(remarks(fruit)),
        )
    if table.row_count:
        console.print(table)
    for fruit in batch.fruits:
        if not fruit.ok:
            console.print(
                f"not graded: {fruit.fruit_id}: {fruit.outcome}: {fruit.reason}",
                highlight=False,
                markup=False,
                soft_wrap=True,
            )
    for line in (*doubted(batch.fruits), *to_inspect(batch.fruits), *warned(batch.fruits)):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    fruits = without_references(batch.fruits)
    graded = sum(fruit.ok for fruit in fruits)
    console.print(f"{graded} of {len(fruits)} fruit graded", highlight=False)
    if batch.unfinished is not None:
        console.print(
            f"interrupted: {batch.unfinished.done} of {batch.unfinished.total} fruit done", highlight=False
        )
    for sentence in () if batch.reference is None else batch.reference.sentences:
        lead = "warning: " if batch.reference is not None and batch.reference.alarm else ""
        console.print(f"{lead}{sentence}", highlight=False, markup=False, soft_wrap=True)
    if batch.ships == ():
        said = "warning: no class is shipped: all fruit are held; see ship in [[grading.classes]]"
        console.print(said, highlight=False, markup=False, soft_wrap=True)
    for line in (*(f"fault of the whole batch: {one}" for one in batch.faults), *suspected(batch.fruits)):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    for name in ("ranking.csv", "report.html"):
        console.print(f"  {out / name}", highlight=False, markup=False, soft_wrap=True)
