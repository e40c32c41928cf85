"""What a run says on the terminal when it ends."""

import math
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from reports.entries import BatchEntry, ranked, without_references
from reports.words import remarks


def decimals(sd_MPa: float) -> int:
    """How many a modulus is printed with: three, and more for what is known to less than a kPa.

    >>> decimals(0.014), decimals(0.001), decimals(0.0004)
    (3, 3, 4)
    """
    return max(3, math.ceil(-math.log10(sd_MPa))) if 0 < sd_MPa < 1 else 3


def print_summary(batch: BatchEntry, out: Path, *, console: Console) -> None:
    """The ranking as a table, failures with their reasons, and where the files are."""
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
    fruits = without_references(batch.fruits)
    graded = sum(fruit.ok for fruit in fruits)
    console.print(f"{graded} of {len(fruits)} fruit graded", highlight=False)
    for sentence in () if batch.reference is None else batch.reference.sentences:
        lead = "warning: " if batch.reference is not None and batch.reference.alarm else ""
        console.print(f"{lead}{sentence}", highlight=False, markup=False, soft_wrap=True)
    for name in ("ranking.csv", "report.html"):
        console.print(f"  {out / name}", highlight=False, markup=False, soft_wrap=True)
