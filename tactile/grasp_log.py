"""log.csv of a raw grasp: what the machine said at each time.

Columns: `time_s`, `aperture_mm`; optionally `frame` (the number of the picture taken then) and the load
cell's `fx_N`, `fy_N`, `fz_N`, `tx_Nmm`, `ty_Nmm`, `tz_Nmm` (all six, fruit frame).
"""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from tactile.pictures import unusable

NEEDED = ("time_s", "aperture_mm")
LOAD_CELL = ("fx_N", "fy_N", "fz_N", "tx_Nmm", "ty_Nmm", "tz_Nmm")


@dataclass(frozen=True, kw_only=True)
class GraspLog:
    """The log's rows; `frame` and `wrench_N` are None where it has no such columns."""

    time_s: Float[np.ndarray, " t"]
    aperture_mm: Float[np.ndarray, " t"]
    frame: Int[np.ndarray, " t"] | None
    wrench_N: Float[np.ndarray, "t 6"] | None


def read_columns(path: Path) -> dict[str, Float[np.ndarray, " t"]]:
    """Every column of a CSV file of numbers; raises TactileFailure (unreadable-frames) by row and column."""
    if not path.is_file():
        raise unusable(path.name, "no such file", "a table with the columns " + ", ".join(NEEDED))
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except UnicodeDecodeError as cause:
        raise unusable(path.name, "bytes that are no text", "a CSV file in UTF-8") from cause
    if len(rows) < 2:
        raise unusable(path.name, "no rows", "a header and one row for each frame")
    header = [name.strip() for name in rows[0]]
    values = np.empty((len(rows) - 1, len(header)))
    for k, row in enumerate(rows[1:]):
        if len(row) != len(header):
            raise unusable(path.name, f"{len(row)} cells in row {k + 2}", f"{len(header)} as in the header")
        for j, cell in enumerate(row):
            values[k, j] = _number(path, header[j], k + 2, cell)
    return {name: values[:, j] for j, name in enumerate(header)}


def read_log(path: Path) -> GraspLog:
    """The log, its times strictly increasing; raises TactileFailure (unreadable-frames)."""
    columns = read_columns(path)
    for name in NEEDED:
        if name not in columns:
            found = "the columns " + ", ".join(columns)
            raise unusable(f"{path.name}: {name}", found, f"a column {name} as well")
    increasing(path.name, columns["time_s"])
    cell = [name for name in LOAD_CELL if name in columns]
    if cell and len(cell) < len(LOAD_CELL):
        raise unusable(path.name, f"only {', '.join(cell)} of the load cell", ", ".join(LOAD_CELL))
    frame = columns.get("frame")
    if frame is not None and (np.diff(frame) <= 0).any():
        row = int(np.argmax(np.diff(frame) <= 0)) + 3
        raise unusable(f"{path.name}: frame", f"{frame[row - 2]:g} in row {row}", "increasing numbers")
    return GraspLog(
        time_s=columns["time_s"],
        aperture_mm=columns["aperture_mm"],
        frame=None if frame is None else frame.astype(np.int64),
        wrench_N=np.stack([columns[name] for name in cell], axis=1) if cell else None,
    )


def increasing(source: str, time_s: Float[np.ndarray, " t"]) -> None:
    """Refuses times that stand still or run back, by row."""
    back = np.flatnonzero(np.diff(time_s) <= 0)
    if len(back):
        k = int(back[0])
        found = f"{time_s[k + 1]:g} s in row {k + 3} after {time_s[k]:g} s"
        raise unusable(
            f"{source}: time_s", found, "increasing times; sort the rows or drop the repeated ones"
        )


def _number(path: Path, column: str, row: int, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        found = repr(cell.strip()) if cell.strip() else "nothing"
        raise unusable(f"{path.name}: {column}", f"{found} in row {row}", "a number")
    return value
