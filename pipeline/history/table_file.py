"""Writes tables as .csv, .xlsx, .parquet or .json."""

import importlib.util
import io
import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import pandas as pd

from pipeline.files.plain_file import not_plain
from pipeline.files.whole_file import put
from pipeline.problem import refused
from reports.tables import safe_cell

NEEDS = {".xlsx": ("openpyxl", "sheets"), ".parquet": ("pyarrow", "parquet")}
"""Package of each suffix, and the extra of drupe that installs it."""
ENDINGS = (".csv", ".xlsx", ".parquet", ".json")


def require_format(path: Path, option: str) -> None:
    """Raises BatchRefused if the suffix is not in ENDINGS, or its package is not installed."""
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise refused(path, f'{option}: found the ending "{ending}", expected one of {", ".join(ENDINGS)}.')
    package, extra = NEEDS.get(ending, ("", ""))
    if package and importlib.util.find_spec(package) is None:
        sentence = f"needs the package {package}; install it with: pip install 'drupe[{extra}]'."
        raise refused(f"{option} {path.name}", sentence)


def table_bytes(table: pd.DataFrame, ending: str) -> bytes:
    """The file's content. CSV and Excel get text that is no formula, Parquet and JSON unchanged text."""
    if ending == ".json":
        records = table.where(table.notna(), None).to_dict("records")
        return (json.dumps(records, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    whole = io.BytesIO()
    if ending == ".parquet":
        table.convert_dtypes().to_parquet(whole, index=False)
        return whole.getvalue()
    rows = [[safe_cell(cell) if isinstance(cell, str) else cell for cell in row] for row in table.to_numpy()]
    safe = pd.DataFrame(rows, columns=table.columns, dtype=object)
    if ending == ".csv":
        return safe.to_csv(index=False, lineterminator="\n", na_rep="").encode()
    safe.to_excel(whole, index=False, engine="openpyxl", sheet_name="drupe history", freeze_panes=(1, 0))
    return whole.getvalue()


def put_table(path: Path, table: pd.DataFrame) -> None:
    """Writes the table in the format of the path's suffix. Raises NotWritten."""
    put(path, table_bytes(table, path.suffix.lower()))


def table_of(columns: Sequence[str]) -> Callable[[Path], bool]:
    """A function that tells whether the table at a path begins with these columns."""
    return partial(_starts_with, columns=columns)


def _starts_with(path: Path, columns: Sequence[str]) -> bool:
    readers = {
        ".csv": lambda: pd.read_csv(path, nrows=0),
        ".xlsx": lambda: pd.read_excel(path, nrows=0, engine="openpyxl"),
        ".parquet": lambda: pd.read_parquet(path),
        ".json": lambda: pd.DataFrame(json.loads(path.read_text(encoding="utf-8"))),
    }
    if not_plain(path):
        return False
    try:
        table = readers[path.suffix.lower()]()
    except (OSError, ValueError, KeyError, TypeError, ImportError, RecursionError):
        return False
    return list(table.columns[: len(columns)]) == list(columns)
