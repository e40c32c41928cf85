"""Numbers in tables, written plainly: ASCII digits with a decimal point, no more."""

import math
import re
import unicodedata

LARGEST = 1e12
"""A number beyond is of no machine (times since 1970 are 1.8e9 s); squares of larger ones overflow."""
_PLAIN = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?", re.ASCII)
_POINTS = str.maketrans({",": ".", "\u066b": "."})
"""The decimal comma, and the Arabic one."""


def decimal_number(cell: str) -> float | None:
    """The number in a cell, such as 60.5, -3 or 1e-3; None where it is not written so, or not finite.

    Python's own `float` takes more: digits of every script, "6_0", "nan", "infinity".

    >>> decimal_number(" 60.5 "), decimal_number("6_0"), decimal_number("60,5"), decimal_number("1e999")
    (60.5, None, None, None)
    """
    text = cell.strip()
    value = float(text) if _PLAIN.fullmatch(text) else math.nan
    return value if math.isfinite(value) else None


def meant(cell: str) -> str:
    """How a number that is written otherwise is to be written, as the end of a sentence; empty where the cell
    is no number at all, or one that is written plainly.

    >>> meant("60,5"), meant("6_0"), meant("tall"), meant("1e300")
    ('; it has a decimal comma; write 60.5', '; write 60', '', '')
    """
    if decimal_number(cell) is not None:
        return ""
    text = "".join(_ascii_digit(c) for c in cell.strip() if not c.isspace() and c not in "_'\u2019")
    if text.count(",") + text.count("\u066b") == 1 and "." not in text:
        pointed = text.translate(_POINTS)
        return f"; it has a decimal comma; write {pointed}" if decimal_number(pointed) is not None else ""
    return f"; write {text}" if decimal_number(text) is not None else ""


def _ascii_digit(character: str) -> str:
    value = unicodedata.decimal(character, None)
    return character if value is None else str(value)
