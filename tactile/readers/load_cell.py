"""A bare indenter's force-displacement curve from a machine's table: time, travel and force."""

from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.files.plain_file import not_plain
from tactile.preparation.logged_trace import LoggedTrace, prepare, written_runs
from tactile.readers.cell_rows import SPREADSHEETS, CellTable, Row, cells_of, number_of, numbers_in, sheets_of
from tactile.readers.field_tables import MOVED
from tactile.readers.pictures import unusable
from tactile.readers.recording import Converted, IndenterPad, Recording
from tactile.readers.specimen import PressedSpecimen
from tactile.readers.trace_columns import FORCE, FoundColumns, TraceWords, columns_wanted, find_columns
from tactile.trace_thinning import thin

TABLES = (".csv", ".txt", ".tsv", *SPREADSHEETS)
"""Endings of a file with such a table."""
OF_MARKERS = frozenset({"pad", "marker", *MOVED})
"""Columns of a table of marker fields, which no load cell has. A .csv with one of them is read as such a
table; its reader then names the missing column. A position alone (`z_mm`) may be a machine's."""
LATEST_START_S = 1e6
"""Latest plausible start (12 days); a later one is a clock's, and times then count from the first frame."""
UNLOADED_FRAMES = 5
"""First frames; their median force is the load cell's offset. Set by hand."""
NO_MARKERS = (
    "a load cell's table has neither markers nor poses. `drupe explain` reads the recording; "
    "`drupe grade` reads it only for plates around a fruit with three diameters."
)
"""Note on every recording of a load cell."""
FEWEST_FRAMES = 2
"""Fewest rows of a recording."""
_NUMBERS = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}
"""Numbers of runs in words."""


def is_trace(path: Path, *, sensor_given: bool) -> bool:
    """Whether the file contains a load cell's table and no marker fields (a .csv can be either).

    A .csv with a column of markers in its first row contains marker fields. If the user gives a sensor's
    description, so does a .csv without a known name of a force.
    """
    if path.suffix.lower() != ".csv":
        return path.suffix.lower() in TABLES
    names = header_of(path)
    return OF_MARKERS.isdisjoint(names) and (not sensor_given or any(name in names for name in FORCE))


def header_of(path: Path) -> list[str]:
    """The names in a CSV file's first row; none if the file cannot be opened."""
    if not_plain(path):
        return []
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        return [name.strip() for name in file.readline(10_000).split(",")]


def read_trace(
    path: Path,
    *,
    fruit_id: str,
    category: str,
    indenter: Literal["ball", "flat", "plate"],
    radius_mm: float | None,
    specimen: PressedSpecimen | None = None,
    words: TraceWords | None = None,
) -> Converted:
    """The recording of a press, with travel and force positive under load; its pose is unknown.

    `words`: the user's options for columns, units, sheet and run. Long curves are thinned. Raises
    TactileFailure (unreadable-frames) for a missing column, a cell that is no number, decreasing time, or a
    travel that goes the wrong way.
    """
    words = words or TraceWords()
    sheet, columns, notes = _table(path, words)
    logged = _logged(path, sheet, columns, notes)
    prepared = _prepared(path.name, logged, words.run, notes)
    time_s, pushed = prepared.time_s, prepared.force_N
    if time_s[0] > LATEST_START_S:
        notes.append(f"{path.name}: time starts at {time_s[0]:.0f} s; drupe counts from the first frame.")
        time_s = time_s - time_s[0]
    unloaded = float(np.median(pushed[:UNLOADED_FRAMES]))
    if unloaded - pushed.min() > pushed.max() - unloaded:
        notes.append(f"{path.name}: the force is negative under load; drupe reversed its sign.")
        pushed = -pushed
    travel = _travel(path, prepared, pushed, notes)
    if (thinned := thin(time_s, travel, pushed)) is not None:
        notes.append(thinned.said(path.name))
        time_s, travel, pushed = time_s[thinned.kept], travel[thinned.kept], pushed[thinned.kept]
    pad = IndenterPad(
        name="tip",
        pose=np.broadcast_to(np.eye(4), (len(pushed), 4, 4)).copy(),
        force_z_N=pushed,
        indenter=indenter,
        radius_mm=radius_mm,
        specimen=specimen or PressedSpecimen(),
    )
    recording = Recording(
        fruit_id=fruit_id,
        category=category,
        loading="press",
        support="base",
        sensor="load cell",
        time_s=time_s,
        aperture_mm=travel,
        pads=(pad,),
    )
    return Converted(recording=recording, notes=tuple(notes))


