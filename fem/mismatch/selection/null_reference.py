"""Reader of the null reference: detection statistics of sound recordings, which null_reference.csv and
null_quantiles.csv beside it hold. Their own first lines say of how many fruits, and by which commands.
"""

import csv
import math
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from jaxtyping import Float, Int

STATISTICS = ("best single", "best pair", "what is left")
STATISTICS_FILE, QUANTILES_FILE = "null_reference.csv", "null_quantiles.csv"
REMEDY = "Write both files anew with benchmarks/mismatch_nulls.py --write."


@dataclass(frozen=True, kw_only=True)
class NullReference:
    """A row of `statistics` (columns as in STATISTICS) and a number in `fruits` (whose it is) per recording;
    `quantiles`: what nine of ten stay below of each effect's gain over the compliance ratio."""

    statistics: Float[np.ndarray, "n 3"]
    fruits: Int[np.ndarray, " n"]
    quantiles: dict[str, float]


@cache
def null_reference() -> NullReference:
    """The one that is shipped, read once."""
    here = files("fem.mismatch.selection")
    statistics, quantiles = ((here / name).read_text("utf-8") for name in (STATISTICS_FILE, QUANTILES_FILE))
    return parse_null_reference(statistics, quantiles)


def parse_null_reference(statistics: str, quantiles: str) -> NullReference:
    """From the two files' text; a line that begins with # says where the numbers come from.

    Raises ValueError, with file, line and remedy, where a column, number or name is not as written, where a
    an effect stands twice, or where there are not at least two fruits with two recordings each.
    """
    rows = _rows(statistics, STATISTICS_FILE, ("fruit", *STATISTICS))
    fruits = [_whole(row[0], STATISTICS_FILE, line) for line, row in rows]
    values = [[_finite(text, STATISTICS_FILE, line) for text in row[1:]] for line, row in rows]
    recordings = np.unique(fruits, return_counts=True)[1]
    if len(recordings) < 2 or recordings.min() < 2:
        raise ValueError(
            f"{STATISTICS_FILE} has {len(recordings)} fruits, the least recorded of them "
            f"{recordings.min(initial=len(fruits))} times; at least two fruits are expected, each "
            f"recorded twice or more. {REMEDY}"
        )
    of_effect: dict[str, float] = {}
    for line, (effect, text) in _rows(quantiles, QUANTILES_FILE, ("effect", "quantile")):
        if not effect or effect in of_effect:
            raise ValueError(
                f"{QUANTILES_FILE}, line {line}: effect is {effect!r}, a name not yet used is expected. "
                f"{REMEDY}"
            )
        of_effect[effect] = _finite(text, QUANTILES_FILE, line)
    return NullReference(statistics=np.array(values), fruits=np.array(fruits), quantiles=of_effect)


def _rows(text: str, name: str, header: tuple[str, ...]) -> list[tuple[int, list[str]]]:
    """Number and cells of each line below the header."""
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if not line.startswith("#")]
    rows = [(number, row) for number, line in lines for row in csv.reader([line])]
    if not rows or tuple(rows[0][1]) != header:
        found = ",".join(rows[0][1]) if rows else "nothing"
        raise ValueError(f"{name}: the columns are {found}; {','.join(header)} is expected. {REMEDY}")
    for number, row in rows[1:]:
        if len(row) != len(header):
            raise ValueError(f"{name}, line {number}: {len(row)} cells, {len(header)} are expected. {REMEDY}")
    return rows[1:]


def _finite(text: str, name: str, line: int) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{name}, line {line}: {text!r} is no finite number. {REMEDY}")
    return value


def _whole(text: str, name: str, line: int) -> int:
    if not text.isdecimal():
        raise ValueError(f"{name}, line {line}: {text!r} is no fruit's number (0, 1, ...). {REMEDY}")
    return int(text)
