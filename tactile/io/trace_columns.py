"""Which column of a machine's table is time, force, travel or gap, and in what unit: said, never guessed."""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tactile.io.cell_rows import LOOKED_AT, SPACES, Cell, CellTable, Row, number_of
from tactile.io.pictures import unusable
from tactile.tactile_failure import TactileFailure

TRAVEL = ("travel_mm", "aperture_mm")
FORCE = ("force_N", "force_z_N", "fz_N")
"""Names that travel and force may have; the first that the file has is taken."""
KNOWN = {"time": ("time_s",), "force": FORCE, "travel": TRAVEL, "gap": ("gap_mm",)}
"""The names that are known without an option. A gap takes the place of a travel."""
UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0},
    "force": {"N": 1.0, "mN": 1e-3, "g": 9.80665e-3, "kgf": 9.80665},
    "travel": {"mm": 1.0, "um": 1e-3, "cm": 10.0},
    "gap": {"mm": 1.0, "um": 1e-3, "cm": 10.0},
}
"""Factors to s, N and mm; a gram or kilogram of force is at standard gravity, 9.80665 m/s2 (CGPM 1901)."""
_LIKE = {
    "time": r"time|zeit|temps|tiempo|^t$",
    "force": r"(?<!goal)(?<!goal.)(force|kraft|load|fz|peso|last)",
    "travel": r"travel|displ|pos|ext|stroke|weg|allongement|course|depth|indentation|crosshead|way",
    "gap": r"gap|width|opening|aperture|ecartement|écartement|abstand",
}
"""Words in names of columns by which an option is proposed (it is never taken without being given)."""
_NOT_MEASURED = re.compile(r"goal|target|set|soll|cons|command|step", re.IGNORECASE)
_IN_BRACKETS = re.compile(r"[\(\[]\s*([^\s\)\]]+)\s*[\)\]]\s*$")
_AFTER_LINE = re.compile(r"[_/]\s*([A-Za-zµμ]+)$")


