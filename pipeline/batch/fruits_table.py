"""Reads `fruits.csv`, one row per fruit, and reports every fault of every row."""

import csv
import difflib
import io
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, ConfigDict

from fem.elements.assembly import LARGEST_POISSON_RATIO
from fem.indentation.compressed_ellipsoid import LARGEST_PIT
from pipeline.files.plain_file import NotReadable, composed, printable, read_text
from pipeline.problem import BatchRefused, Problem, refused
from recon.pit.priors import LEAST_POISSON_RATIO
from tactile.readers.decimal_number import decimal_number, meant
from tactile.readers.specimen import DIAMETERS as AXES
from tactile.readers.specimen import Axis

MOST_BYTES, MOST_FRUIT, MOST_CELL, MOST_COLUMNS = 4_000_000, 2000, 10_000, 200
"""Most bytes, rows, characters of a cell, and columns: a day's harvest of one line has some hundred fruit, a
row of notes 400 bytes."""
DIAMETERS = ("diameter_a_mm", "diameter_b_mm", "diameter_c_mm")
HARDNESS = ("shore_oo", "penetrometer_N")
"""Readings of other instruments, which vary from fruit to fruit far more than sizes do."""
MEASURES = ("height_mm", "mass_g", *HARDNESS, "diameter_mm", *DIAMETERS)
REFERENCE_E_MPA = (0.0005, 60.0)
"""Range of a reference body's modulus: as of phantoms (recon/pit/priors/phantom.toml), from hydrogels to cast
polyurethane."""
REFERENCE_SD = (1e-4, 0.5)
"""Range of its relative standard deviation: 0.5 leaves the modulus practically unknown, and no tensile test
reaches 1e-4 (ISO 7500-1, class 0.5: 5e-3)."""
REFERENCE_MEASURES = ("reference_E_MPa", "reference_E_sd_MPa", "reference_poisson_ratio")
COLUMNS = ("fruit_id", *MEASURES, "axis", "pit_share", "notes", "reference", *REFERENCE_MEASURES)
USER_COLUMN = re.compile(r"[^\W_][\w .%°#()/-]{0,59}")
"""A name that a user may give to a column; no spreadsheet reads it as a formula or as two cells."""
NO_COLUMNS: Mapping[str, str] = MappingProxyType({})
YES, NO = frozenset({"true", "yes", "1"}), frozenset({"", "false", "no", "0"})
SEPARATOR_LINE = re.compile(r'"?sep=([,;\t])"?[ ,;\t]*', re.IGNORECASE)
SAFE_ID = re.compile(r"[^\W_][\w. -]{0,79}")
"""Letters and digits of any script (composed: NFC), dots, dashes, underscores, spaces; no mark or symbol."""


class Given(BaseModel):
    """A fruit's cells in fruits.csv; an empty measure is None."""

    model_config = ConfigDict(frozen=True)

    height_mm: float | None = None
    mass_g: float | None = None
    shore_oo: float | None = None
    penetrometer_N: float | None = None
    diameter_mm: float | None = None
    diameter_a_mm: float | None = None
    diameter_b_mm: float | None = None
    diameter_c_mm: float | None = None
    axis: Axis | None = None
    """The diameter along which plates compress the fruit."""
    pit_share: float | None = None
    """Diameter of the pit over that of the fruit."""
    notes: str = ""
    columns: dict[str, float | str] = {}
    """Cells of the user's own columns (Settings.columns), without the empty ones."""
    reference: bool = False
    """Whether the row is a reference body of known modulus `reference_E_MPa`, not a fruit."""
    reference_E_MPa: float | None = None
    reference_E_sd_MPa: float | None = None
    reference_poisson_ratio: float | None = None

    @property
    def diameters(self) -> tuple[float | None, ...]:
        """The diameters a, b and c."""
        return self.diameter_a_mm, self.diameter_b_mm, self.diameter_c_mm


class FruitRow(Given):
    """A row of fruits.csv. `unreadable`: measures whose filled cells are no numbers above zero."""

    fruit_id: str
    unreadable: tuple[str, ...] = ()

    @property
    def has_height(self) -> bool:
        """Whether the cell of the height is filled, even if it is no number above zero."""
        return self.height_mm is not None or "height_mm" in self.unreadable


def given_of(row: FruitRow) -> Given:
    """The cells of a row without its fruit_id."""
    return Given(**{name: getattr(row, name) for name in Given.model_fields})


