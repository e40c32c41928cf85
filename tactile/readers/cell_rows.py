"""Rows of cells from delimited text and spreadsheets, in which machines write their tables."""

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from pipeline.files.plain_file import NotReadable, read_bytes
from tactile.readers.decimal_number import LARGEST, decimal_number, meant
from tactile.readers.limited_process import tried
from tactile.readers.pictures import absence, unusable

MOST_BYTES = 200_000_000
"""Largest file: an hour at 1 kHz is 150 MB of text."""
PATIENCE_S, MOST_MEMORY = 60.0, 800_000_000
"""Seconds and bytes for the cells of a spreadsheet, with empty ones between: a million take 4 s and 90 MB."""
LOOKED_AT = 400
"""Rows in which the columns' names are sought: machines write ten to a hundred lines above."""
DELIMITERS = {"\t": "tabs", ";": "semicolons", ",": "commas"}
"""Delimiters by priority: a comma may be a decimal one."""
SEPARATOR_LINE = re.compile(r'"?sep=([^\r\n"])"?[ ,;\t]*(?=[\r\n])', re.IGNORECASE)
"""First line of a table from Excel that states the delimiter."""
EMPTY = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---"})
"""Cells without a reading, in lower case."""
SPACES = "spaces"
"""Delimiter of one space or more, if the text has none of the others."""
SPREADSHEETS = (".xls", ".xlsx")
SPREADSHEETS_BEGIN = (b"\xd0\xcf\x11\xe0", b"PK\x03\x04")
"""First bytes of an OLE file (.xls) and a zip (.xlsx). Some machines name text files .xls."""
_CALAMINE = "python-calamine, which is not installed: pip install 'drupe[sheets]', or save the sheet as .csv"

Cell: TypeAlias = str | float
"""A spreadsheet's number, or the text of a cell, stripped."""
Row: TypeAlias = tuple[int, list[Cell]]
"""The number of the row in the file, from 1, and its cells without empty ones at its end."""


@dataclass(frozen=True, kw_only=True)
class CellTable:
    """One table's rows. `delimiter`: in words, empty for a spreadsheet; `encoding`: that of a text file."""

    name: str
    rows: tuple[Row, ...]
    delimiter: str = ""
    encoding: str = ""


def sheets_of(path: Path) -> tuple[CellTable, ...]:
    """Every sheet of a spreadsheet, or the one table of a text file, without blank rows.

    Raises TactileFailure (unreadable-frames) with the fault of the file.
    """
    if missing := absence(path):
        raise unusable(path.name, missing, "a table with the columns time_s, travel_mm, force_N")
    try:
        data = read_bytes(path, most_bytes=MOST_BYTES)
    except NotReadable as cause:
        raise unusable(path.name, f"that it {cause}", "a table of numbers") from cause
    if path.suffix.lower() in SPREADSHEETS and data.startswith(SPREADSHEETS_BEGIN):
        return _spreadsheet(path, data)
    return (_text(path, data),)


def number_of(cell: Cell) -> float | None:
    """The number in a cell, with a decimal point or comma; None if there is none.

    >>> number_of("1,5"), number_of(2.0), number_of("N")
    (1.5, 2.0, None)
    """
    if isinstance(cell, float):
        return cell
    return decimal_number(cell.replace(",", ".") if cell.count(",") == 1 and "." not in cell else cell)


def number_in(source: str, row: int, cell: Cell, *, holes: bool = False, commas: bool = False) -> float:
    """The number in a cell of a row. `commas`: it may have a decimal comma; `holes`: a cell in EMPTY is NaN.
    Raises TactileFailure (unreadable-frames) for no number, or too large a one.
    """
    text = str(cell).strip()
    if holes and text.lower() in EMPTY:
        return math.nan
    value = number_of(cell) if commas or isinstance(cell, float) else decimal_number(text)
    if value is None or not abs(value) <= LARGEST:
        content = f'"{text[:60]}"' if text else "nothing"
        raise unusable(source, f"{content} in row {row}", f"a number up to {LARGEST:g}{meant(text)}")
    return value


def cells_of(rows: Sequence[Row], places: Iterable[int]) -> Iterator[tuple[Cell, ...]]:
    """The cells of the columns `places`, row by row; empty where a row is too short."""
    columns = tuple(places)
    return (tuple(cells[at] if at < len(cells) else "" for at in columns) for _, cells in rows)


def numbers_in(
    source: str, at: int, rows: Sequence[Row], *, holes: bool, commas: bool
) -> Float[np.ndarray, " n"]:
    """The numbers of one column, read by `number_in`; `source` names the column in failures."""
    cells = zip(rows, cells_of(rows, [at]), strict=True)
    return np.array([number_in(source, row, cell, holes=holes, commas=commas) for (row, _), (cell,) in cells])


