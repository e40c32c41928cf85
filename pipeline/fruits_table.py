"""`fruits.csv`: one row per fruit, read with every fault of every row named."""

import csv
import io
import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pipeline.problem import BatchRefused, Problem

MEASURES = ("height_mm", "mass_g", "shore_oo", "diameter_mm")
COLUMNS = ("fruit_id", *MEASURES, "notes")
SAFE_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,79}")


@dataclass(frozen=True, kw_only=True)
class FruitRow:
    """What staff wrote of one fruit; a measure left empty is None."""

    fruit_id: str
    height_mm: float | None = None
    mass_g: float | None = None
    shore_oo: float | None = None
    diameter_mm: float | None = None
    notes: str = ""
    unreadable: tuple[str, ...] = ()
    """Measures that were written, but are no numbers."""


def read_fruits(path: Path) -> tuple[tuple[FruitRow, ...], list[Problem]]:
    """The fruit that can be told from the table, each once, and every fault of it.

    Raises BatchRefused where it is no table, or has no ids.
    """
    table = _table(path)
    problems = [
        Problem(str(path), f'unknown column "{column}"; known columns: {", ".join(COLUMNS)}.')
        for column in table.columns
        if column not in COLUMNS
    ]
    if "fruit_id" not in table.columns:
        problems.append(Problem(str(path), 'the column "fruit_id" is missing; add it, one id per row.'))
        raise BatchRefused(problems)
    rows = [_row(path, i + 2, record, problems) for i, record in enumerate(_records(table))]
    lines: dict[str, list[int]] = {}
    for i, row in enumerate(rows):
        lines.setdefault(row.fruit_id, []).append(i + 2)
    for fruit_id, where in lines.items():
        if len(where) > 1:
            at = ", ".join(map(str, where))
            problems.append(
                Problem(
                    str(path), f'fruit_id "{fruit_id}" stands on lines {at}; every fruit needs its own id.'
                )
            )
    if not rows:
        problems.append(Problem(str(path), "holds no fruit; add one row per fruit below the header."))
    once = {row.fruit_id: row for row in reversed(rows) if SAFE_ID.fullmatch(row.fruit_id)}
    return tuple(row for row in rows if once.get(row.fruit_id) is row), problems


def _table(path: Path) -> pd.DataFrame:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise BatchRefused(
            [Problem(str(path), "is missing; it lists the fruit, one row each: fruit_id,height_mm,...")]
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise BatchRefused(
            [Problem(str(path), f"cannot be read as UTF-8 text ({error}); save it as CSV UTF-8.")]
        ) from None
    if ";" in text.partition("\n")[0]:
        raise BatchRefused([Problem(str(path), "separates cells by semicolons; save it with commas.")])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # a row with more cells than the header
            table = pd.read_csv(
                io.StringIO(text), dtype=str, keep_default_na=False, skipinitialspace=True, index_col=False
            )
    except pd.errors.EmptyDataError:
        raise BatchRefused([Problem(str(path), "is empty; the first line names the columns.")]) from None
    except (pd.errors.ParserError, pd.errors.ParserWarning):
        raise BatchRefused(
            [
                Problem(
                    str(path),
                    f"{_longer_row(text)} has more cells than the header; separate cells by a comma "
                    "and write numbers with a decimal point.",
                )
            ]
        ) from None
    table.columns = [str(c).strip() for c in table.columns]
    return table


def _longer_row(text: str) -> str:
    """The first line with more cells than the header, by its number."""
    rows = list(csv.reader(io.StringIO(text)))
    return next((f"line {i}" for i, row in enumerate(rows, 1) if len(row) > len(rows[0])), "a line")


def _records(table: pd.DataFrame) -> list[dict[str, str]]:
    return [{str(k): str(v) for k, v in record.items()} for record in table.to_dict("records")]


def _row(path: Path, line: int, record: dict[str, str], problems: list[Problem]) -> FruitRow:
    fruit_id = record["fruit_id"].strip()
    if not SAFE_ID.fullmatch(fruit_id):
        problems.append(
            Problem(
                str(path),
                f'line {line}: fruit_id "{fruit_id}" cannot name a folder; use letters, digits, '
                "dot, dash, underscore and space, at most 80, starting with a letter or digit.",
            )
        )
    measures: dict[str, float | None] = {}
    unreadable = []
    for name in MEASURES:
        text = (record.get(name) or "").strip()
        measures[name] = None
        if not text:
            continue
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value > 0):
            problems.append(
                Problem(
                    str(path), f'line {line}: {name} is "{text}"; expected a number above zero, or nothing.'
                )
            )
            unreadable.append(name)
            continue
        measures[name] = value
    notes = (record.get("notes") or "").strip()
    return FruitRow(fruit_id=fruit_id, notes=notes, unreadable=tuple(unreadable), **measures)