def read_fruits(
    path: Path, *, units: Mapping[str, str] | None = NO_COLUMNS, may_be_empty: bool = False
) -> tuple[tuple[FruitRow, ...], list[Problem]]:
    """The fruit with a valid fruit_id, each once, and every fault of the table. A table without rows is a
    fault unless it `may_be_empty`. `units`: the user's own columns with their units (Settings.columns); None
    if nobody can know them, because batch.toml is unreadable.

    Raises BatchRefused if the file is no table, or has no column fruit_id.
    """
    problems: list[Problem] = []
    columns, records = _table(path, problems)
    known = (*COLUMNS, *(units or {}))
    problems += [
        Problem(str(path), f'unknown column "{column[:80]}"; {_known_column(column, known)}')
        for column in columns
        if column not in known and (units is not None or canonical(column) in known)
    ]
    if "fruit_id" not in columns:
        if not any(canonical(column) == "fruit_id" for column in columns):
            problems.append(Problem(str(path), 'the column "fruit_id" is missing; add it, one id per row.'))
        raise BatchRefused(problems)
    rows = [_row(path, line, record, units or NO_COLUMNS, problems) for line, record in records]
    lines: dict[str, list[int]] = {}
    for (line, _), row in zip(records, rows, strict=True):
        lines.setdefault(row.fruit_id, []).append(line)
    for fruit_id, where in lines.items():
        if len(where) > 1:
            at = ", ".join(map(str, where))
            sentence = f'fruit_id "{fruit_id}" appears on lines {at}; give every fruit its own id.'
            problems.append(Problem(str(path), sentence))
    if not rows and not may_be_empty:
        sentence = (
            "lists no fruit; add a row for each fruit below the header, and put its photos/ and grasps/ into "
            "fruits/<fruit_id>/."
        )
        problems.append(Problem(str(path), sentence))
    once = {row.fruit_id: row for row in reversed(rows) if SAFE_ID.fullmatch(row.fruit_id)}
    return tuple(row for row in rows if once.get(row.fruit_id) is row), problems


def _known_column(written: str, known: Sequence[str]) -> str:
    """Advice on an unknown column: the column that was likely meant, and how to declare one's own."""
    if (plain := canonical(written, known)) in known:
        return f"write {plain}."
    declare = f'To keep a column of your own, write "{written[:80]}" = "" under [columns] in batch.toml.'
    lower = {name.lower(): name for name in known}
    near = difflib.get_close_matches(plain, lower, n=1, cutoff=0.75)
    if not near:
        return f"known columns: {', '.join(known)}. {declare}"
    likely = lower[near[0]]
    unit = re.search(r"_(mm|g|N|MPa)$", likely) if likely in COLUMNS else None
    if unit is None:
        return f"if you mean it, write {likely}. {declare}"
    return f"if you mean it, write {likely} with its values in {unit[1]}. {declare}"


def canonical(column: str, known: Sequence[str] = COLUMNS) -> str:
    """The known column that equals the name but for case, spaces and dashes; else the name, normalised."""
    plain = re.sub(r"[\s_-]+", "_", column.strip().lower())
    return next((name for name in known if re.sub(r"[\s_-]+", "_", name.lower()) == plain), plain)


Record = tuple[int, dict[str, str]]
"""The first line of a row, and its cells by column."""


def _table(path: Path, problems: list[Problem]) -> tuple[list[str], list[Record]]:
    """The column names, and the rows with their cells as text. If semicolons or tabs separate the cells, as
    in spreadsheets of many countries, a comma in a number is its decimal point.
    """
    if not path.is_symlink() and not path.exists():
        raise refused(path, "is missing; it lists the fruit, one row per fruit: fruit_id,height_mm,...")
    try:
        text = composed(read_text(path, most_bytes=MOST_BYTES))
    except NotReadable as error:
        hint = "; save it as CSV UTF-8" if "text" in str(error) else ""
        raise refused(path, f"{error}{hint}.") from None
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    text, separator = _separated(text)
    try:
        rows = _rows(text, separator)
    except ValueError as error:
        raise BatchRefused([*problems, Problem(str(path), str(error))]) from None
    if not rows:
        raise refused(path, "is empty; the first line names the columns.")
    names = [name.strip() for name in rows[0][1]]
    while names and not names[-1]:
        names.pop()
    for line, cells in rows[1:]:
        if any(cell.strip() for cell in cells[len(names) :]):
            message = (
                f"line {line} has more cells than the header; put texts that contain commas in quotation "
                "marks, and write numbers with a decimal point (57.6 for 57,6)."
            )
            raise BatchRefused([*problems, Problem(str(path), message)])
    if len(rows) - 1 > MOST_FRUIT:
        message = f"holds {len(rows) - 1} rows; a batch has at most {MOST_FRUIT} fruit: split the batch."
        raise refused(path, message)
    return names, [(line, dict(zip(names, cells, strict=False))) for line, cells in rows[1:]]


