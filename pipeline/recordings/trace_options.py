"""Parses the options `--columns`, `--units`, `--sheet` and `--run` for a load cell's table."""

import re

from pipeline.problem import refused
from tactile.readers.stated_unit import EXAMPLES, NoUnit, read_unit
from tactile.readers.trace_columns import KNOWN, TraceWords

_NEXT = re.compile(rf",(?=\s*(?:{'|'.join(KNOWN)})\s*=)")
"""A comma that separates two quantities; any other comma belongs to a column's name."""
ALL_RUNS = "all"
"""Value of `--run` that writes each run to its own file."""


def trace_words(
    columns: str | None, units: str | None, sheet: str | None, run: str | None = None
) -> TraceWords:
    """The parsed options. Raises BatchRefused, with the valid forms, for an invalid option.

    >>> trace_words("time=Time (s),force=Force, standard,gap=Gap", "gap=um", None).columns["force"]
    'Force, standard'
    """
    names = _pairs("--columns", columns, "time=Time,force=Force,travel=Pos")
    if {"travel", "gap"} <= names.keys():
        raise refused("--columns", "names both a travel and a gap; give only one.")
    stated = _pairs("--units", units, "time=s,force=N,travel=mm")
    for quantity, unit in stated.items():
        if isinstance(reading := read_unit(unit, quantity), NoUnit):
            ways = ", ".join(EXAMPLES[quantity])
            raise refused("--units", f"says {quantity}={unit}, which {reading.why}; give {ways} or another.")
    return TraceWords(columns=names, units=stated, sheet=sheet, run=_run(run))


def _run(text: str | None) -> int | None:
    """The number of a run, from 1; None without a text or for "all". Raises BatchRefused for other texts."""
    if text is None or text == ALL_RUNS:
        return None
    if not (text.isascii() and text.isdigit() and int(text) > 0):
        raise refused("--run", f'holds "{text[:60]}"; give the number of a run (from 1), or all.')
    return int(text)


def _pairs(option: str, text: str | None, example: str) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for part in _NEXT.split(text) if text is not None else ():
        quantity, equals, name = (piece.strip() for piece in part.partition("="))
        if not equals or not name or quantity not in KNOWN:
            known = ", ".join(KNOWN)
            raise refused(option, f'holds "{part.strip()[:60]}"; give {example} (of {known}).')
        if quantity in pairs:
            raise refused(option, f"names {quantity} twice.")
        pairs[quantity] = name
    return pairs
