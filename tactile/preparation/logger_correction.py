"""One fault of a logger in a record, and its correction, as a sentence with rows and values."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float, Int

from pipeline.files.plain_file import listed

SHOWN = 3
"""Rows that a sentence lists by number."""


class LoggerFault(StrEnum):
    """What the logger did."""

    RESERVED = "reserved"
    JOINED = "joined"
    WILD = "wild"
    REPEATED = "repeated"
    MISSING = "missing"
    RESET = "reset"


@dataclass(frozen=True, kw_only=True)
class LoggerCorrection:
    """`rows`: numbers in the file; `values`: the recorded ones (of a reset, its step); `says`: one
    sentence."""

    fault: LoggerFault
    quantity: str
    rows: tuple[int, ...]
    values: tuple[float, ...]
    says: str


def correction(
    fault: LoggerFault, quantity: str, rows: Int[np.ndarray, " k"], values: Float[np.ndarray, " v"], says: str
) -> LoggerCorrection:
    """The correction of these rows' fault, with a value for each row, or for each quantity that is constant
    there."""
    return LoggerCorrection(
        fault=fault, quantity=quantity, rows=tuple(rows.tolist()), values=tuple(values.tolist()), says=says
    )


UNITS = {"time": "s", "travel": "mm", "gap": "mm", "force": "N"}


def counted(rows: int) -> str:
    """The number of rows with its noun.

    >>> counted(1), counted(3)
    ('1 row', '3 rows')
    """
    return f"{rows} row{'' if rows == 1 else 's'}"


def measured(quantity: str, value: float) -> str:
    """A value with its unit.

    >>> measured("force", -196.13), measured("force", float("nan"))
    ('-196.13 N', 'nothing')
    """
    return "nothing" if np.isnan(value) else f"{value:.6g} {UNITS[quantity]}"


def rows_listed(
    quantity: str, rows: Sequence[int] | Int[np.ndarray, " k"], values: Float[np.ndarray, " k"]
) -> str:
    """The first rows with their values, and how many more there are.

    >>> rows_listed("force", [42, 302], np.array([-196.13, 98.07]))
    'row 42 (-196.13 N), row 302 (98.07 N)'
    """
    pairs = zip(rows, values, strict=True)
    return listed([f"row {row} ({measured(quantity, value)})" for row, value in pairs], SHOWN)


def spoilt_said(corrections: Sequence[LoggerCorrection]) -> str:
    """Wild and missing values with their rows, as part of a sentence.

    >>> wild = LoggerFault.WILD
    >>> spike = LoggerCorrection(fault=wild, quantity="force", rows=(42,), values=(-196.13,), says="")
    >>> spoilt_said([spike])
    'wild force: row 42 (-196.13 N)'
    """
    spoilt = [repair for repair in corrections if repair.fault in (LoggerFault.WILD, LoggerFault.MISSING)]
    return "; ".join(
        f"{repair.fault} {repair.quantity or 'cells'}: "
        + rows_listed(repair.quantity, repair.rows, np.array(repair.values))
        for repair in spoilt
    )
