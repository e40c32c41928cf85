"""Messages of a run on the terminal when it ends."""

import math
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pipeline.files.plain_file import listed
from reports.entries import BatchEntry, FruitEntry, ranked, without_references
from reports.language import decimals as with_comma
from reports.language import of_environment, spoken
from reports.messages import message
from reports.words import remarks, screen_words

MOST_LINES = 40
"""Most lines of doubts, and of warnings; the report and record.json have them all."""
MOST_IDS = 5
"""Most fruit that a line names for a shared cause."""


def decimals(sd_MPa: float) -> int:
    """Decimals of a printed modulus: three, and more if its error is below a kPa.

    >>> decimals(0.014), decimals(0.001), decimals(0.0004)
    (3, 3, 4)
    """
    return max(3, math.ceil(-math.log10(sd_MPa))) if 0 < sd_MPa < 1 else 3


def _once(lead: str, said: Sequence[tuple[str, Sequence[str]]]) -> list[str]:
    """Every sentence once, in the order of the first fruit that has it; those of most fruit come first.

    >>> _once("warning", [("A", ["no rig."]), ("B", ["no rig.", "one ramp."])])
    ['warning: all fruit: no rig.', 'warning: B: one ramp.']
    """
    ids: dict[str, list[str]] = {}
    for fruit_id, sentences in said:
        for sentence in dict.fromkeys(sentences):
            ids.setdefault(sentence, []).append(fruit_id)
    ordered = sorted(ids.items(), key=lambda ids_of_sentence: -len(ids_of_sentence[1]))
    lines = [
        f"{lead}: {'all fruit' if len(those) == len(said) > 1 else listed(those, MOST_IDS)}: {sentence}"
        for sentence, those in ordered[:MOST_LINES]
    ]
    left = len(ordered) - len(lines)
    return [*lines, f"{lead}: see report.html for {left} more"] if left else lines


def suspected(fruits: Sequence[FruitEntry]) -> list[str]:
    """A line for all fruit with the same suggestion of the screen, or with the same reason for having
    none.
    """
    by_line: dict[str, list[str]] = {}
    for fruit in fruits:
        if fruit.ok and fruit.screen is not None and (said := screen_words(fruit.screen)):
            by_line.setdefault(said, []).append(fruit.fruit_id)
    return [f"{line}: {listed(ids, MOST_IDS)}" for line, ids in by_line.items()]


def _ranking(batch: BatchEntry) -> Table:
    """A row for each graded fruit, in the language in force."""
    table = Table(box=None, pad_edge=False)
    for name in ("rank", "fruit", "E (MPa)", "±"):
        table.add_column(message(name), justify="left" if name == "fruit" else "right")
    table.add_column(message("maturity"))
    table.add_column(message("remarks"))
    for fruit in ranked(batch.fruits):
        if fruit.E_MPa is None or fruit.E_sd_MPa is None:
            continue
        sure = "" if fruit.maturity_probability is None else f" ({fruit.maturity_probability:.0%})"
        table.add_row(
            "" if fruit.rank is None else str(fruit.rank),
            escape(fruit.fruit_id),
            with_comma(f"{fruit.E_MPa:.{decimals(fruit.E_sd_MPa)}f}"),
            with_comma(f"{fruit.E_sd_MPa:.{decimals(fruit.E_sd_MPa)}f}"),
            message("withheld") if fruit.class_withheld else escape(f"{fruit.maturity or ''}{sure}"),
            escape(remarks(fruit)),
        )
    return table


def print_summary(batch: BatchEntry, out: Path, *, console: Console) -> None:
    """The ranking as a table, failures with their reasons, doubts and warnings, where the files are.

    The table is in the locale's language; pipeline.cli translates the lines.
    """
    with spoken(of_environment()):
        table = _ranking(batch)
    if table.row_count:
        console.print(table)
    graded = [fruit.ok for fruit in without_references(batch.fruits)]
    lines = [
        *(
            f"not graded: {fruit.fruit_id}: {fruit.outcome}: {fruit.reason}"
            for fruit in batch.fruits
            if not fruit.ok
        ),
        *_once("E in doubt", [(each.fruit_id, each.doubts) for each in batch.fruits if each.ok]),
        *(f"inspect: {each.fruit_id}: {each.decision_reason}" for each in batch.fruits if each.suspicion),
        *_once("warning", [(each.fruit_id, each.warnings) for each in batch.fruits if each.ok]),
        f"{sum(graded)} of {len(graded)} fruit graded",
    ]
    if batch.unfinished is not None:
        lines.append(f"interrupted: {batch.unfinished.done} of {batch.unfinished.total} fruit done")
    if batch.reference is not None:
        lead = "warning: " if batch.reference.alarm else ""
        lines += [f"{lead}{sentence}" for sentence in batch.reference.sentences]
    if batch.ships == ():
        lines.append("warning: no class is shipped, so all fruit are held; set ship in [[grading.classes]]")
    lines += [f"fault of the whole batch: {fault}" for fault in batch.faults]
    lines += [*suspected(batch.fruits), f"  {out / 'ranking.csv'}", f"  {out / 'report.html'}"]
    for line in lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