def _separated(text: str) -> tuple[str, str]:
    """The text and the separator of its cells. A first line "sep=;", as Excel writes it, states it, and
    becomes empty so that lines keep their numbers. Otherwise it is the most frequent one in the header, and
    of equally frequent ones a semicolon or a tab.
    """
    first, _, rest = text.partition("\n")
    if stated := SEPARATOR_LINE.fullmatch(first):
        return "\n" + rest, stated[1]
    separator = max(";\t,", key=first.count)
    return text, separator if separator in first else ","


def _rows(text: str, separator: str) -> list[tuple[int, list[str]]]:
    """Each row's first line and its cells, without empty rows; a cell may span several lines.

    Raises ValueError for an open quotation mark, which swallows the rows below it, for a duplicate column,
    and for too many columns or characters.
    """
    lines = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True, strict=True)
    begun = 1
    rows: list[tuple[int, list[str]]] = []
    try:
        for cells in lines:
            names = [name.strip() for name in cells]
            columns = 0 if rows else sum(map(bool, names))
            if columns > MOST_COLUMNS:
                raise ValueError(
                    f"has {columns} columns, expected at most {MOST_COLUMNS}; keep those of docs/formats.md."
                )
            twice = "" if rows else next((name for name in names if name and names.count(name) > 1), "")
            if twice:
                raise ValueError(f'has the column "{twice[:80]}" twice; remove one of them.')
            if any(len(cell) > MOST_CELL for cell in cells):
                raise csv.Error("field limit")
            if separator != ",":
                cells = [re.sub(r"\A\s*(-?\d+),(\d+)\s*\Z", r"\1.\2", cell) for cell in cells]
            if any(names):
                rows.append((begun, cells))
            begun = lines.line_num + 1
    except csv.Error as error:
        if "field limit" in str(error):
            sentence = f"line {begun} has a cell of more than {MOST_CELL} characters; shorten it."
            raise ValueError(sentence) from None
        sentence = (
            f"line {begun} has an open quotation mark, or text after a closing one. Remove the mark, "
            "or quote the whole cell and double the marks inside it."
        )
        raise ValueError(sentence) from None
    return rows


def _row(
    path: Path, line: int, record: dict[str, str], units: Mapping[str, str], problems: list[Problem]
) -> FruitRow:
    """One row of fruits.csv; `problems` gets its faults."""
    cells = {name: (record.get(name) or "").strip() for name in COLUMNS}
    fruit_id = cells["fruit_id"]
    if not SAFE_ID.fullmatch(fruit_id):
        sentence = (
            f'line {line}: fruit_id "{fruit_id[:80]}" cannot name a folder. Use letters, digits, '
            "dot, dash, underscore and space (at most 80), and start with a letter or digit."
        )
        problems.append(Problem(str(path), sentence))

    def wrong(sentence: str) -> None:
        problems.append(Problem(str(path), f"line {line} ({fruit_id[:80]}): {sentence}"))

    known: dict[str, Any] = {}
    unreadable = []
    for name in MEASURES:
        number = decimal_number(cells[name])
        if number is not None and number > 0:
            known[name] = number
        elif text := cells[name]:
            expected = "expected a number above zero, or an empty cell"
            wrong(f'{name} is "{text[:40]}"; {expected}{meant(text)}.')
            unreadable.append(name)
    known |= _pressed(cells, wrong)
    known |= _reference(cells, wrong)
    columns = _user_cells(record, units, wrong)
    notes = printable(cells["notes"]).strip()
    return FruitRow(fruit_id=fruit_id, notes=notes, columns=columns, unreadable=tuple(unreadable), **known)


def _user_cells(
    record: Mapping[str, str], units: Mapping[str, str], wrong: Callable[[str], None]
) -> dict[str, float | str]:
    """The user's own cells: numbers in columns with a unit, text in the others; calls `wrong` for faults."""
    cells: dict[str, float | str] = {}
    for name, unit in units.items():
        text = printable(record.get(name) or "").strip()
        if not unit and text:
            cells[name] = text
        elif text and (number := decimal_number(text)) is not None:
            cells[name] = number
        elif text:
            wrong(
                f'{name} is "{text[:40]}"; expected a number, because [columns] in batch.toml gives its unit '
                f"({unit}), or an empty cell{meant(text)}."
            )
    return cells