def _table(path: Path, words: TraceWords) -> tuple[CellTable, FoundColumns, list[str]]:
    """The one sheet that has the columns, and notes on how it was read."""
    sheets = sheets_of(path)
    if words.sheet is not None:
        chosen = tuple(sheet for sheet in sheets if sheet.name == words.sheet)
        if not chosen:
            known = ", ".join(sheet.name for sheet in sheets if sheet.name) or "none: it is no spreadsheet"
            raise unusable(path.name, f'no sheet "{words.sheet}"', f"one of its sheets ({known})")
        sheets = chosen
    candidates = [(sheet, columns) for sheet in sheets if (columns := find_columns(path.name, sheet, words))]
    if not candidates:
        raise columns_wanted(path.name, sheets, words)
    if len(candidates) > 1:
        names = ", ".join(f'"{sheet.name}"' for sheet, _ in candidates)
        raise unusable(
            path.name,
            f"{len(candidates)} sheets with these columns: {names}",
            f'one of them named: give --sheet "{candidates[0][0].name}"',
        )
    sheet, columns = candidates[0]
    notes = [NO_MARKERS]
    if sheet.encoding == "cp1252":
        notes.append(f"{path.name}: is not UTF-8; drupe read it as Windows-1252.")
    if words.columns or words.units or sheet.name:
        said = ", ".join(
            f'{q} is "{columns.header[at]}" in {columns.units[q].text}' for q, at in columns.place.items()
        )
        notes.append(f"{path.name}{f', sheet {sheet.name}' if sheet.name else ''}: {said}.")
    notes += columns.notes
    return sheet, columns, notes


def runs_in(path: Path, *, words: TraceWords | None = None) -> int:
    """Number of runs below each other in the table; raises TactileFailure as `read_trace` does."""
    sheet, columns, notes = _table(path, words or TraceWords())
    return len(_runs(path.name, _logged(path, sheet, columns, notes), notes))


def _runs(source: str, logged: LoggedTrace, notes: list[str]) -> list[LoggedTrace]:
    if np.isfinite(logged.time_s).sum() < FEWEST_FRAMES:
        raise unusable(source, "no rows", "a header and one row for each frame")
    runs, corrections = written_runs(logged)
    notes += [f"{source}: {correction.says}" for correction in corrections]
    return runs


def _prepared(source: str, logged: LoggedTrace, run: int | None, notes: list[str]) -> LoggedTrace:
    """The only run, or the one of this number, with the logger's faults corrected and a note on each."""
    runs = _runs(source, logged, notes)
    if run is None and len(runs) > 1:
        first = ", ".join(str(trace.rows[0]) for trace in runs)
        fault = f"{_NUMBERS.get(len(runs), len(runs))} runs one below the other (they begin in rows {first})"
        raise unusable(
            source, fault, f"one run: give --run 1 to {len(runs)} for one, or --run all for a file of each"
        )
    if run is not None and run > len(runs):
        raise unusable(
            source, f"{len(runs)} {'run' if len(runs) == 1 else 'runs'}", f"--run 1 to {len(runs)}"
        )
    chosen = runs[(run or 1) - 1]
    if run is not None:
        notes.append(f"{source}: run {run} of {len(runs)}, rows {chosen.rows[0]} to {chosen.rows[-1]}.")
    if min(np.isfinite(column).sum() for column in (chosen.time_s, *chosen.columns.values())) < FEWEST_FRAMES:
        raise unusable(source, "no rows", "a header and one row for each frame")
    prepared, corrections = prepare(chosen)
    notes += [f"{source}: {correction.says}" for correction in corrections]
    return prepared


