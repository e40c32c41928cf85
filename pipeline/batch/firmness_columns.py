"""Columns of `drupe firmness` (firmness.csv in the results), and of `drupe history --firmness`."""

import csv
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from fem.firmness.trade_tests import trade_test_of
from pipeline.batch.layout import Results
from pipeline.batch.records import FruitRecord
from pipeline.files.manifest import why_damaged
from pipeline.files.plain_file import text_or_empty

MOST_BYTES = 20_000_000
"""Most bytes of a table that drupe reads: a hundred thousand fruit."""
SAME_E = 1e-3
"""A reading applies to the present E if both E differ by less than this share (four figures are stored)."""

PLUNGERS_MM = {"8mm": 8.0, "5/16in": 8.0, "11mm": 11.1, "11.1mm": 11.1, "7/16in": 11.1}
"""Plunger diameters by their spellings."""
ERROR = "_sd"
"""Suffix of the column with a reading's standard deviation."""


def predicted_columns(plunger_mm: float) -> tuple[str, ...]:
    """Columns of `drupe history` for a penetrometer's predicted reading and both ends of its interval.

    >>> predicted_columns(11.1)[0]
    'firmness_11.1mm_N_predicted'
    """
    return tuple(f"firmness_{plunger_mm:g}mm_N_{part}" for part in ("predicted", "low", "high"))


def is_firmness_column(name: str) -> bool:
    """Whether drupe gives a column of firmness this name; capitals count as small letters."""
    predicted = {column.lower() for size in PLUNGERS_MM.values() for column in predicted_columns(size)}
    return name.lower() in predicted or trade_test_of(name.lower().removesuffix(ERROR)) is not None


@dataclass(frozen=True, kw_only=True)
class FirmnessReadings:
    """`columns`: each test's reading and its standard deviation; `rows`: numbers by fruit and column."""

    columns: tuple[str, ...] = ()
    rows: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def titles(self) -> dict[str, tuple[str, str]]:
        """Title and unit of each test by its column.

        >>> FirmnessReadings(columns=("plates_2pct_N", "plates_2pct_N_sd")).titles
        {'plates_2pct_N': ('Plates, 2 % of the diameter', 'N')}
        """
        tests = {name: trade_test_of(name) for name in self.columns}
        return {name: (test.title, test.unit) for name, test in tests.items() if test is not None}

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
    tests = [name for name in header if f"{name}{ERROR}" in header]
    columns = tuple(column for test in tests for column in (test, f"{test}{ERROR}"))
    rows = {row["fruit_id"]: _numbers(row, ("E_MPa", *columns)) for row in table}
    return FirmnessReadings(columns=columns, rows=rows)


def _numbers(row: Mapping[str, str], columns: tuple[str, ...]) -> dict[str, float]:
    numbers = {}
    for name in columns:
        with suppress(ValueError, TypeError):
            numbers[name] = float(row[name])
    return numbers