@dataclass(frozen=True, kw_only=True)
class TraceWords:
    """What was said of the table: names of columns and units by quantity, the sheet, and which run of several
    (from 1).
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    sheet: str | None = None
    run: int | None = None


@dataclass(frozen=True, kw_only=True)
class FoundColumns:
    """Where the numbers stand: `place` of each quantity in a row, its unit, and the first row of numbers."""

    header: tuple[str, ...]
    place: Mapping[str, int]
    units: Mapping[str, str]
    first: int


def unit_in(cell: str) -> str | None:
    """A unit as UNITS has it; None where it is none of them. The micro sign has two codes.

    >>> unit_in("[µm]"), unit_in("kgf"), unit_in("Pa")
    ('um', 'kgf', None)
    """
    plain = cell.strip("[]() ").replace("µ", "u").replace("μ", "u")
    return next((unit for units in UNITS.values() for unit in units if unit == plain), None)


def unit_of_name(name: str) -> str | None:
    """The unit that a column's name ends in.

    >>> unit_of_name("Normal force (N)"), unit_of_name("force_N"), unit_of_name("Pos")
    ('N', 'N', None)
    """
    said = _IN_BRACKETS.search(name) or _AFTER_LINE.search(name)
    return None if said is None else unit_in(said[1])


def find_columns(source: str, sheet: CellTable, words: TraceWords) -> FoundColumns | None:
    """The columns by their names in one of the first rows; None where no row has them all.

    Raises TactileFailure (unreadable-frames) for a name twice in the row, and for a unit that nobody states.
    """
    for k, (_, cells) in enumerate(sheet.rows[:LOOKED_AT]):
        names = [cell if isinstance(cell, str) else "" for cell in cells]
        chosen = _chosen(names, words)
        if chosen is None:
            continue
        for name in chosen.values():
            if names.count(name) > 1:
                raise unusable(source, f"the column {name[:60]!r} twice", "each column once")
        place = {quantity: names.index(name) for quantity, name in chosen.items()}
        _check_apart(source, sheet, k)
        if len(set(place.values())) < len(place):
            raise unusable(source, "one column named for two quantities", "a column of its own for each")
        below = sheet.rows[k + 1 : k + 2]
        row = _units_row(below[0][1], place) if below else None
        in_file = {q: (row or {}).get(q) or unit_of_name(chosen[q]) for q in place}
        stated = {q: words.units.get(q) or in_file[q] for q in place}
        if idle := [q for q in words.units if q not in place]:
            read = ", ".join(f'{q} ("{chosen[q][:60]}")' for q in place)
            found = f"--units of {idle[0]}, where {read} are read"
            raise unusable(source, found, f"units of these; leave out {idle[0]}={words.units[idle[0]]}")
        for q, unit in in_file.items():
            if unit in UNITS[q] and unit != stated[q]:
                found = f'{q} ("{chosen[q][:60]}") in {unit} by the file and in {stated[q]} by --units'
                raise unusable(source, found, f"one unit; leave out {q}={stated[q]}")
        missing = [q for q, unit in stated.items() if unit is None or unit not in UNITS[q]]
        if missing:
            raise _no_unit(source, chosen, stated, missing)
        return FoundColumns(
            header=tuple(names),
            place=place,
            units={q: unit for q, unit in stated.items() if unit is not None},
            first=k + 1 if row is None else k + 2,
        )
    return None


def _check_apart(source: str, sheet: CellTable, k: int) -> None:
    """As many names as numbers in the first row of numbers below, where only spaces part them."""
    numbers = next((cells for _, cells in sheet.rows[k + 1 : k + 4] if _numeric(cells)), [])
    names = sheet.rows[k][1]
    if sheet.delimiter == SPACES and numbers and len(numbers) != len(names):
        found = f"{len(names)} names above {len(numbers)} columns of numbers, apart by spaces"
        raise unusable(source, found, "names without spaces in them, or tabs or semicolons between columns")


def _chosen(names: Sequence[str], words: TraceWords) -> dict[str, str] | None:
    """The name in this row of time, force, and travel or gap; None where one of them is not there."""
    found = {}
    for quantity, known in KNOWN.items():
        said = words.columns.get(quantity)
        if said is None and quantity in ("travel", "gap") and {"travel", "gap"} & set(words.columns):
            continue
        name = next((name for name in ((said,) if said is not None else known) if name in names), None)
        if name is not None:
            found[quantity] = name
        elif quantity in ("time", "force") or said is not None:
            return None
    if "travel" in found:
        found.pop("gap", None)
    return found if len(found) == 3 else None


def _units_row(cells: Sequence[Cell], place: Mapping[str, int]) -> dict[str, str | None] | None:
    """The units in the row below the names; None where that row is one of numbers already."""
    own = {q: cells[at] if at < len(cells) else "" for q, at in place.items()}
    if any(isinstance(cell, float) or number_of(cell) is not None for cell in own.values()):
        return None
    texts = {q: cell for q, cell in own.items() if isinstance(cell, str) and cell}
    return {q: unit_in(cell) for q, cell in texts.items()} if len(texts) == len(own) else None


def _no_unit(
    source: str, chosen: Mapping[str, str], stated: Mapping[str, str | None], missing: Sequence[str]
) -> TactileFailure:
    """No unit, or one of another kind: asks for it."""
    quantity = missing[0]
    unit = stated[quantity]
    said = "no unit" if unit is None else f'the unit "{unit}"'
    whole = ",".join(f"{q}={next(iter(UNITS[q]))}" for q in missing)
    ways = "; ".join(f"{q} in {', '.join(UNITS[q])}" for q in missing)
    found = f'{said} of {quantity} ("{chosen[quantity]}") in the file'
    return unusable(source, found, f"its unit: give --units {whole}, or what it is in ({ways})")


def columns_wanted(source: str, sheets: Sequence[CellTable], words: TraceWords) -> TactileFailure:
    """The columns that the file has, and the option to give for them."""
    tables = [(sheet, header_above_numbers(sheet.rows)[0]) for sheet in sheets]
    tables = [(sheet, header) for sheet, header in tables if header]
    if not tables:
        return unusable(
            source,
            "no row of names above columns of numbers",
            "a table: a line of names, then one row for each moment with time, force and travel",
        )
    sheet, header = max(tables, key=lambda one: sum(bool(_like(q, one[1])) for q in KNOWN))
    listed = ", ".join(f'"{name}"' if not name or " " in name else name for name in header if name)
    where = f' in the sheet "{sheet.name}"' if sheet.name else ""
    others = [other.name for other, _ in tables if other is not sheet]
    others_named = f" (other sheets with tables: {', '.join(others[:12])})" if others else ""
    for quantity, name in words.columns.items():
        if name not in header:
            near = difflib.get_close_matches(name, [one for one in header if one], n=1, cutoff=0.5)
            meant = f'; did you mean {quantity}="{near[0]}"?' if near else ""
            found = f'no column "{name}" for {quantity}{where}, but {listed}{others_named}'
            return unusable(source, found, f"one of these names{meant}")
    option = proposed(header, header_above_numbers(sheet.rows)[1])
    return unusable(
        source,
        f"the columns {listed}{where}{others_named}",
        f"time_s, travel_mm and force_N, or these named: give {option}",
    )


def proposed(header: Sequence[str], units_row: Sequence[str] = ()) -> str:
    """The options that would name the columns, as they are to be typed; units only where no row states them.

    >>> proposed(["", "Time", "Force", "GoalForce", "Pos"])
    '--columns time=Time,force=Force,travel=Pos --units time=s,force=N,travel=mm (or what they are in)'
    """
    names: dict[str, str] = {}
    for quantity in ("time", "force", "travel", "gap"):
        if quantity != "gap" or "travel" not in names:
            like = _like(quantity, header)
            if like or quantity in ("time", "force"):
                names[quantity] = like or "NAME"
    if "travel" not in names and "gap" not in names:
        names["travel"] = "NAME"
    columns = ",".join(f"{q}={name}" for q, name in names.items())
    columns = f'"{columns}"' if re.search(r"[^\w=,.-]", columns) else columns
    row = {name: unit_in(unit) for name, unit in zip(header, units_row, strict=False)}
    unstated = [q for q, name in names.items() if (row.get(name) or unit_of_name(name)) not in UNITS[q]]
    units = ",".join(f"{q}={next(iter(UNITS[q]))}" for q in unstated)
    return f"--columns {columns}" + (f" --units {units} (or what they are in)" if units else "")


def _like(quantity: str, header: Sequence[str]) -> str | None:
    """The first column whose name sounds like the quantity, one that was measured before one that was set."""
    named = [name for name in header if re.search(_LIKE[quantity], name, re.IGNORECASE)]
    return next((name for name in named if not _NOT_MEASURED.search(name)), next(iter(named), None))


def header_above_numbers(rows: Sequence[Row]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names above the first run of rows with two numbers or more, and the units between; empty where
    there are none.
    """
    for k, (_, cells) in enumerate(rows[:LOOKED_AT]):
        if k == 0 or not (_numeric(cells) and all(_numeric(one[1]) for one in rows[k + 1 : k + 3])):
            continue
        units: tuple[str, ...] = ()
        for _, above in reversed(rows[max(k - 3, 0) : k]):
            texts = [cell for cell in above if isinstance(cell, str) and cell]
            if len(texts) < 2 or _numeric(above):
                continue
            names = tuple(cell if isinstance(cell, str) else f"{cell:g}" for cell in above)
            if any(re.search(r"[^\W\d_]{3}", cell) and not unit_in(cell) for cell in texts):
                return names, units
            units = names
        break
    return (), ()


def _numeric(cells: Sequence[Cell]) -> bool:
    return sum(number_of(cell) is not None for cell in cells) >= 2