def _pressed(cells: Mapping[str, str], wrong: Callable[[str], None]) -> dict[str, Any]:
    """Axis of compression and pit share; calls `wrong` for each fault, also of the diameters."""
    missing = [name for name in DIAMETERS if not cells[name]]
    if 0 < len(missing) < len(DIAMETERS):
        are = "is empty" if len(missing) == 1 else "are empty"
        wrong(f"{' and '.join(missing)} {are}; expected all three diameters or none; measure the fruit.")
    axis = cells["axis"].lower()
    if axis not in ("", *AXES):
        wrong(f'axis is "{cells["axis"][:40]}"; expected a, b or c (the diameter between the plates).')
    text, share = cells["pit_share"], decimal_number(cells["pit_share"])
    if text and (share is None or not 0 <= share <= LARGEST_PIT):
        percent = "; is it in percent?" if share is not None and share > 1 else meant(text)
        wrong(
            f'pit_share is "{text[:40]}"; expected the diameter of the pit divided by that of the '
            f"fruit, 0 (no pit) to {LARGEST_PIT:g}{percent}."
        )
        share = None
    return {"axis": axis if axis in AXES else None, "pit_share": share if text else None}


def _reference(cells: Mapping[str, str], wrong: Callable[[str], None]) -> dict[str, Any]:
    """The columns of a reference body, empty for a fruit; calls `wrong` for each fault."""
    flag = cells["reference"].lower()
    if flag not in YES | NO:
        wrong(
            f'reference is "{flag[:40]}"; expected true for a reference body of known modulus, or '
            "false or an empty cell for a fruit."
        )
    if flag not in YES:
        for name in [name for name in REFERENCE_MEASURES if cells[name] and flag in NO]:
            wrong(
                f'{name} is "{cells[name][:40]}", but reference is not true; write true into the '
                "column reference, or empty the cell."
            )
        return {}
    measures = {name: decimal_number(cells[name]) for name in REFERENCE_MEASURES}
    E_MPa, sd_MPa = measures["reference_E_MPa"], measures["reference_E_sd_MPa"]
    low, high = REFERENCE_E_MPA
    if E_MPa is None or not low <= E_MPa <= high:
        in_unit = _other_unit(E_MPa) if E_MPa is not None else ""
        wrong(
            f"reference_E_MPa {_as_found(cells['reference_E_MPa'])}; expected the reference body's Young's "
            f"modulus, {low:g} to {high:g} MPa{in_unit or '; write it from its certificate or tensile test.'}"
        )
        E_MPa = None
    least, most_sd = (share * (REFERENCE_E_MPA[0] if E_MPa is None else E_MPa) for share in REFERENCE_SD)
    if sd_MPa is None or sd_MPa < least or (E_MPa is not None and sd_MPa > most_sd):
        most = "" if E_MPa is None else f" and at most {most_sd:g} MPa (half of its modulus)"
        wrong(
            f"reference_E_sd_MPa {_as_found(cells['reference_E_sd_MPa'])}; expected one standard deviation "
            f"of reference_E_MPa, {least:g} or more{most}; write it in MPa."
        )
    text, ratio = cells["reference_poisson_ratio"], measures["reference_poisson_ratio"]
    if text and (ratio is None or not LEAST_POISSON_RATIO <= ratio <= LARGEST_POISSON_RATIO):
        wrong(
            f"reference_poisson_ratio {_as_found(text)}; expected {LEAST_POISSON_RATIO:g} to "
            f"{LARGEST_POISSON_RATIO:g}, for example 0.48 for silicone."
        )
    return {"reference": True, **measures}


def _as_found(text: str) -> str:
    return f'is "{text[:40]}"{meant(text) if decimal_number(text) is None else ""}' if text else "is empty"


def _other_unit(E_MPa: float) -> str:
    for unit, in_MPa in (("kPa", 1e-3), ("Pa", 1e-6), ("GPa", 1e3)):
        if REFERENCE_E_MPA[0] <= E_MPa * in_MPa <= REFERENCE_E_MPA[1]:
            return f"; is it in {unit} ({E_MPa * in_MPa:.4g} MPa)?"
    return ""
