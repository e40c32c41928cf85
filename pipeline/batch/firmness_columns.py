"""Readings of `drupe firmness` (firmness.csv in the results) as further columns of a fruit."""

import csv
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from pipeline.batch.layout import Results
from pipeline.batch.records import FruitRecord
from pipeline.files.manifest import why_damaged
from pipeline.files.plain_file import text_or_empty

MOST_BYTES = 20_000_000
"""Most bytes of a table that drupe reads: a hundred thousand fruit."""
SAME_E = 1e-3
"""A reading applies to the present E if both E differ by less than this share (four figures are stored)."""


@dataclass(frozen=True, kw_only=True)
class FirmnessReadings:
    """`columns`: each test's reading and its standard deviation; `rows`: numbers by fruit and column."""

    columns: tuple[str, ...] = ()
    rows: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def of(self, record: FruitRecord) -> dict[str, float]:
        """The fruit's readings by column; empty if they were computed from another E than the present one."""
        row, (E_MPa, _) = self.rows.get(record.fruit_id, {}), record.ranked_modulus
        if E_MPa is None or not math.isclose(row.get("E_MPa", math.nan), E_MPa, rel_tol=SAME_E):
            return {}
        return {name: row[name] for name in self.columns if name in row}


def firmness_readings(results: Results) -> FirmnessReadings:
    """The readings in the results; empty if `drupe firmness` did not run or somebody changed its table."""
    if not results.firmness.is_file() or why_damaged(results.firmness):
        return FirmnessReadings()
    table = csv.DictReader(text_or_empty(results.firmness, most_bytes=MOST_BYTES).splitlines())
    header = table.fieldnames or ()
    tests = [name for name in header if f"{name}_sd" in header]
    columns = tuple(column for test in tests for column in (test, f"{test}_sd"))
    rows = {row["fruit_id"]: _numbers(row, ("E_MPa", *columns)) for row in table}
    return FirmnessReadings(columns=columns, rows=rows)


def _numbers(row: Mapping[str, str], columns: tuple[str, ...]) -> dict[str, float]:
    numbers = {}
    for name in columns:
        with suppress(ValueError, TypeError):
            numbers[name] = float(row[name])
    return numbers
