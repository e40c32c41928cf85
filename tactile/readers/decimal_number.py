"""Parses plain numbers in tables: ASCII digits with a decimal point."""

import math
import re
import unicodedata

LARGEST = 1e12
"""No machine writes a larger number (times since 1970 are 1.8e9 s); squares of far larger ones overflow."""
_PLAIN = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,4})?", re.ASCII)
_POINTS = str.maketrans({",": ".", "\u066b": "."})
"""The decimal comma, and the Arabic one."""


def decimal_number(cell: str) -> float | None:
    """The number in a cell, such as 60.5, -3 or 1e-3; None if it has another form or is not finite.

    Python's `float` also accepts digits of every script, "6_0", "nan" and "infinity".

    >>> decimal_number(" 60.5 "), decimal_number("6_0"), decimal_number("60,5"), decimal_number("1e999")
    (60.5, None, None, None)
    """
    text = cell.strip()
    value = float(text) if _PLAIN.fullmatch(text) else math.nan
    return value if math.isfinite(value) else None


def meant(cell: str) -> str:
    """Advice on the plain form of a number, as the end of a sentence; empty for plain numbers and other text.

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