def _text(path: Path, data: bytes) -> CellTable:
    text, encoding = _decoded(path, data)
    stated = SEPARATOR_LINE.match(text)
    if stated:  # an empty line stays, so that rows keep their numbers
        text = text[stated.end() :]
    delimiter = stated[1] if stated else delimiter_of(text)
    named = DELIMITERS.get(delimiter, delimiter)
    if delimiter == SPACES:
        spaced = enumerate(text.splitlines(), 1)
        return CellTable(
            name="",
            rows=tuple((k, list[Cell](_spaced(line))) for k, line in spaced if line.strip()),
            delimiter=named,
            encoding=encoding,
        )
    lines = csv_lines(path.name, text, delimiter, expected="numbers, without quotation marks")
    rows = tuple(
        (begun, kept) for begun, cells in lines if (kept := _trimmed(cell.strip() for cell in cells))
    )
    return CellTable(name="", rows=rows, delimiter=named, encoding=encoding)


def csv_lines(source: str, text: str, delimiter: str, *, expected: str) -> Iterator[tuple[int, list[str]]]:
    """The number and cells of each line; raises TactileFailure for a cell or quotation that does not end."""
    lines = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    begun = 1
    try:
        for cells in lines:
            yield begun, cells
            begun = lines.line_num + 1
    except csv.Error as cause:
        endless = "field limit" in str(cause)
        observed = f"a {'cell' if endless else 'quotation mark'} in line {begun} that does not end"
        raise unusable(source, observed, expected) from cause


def refuse_repeated_names(source: str, names: Sequence[str]) -> None:
    """Raises TactileFailure (unreadable-frames) for a repeated column name."""
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise unusable(source, f"the column {twice[:60]!r} twice", "each column once")


def _decoded(path: Path, data: bytes) -> tuple[str, str]:
    """The text and its encoding: by its byte order mark, else UTF-8, else Windows-1252."""
    encodings = ["utf-16"] if data.startswith((b"\xff\xfe", b"\xfe\xff")) else ["utf-8-sig", "cp1252"]
    for encoding in encodings:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" in text:
            break
        return text, encoding
    raise unusable(path.name, "no text", "a table in UTF-8, UTF-16 with its mark, or Windows-1252")


def _spaced(line: str) -> list[str]:
    """Cells separated by spaces; a unit in brackets belongs to the name before, except in a row of units."""
    text = line.strip()
    return text.split() if text[0] in "([" else re.split(r"\s+(?![(\[])", text)


def delimiter_of(text: str) -> str:
    r"""The delimiter of most lines with digits, SPACES if most have none; a comma if no line has a digit.

    >>> delimiter_of("a;b\n1,5;2,5\n"), delimiter_of("a,b\n1,5\n"), delimiter_of("1,5 2\n2,5 3\n")
    (';', ',', 'spaces')
    """
    lines = list(islice((line for line in io.StringIO(text) if re.search(r"\d", line)), LOOKED_AT))
    votes = Counter(_delimiter_in(line) for line in lines)
    return max(votes, key=lambda mark: votes[mark]) if votes else ","


def _delimiter_in(line: str) -> str:
    """Delimiter of one line; commas inside several numbers separated by spaces are decimal ones."""
    mark = next((mark for mark in DELIMITERS if mark in line), SPACES)
    cells = line.split()
    decimal = len(cells) > 1 and all(number_of(cell) is not None for cell in cells)
    return SPACES if mark == "," and decimal else mark


def _spreadsheet(path: Path, data: bytes) -> tuple[CellTable, ...]:
    try:
        from python_calamine import CalamineError, load_workbook
    except ImportError:
        raise unusable(path.name, "a spreadsheet", _CALAMINE) from None

    def read(tell: Callable[[str], None]) -> list[tuple[str, Any]]:
        book = load_workbook(io.BytesIO(data))
        sheets = []
        for name in book.sheet_names:
            tell(name)
            sheets.append((name, book.get_sheet_by_name(name).to_python(skip_empty_area=False)))
        return sheets

    # The library allocates all cells between the used ones; without memory it ends the process.
    trial = tried(read, patience_s=PATIENCE_S, most_bytes=MOST_MEMORY)
    if trial.exceeded:
        where = f"sheet {trial.lines[-1]}" if trial.lines else "the sheets"
        fault = f"cells that take more than {trial.exceeded}"
        expected = "a smaller table: delete what lies outside of it, or save the sheet as .csv"
        raise unusable(f"{path.name}: {where}", fault, expected)
    try:
        sheets = read(lambda _: None)
    except (CalamineError, OSError, ValueError) as cause:
        whole = "a whole spreadsheet; open it and save it again, or save the sheet as .csv"
        raise unusable(path.name, "a damaged or locked spreadsheet", whole) from cause
    return tuple(
        CellTable(
            name=name,
            rows=tuple((k + 1, kept) for k, row in enumerate(rows) if (kept := _trimmed(map(_cell, row)))),
        )
        for name, rows in sheets
    )


def _cell(value: object) -> Cell:
    """A number unchanged, everything else (dates, truth values, errors) as text."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    return str(value).strip()


def _trimmed(cells: Iterable[Cell]) -> list[Cell]:
    kept = list(cells)
    while kept and kept[-1] == "":
        kept.pop()
    return kept if any(cell != "" for cell in kept) else []