def _logged(path: Path, sheet: CellTable, columns: FoundColumns, notes: list[str]) -> LoggedTrace:
    """Each quantity in s, N or mm, NaN for empty cells; without rows that lack all three or repeat the
    header.

    If commas do not separate the cells, they are decimal ones. Raises TactileFailure if numbers contain both
    commas and points, since one of them then separates thousands.
    """
    rows, breaks = _rows_and_breaks(sheet, columns)
    width = len(columns.header)
    for number, cells in rows:
        if len(cells) > width:
            expected = f"{width} as in the header, and numbers with a decimal point"
            raise unusable(path.name, f"{len(cells)} cells in row {number}", expected)
    commas = sheet.delimiter != "commas" and _decimal_commas(path, rows, columns)
    if commas:
        notes.append(f"{path.name}: decimal commas.")
    values = {
        q: columns.units[q].factor
        * numbers_in(f"{path.name}: {columns.header[at][:60]}", at, rows, holes=True, commas=commas)
        for q, at in columns.place.items()
    }
    quantity = "gap" if "gap" in values else "travel"
    return LoggedTrace(
        time_s=values["time"],
        travel=values[quantity],
        force_N=values["force"],
        rows=np.array([number for number, _ in rows], dtype=int),
        quantity=quantity,
        breaks=breaks,
        source=path.name,
    )


def _rows_and_breaks(sheet: CellTable, columns: FoundColumns) -> tuple[list[Row], tuple[int, ...]]:
    """Rows of numbers, and indices of those before which the header (with its row of units) is repeated."""
    rows: list[Row] = []
    breaks: list[int] = []
    above, below = sheet.rows[max(columns.first - 2, 0) : columns.first], sheet.rows[columns.first :]
    places = columns.place.values()
    repeats = [tuple(map(str, cells)) for cells in cells_of(above, places)]
    for row, cells in zip(below, cells_of(below, places), strict=True):
        entries = tuple(map(str, cells))
        if entries in repeats and not any(number_of(cell) is not None for cell in entries):
            breaks.append(len(rows))
        elif any(entries):
            rows.append(row)
    return rows, tuple(dict.fromkeys(breaks))


def _decimal_commas(path: Path, rows: list[Row], columns: FoundColumns) -> bool:
    texts = [
        (number, cell)
        for (number, _), cells in zip(rows, cells_of(rows, columns.place.values()), strict=True)
        for cell in cells
        if isinstance(cell, str)
    ]
    comma = next(((number, cell) for number, cell in texts if "," in cell), None)
    point = next(((number, cell) for number, cell in texts if "." in cell), None)
    if comma is not None and point is not None:
        both = f'"{comma[1][:30]}" in row {comma[0]} and "{point[1][:30]}" in row {point[0]}'
        raise unusable(
            path.name, both, "either decimal commas or decimal points, and nothing between thousands"
        )
    return comma is not None


def _travel(
    path: Path, prepared: LoggedTrace, pushed: Float[np.ndarray, " t"], notes: list[str]
) -> Float[np.ndarray, " t"]:
    """The travel, or the decrease of the gap; raises TactileFailure if it reverses as the force grows."""
    quantity, travel = prepared.quantity, prepared.travel
    if quantity == "gap":
        notes.append(
            f"{path.name}: the gap is {travel[0]:.4g} mm at first; drupe uses its decrease as travel."
        )
        travel = travel[0] - travel
    deepest = int(np.argmax(pushed))
    gone = float(travel[deepest] - travel[0])
    if gone < -0.5 * float(np.ptp(travel)):
        other = "travel" if quantity == "gap" else "gap"
        grows = "opens" if quantity == "gap" else "falls"
        raise unusable(
            path.name,
            f"a {quantity} that {grows} by {-gone:.3g} mm up to the largest force",
            f"a {quantity} that {'closes' if quantity == 'gap' else 'grows'} with the force. Is it a "
            f"{other}? Give --columns {other}=...",
        )
    return travel
