"""Reads log.csv of a raw grasp: the machine's values over time.

Columns: `time_s`, `aperture_mm`; optionally `frame` (the number of the picture at that time) and the load
cell's `fx_N`, `fy_N`, `fz_N`, `tx_Nmm`, `ty_Nmm`, `tz_Nmm` (all six, fruit frame).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from pipeline.files.plain_file import NotReadable, read_text
from tactile.readers.cell_rows import csv_lines, number_in, refuse_repeated_names
from tactile.readers.pictures import absence, unusable

MOST_BYTES, MOST_ROWS, MOST_COLUMNS = 200_000_000, 2_000_000, 100
"""Limits of a table of numbers: 500 frames of 400 markers are 200,000 rows of 13 columns, 25 MB."""
FARTHEST_MM = 2000.0
"""Largest aperture: no gripper opens wider."""
NEEDED = ("time_s", "aperture_mm")
_OTHERS = ((";", "semicolons"), ("\t", "tabs"))
LOAD_CELL = ("fx_N", "fy_N", "fz_N", "tx_Nmm", "ty_Nmm", "tz_Nmm")


@dataclass(frozen=True, kw_only=True)
class GraspLog:
    """The log's rows; `frame` and `wrench_N` are None if it lacks those columns."""

    time_s: Float[np.ndarray, " t"]
    aperture_mm: Float[np.ndarray, " t"]
    frame: Int[np.ndarray, " t"] | None
    wrench_N: Float[np.ndarray, "t 6"] | None


def read_columns(
    path: Path, *, wanted: Sequence[str], source: str | None = None
) -> dict[str, Float[np.ndarray, " t"]]:
    """Every column of a CSV file of numbers; raises TactileFailure (unreadable-frames) by row and column.

    `wanted`: columns that the file must have; `source`: the file's name in failures, if not its own.
    """
    source = source or path.name
    if missing := absence(path):
        raise unusable(source, missing, "a table with the columns " + ", ".join(wanted))
    try:
        text = read_text(path, most_bytes=MOST_BYTES)
    except NotReadable as cause:
        raise unusable(source, f"that it {cause}", "a CSV file in UTF-8") from cause
    expected = "numbers separated by commas, without quotation marks"
    lines = csv_lines(source, text, ",", expected=expected)
    rows = [row for _, row in lines if any(cell.strip() for cell in row)]
    if len(rows) < 2:
        raise unusable(source, "no rows", "a header and one row for each frame")
    header = [name.strip() for name in rows[0]]
    if len(rows) > MOST_ROWS or len(header) > MOST_COLUMNS:
        fault = f"{len(rows)} rows of {len(header)} columns"
        raise unusable(source, fault, f"at most {MOST_ROWS} rows of {MOST_COLUMNS} columns")
    if len(header) == 1 and (other := next((name for c, name in _OTHERS if c in header[0]), "")):
        raise unusable(source, f"cells separated by {other}", "commas; save it as CSV with commas")
    refuse_repeated_names(source, header)
    for name in wanted:
        if name not in header:
            like = next((other for other in header if other.lower() == name.lower()), None)
            expected = f"a column {name} too" if like is None else f"{name} in place of {like}"
            raise unusable(f"{source}: {name}", "the columns " + ", ".join(header), expected)
    values = np.empty((len(rows) - 1, len(header)))
    for k, row in enumerate(rows[1:]):
        if len(row) != len(header):
            expected = f"{len(header)} as in the header, and numbers with a decimal point"
            raise unusable(source, f"{len(row)} cells in row {k + 2}", expected)
        for j, cell in enumerate(row):
            values[k, j] = number_in(f"{source}: {header[j][:60]}", k + 2, cell)
    return {name: values[:, j] for j, name in enumerate(header)}


def read_log(path: Path) -> GraspLog:
    """The log; raises TactileFailure (unreadable-frames), for example if its times do not increase."""
    columns = read_columns(path, wanted=NEEDED)
    cell = [name for name in LOAD_CELL if name in columns]
    if cell and len(cell) < len(LOAD_CELL):
        raise unusable(path.name, f"only {', '.join(cell)} of the load cell", ", ".join(LOAD_CELL))
    increasing(path.name, columns["time_s"])
    if (farthest := float(np.abs(columns["aperture_mm"]).max())) > FARTHEST_MM:
        expected = f"at most {FARTHEST_MM:g} mm (is it in µm?)"
        raise unusable(f"{path.name}: aperture_mm", f"{farthest:g}", expected)
    frame = columns.get("frame")
    if frame is not None and not (np.diff(frame) > 0).all():
        row = int(np.argmin(np.diff(frame) > 0)) + 3
        raise unusable(f"{path.name}: frame", f"{frame[row - 2]:g} in row {row}", "increasing numbers")
    return GraspLog(
        time_s=columns["time_s"],
        aperture_mm=columns["aperture_mm"],
        frame=None if frame is None else frame.astype(np.int64),
        wrench_N=np.stack([columns[name] for name in cell], axis=1) if cell else None,
    )


def increasing(source: str, time_s: Float[np.ndarray, " t"]) -> None:
    """Raises TactileFailure (unreadable-frames), with the row, if times repeat or decrease."""
    back = np.flatnonzero(np.diff(time_s) <= 0)
    if len(back):
        k = int(back[0])
        fault = f"{time_s[k + 1]:g} s in row {k + 3} after {time_s[k]:g} s"
        raise unusable(f"{source}: time_s", fault, "increasing times; leave out the repeated rows")
