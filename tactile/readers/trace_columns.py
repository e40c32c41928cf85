"""Finds the columns of time, force, travel or gap in a machine's table, and their units; it never guesses."""

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from tactile.readers.cell_rows import LOOKED_AT, SPACES, Cell, CellTable, Row, cells_of, number_of
from tactile.readers.pictures import unusable
from tactile.readers.stated_unit import EXAMPLES, NoUnit, Unit, is_unit, read_unit, unit_of_name, with_factor
from tactile.tactile_failure import TactileFailure

TRAVEL = ("travel_mm", "aperture_mm")
FORCE = ("force_N", "force_z_N", "fz_N")
"""Names of travel and force, by priority."""
KNOWN = {"time": ("time_s",), "force": FORCE, "travel": TRAVEL, "gap": ("gap_mm",)}
"""Names that need no option. A gap serves if there is no travel."""
_LIKE = {
    "time": r"time|zeit|temps|tiempo|^t$",
    "force": r"force|kraft|load|fz|peso|last|fuerza|carga|charge",
    "travel": r"travel|displ|pos|ext|stroke|weg|allongement|course|depth|indentation|crosshead|way|compres"
    r"|deflection|deform|verform|verschiebung|stauchung|eindring|[eé]crasement|enfoncement|d[eé]placement"
    r"|despl|recorrido|carrera|profundidad",
    "gap": r"gap|width|opening|aperture|[eé]cartement|abstand",
}
"""Words in columns' names by which a message proposes an option; only the user's option takes effect."""
_NOT_MEASURED = re.compile(r"goal|target|set|soll|cons|command", re.IGNORECASE)
_ROWS_BELOW = 3
"""Rows below the names in which a row of units is sought."""


@dataclass(frozen=True, kw_only=True)
class TraceWords:
    """The user's options: columns' names and units by quantity, the sheet, and the run's number (from 1)."""

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    sheet: str | None = None
    run: int | None = None


@dataclass(frozen=True, kw_only=True)
class FoundColumns:
    """`place`: index of each quantity's column; `units`: its unit; `first`: index of the first row of
    numbers. `notes`: facts about the units that the user must know.
    """

    header: tuple[str, ...]
    place: Mapping[str, int]
    units: Mapping[str, Unit]
    first: int
    notes: tuple[str, ...] = ()


def find_columns(source: str, sheet: CellTable, words: TraceWords) -> FoundColumns | None:
    """The columns by their names in one of the first rows; None if no row has them all.

    Raises TactileFailure (unreadable-frames) for a repeated name, and for a unit that is missing or
    ambiguous.
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
        row, first = _units_below(sheet, k, place)
        units, notes = _units(source, chosen, row, words)
        return FoundColumns(header=tuple(names), place=place, units=units, first=first, notes=notes)
    return None


def _units(
    source: str, chosen: Mapping[str, str], row: Mapping[str, str], words: TraceWords
) -> tuple[dict[str, Unit], tuple[str, ...]]:
    """The unit of each quantity, from the names, the row of units and --units, which must agree."""
    if idle := [q for q in words.units if q not in chosen]:
        read = ", ".join(f'{q} ("{name[:60]}")' for q, name in chosen.items())
        fault = f"--units of {idle[0]}, where {read} are read"
        raise unusable(source, fault, f"units of these; leave out {idle[0]}={words.units[idle[0]]}")
    units: dict[str, Unit] = {}
    missing: dict[str, list[Unit | NoUnit]] = {}
    notes = []
    for q, name in chosen.items():
        in_name = unit_of_name(name, q)
        cell = row.get(q, "")
        in_row = with_factor(cell) or read_unit(cell, q) if cell else None
        named = f'{q} ("{name[:60]}")'
        for unit in (in_row, in_name):
            if isinstance(unit, NoUnit) and unit.other is not None:
                raise _other_quantity(source, unit, q, named)
        unsure = any(isinstance(unit, NoUnit) and unit.open for unit in (in_row, in_name))
        in_file = [unit for unit in (in_row, in_name) if isinstance(unit, Unit) and not unsure]
        stated = read_unit(words.units[q], q) if q in words.units else None
        if isinstance(stated, NoUnit):
            raise unusable(source, f"--units {q}={stated.text}, which {stated.why}", _ways(q))
        every = [*in_file, *([stated] if stated else [])]
        if any(not math.isclose(unit.factor, every[0].factor, rel_tol=1e-6) for unit in every[1:]):
            raise _contradiction(source, named, in_row, in_name, stated)
        if not every:
            missing[q] = [unit for unit in (in_row, in_name) if unit is not None]
            continue
        units[q] = every[0]
        unknown = next((unit for unit in (in_row, in_name) if isinstance(unit, NoUnit)), None)
        if unknown is not None and not in_file:
            notes.append(f'{named} states "{unknown.text}", which {unknown.why}; read in {every[0].text}.')
        if every[0].of_mass:
            weight = f"1 {every[0].text} = {every[0].factor:.6g} N"
            notes.append(f"{named} is in {every[0].text}, a mass: taken as its weight ({weight}).")
    if missing:
        raise _no_unit(source, chosen, missing)
    return units, tuple(f"{source}: {note}" for note in notes)


def _contradiction(
    source: str, named: str, in_row: Unit | NoUnit | None, in_name: Unit | NoUnit | None, stated: Unit | None
) -> TactileFailure:
    """The failure for two different units: of the file, or of the file and --units."""
    said = (("the row of units", in_row), ("its name", in_name), ("--units", stated))
    units = [f"{unit.text} by {where}" for where, unit in said if isinstance(unit, Unit)]
    expected = "one unit: correct a copy of the table"
    if stated is not None:
        expected = "one unit: leave --units out for it, or correct the file in a copy"
    return unusable(source, f"{named} in {' and in '.join(units)}", expected)


def _other_quantity(source: str, unit: NoUnit, quantity: str, named: str) -> TactileFailure:
    """The failure for a column that no option turns into a force, a travel or a time."""
    expected = (
        f"a column of {quantity} ({', '.join(EXAMPLES[quantity])}, ...): name another column, convert the "
        f'values, or rename the column if "{unit.text}" is no unit'
    )
    return unusable(source, f'{named} in "{unit.text}", which {unit.why}', expected)


def _ways(quantity: str) -> str:
    return f"a unit of {quantity}, such as {', '.join(EXAMPLES[quantity])}"


def _check_apart(source: str, sheet: CellTable, k: int) -> None:
    """Raises TactileFailure if only spaces separate cells, and the numbers of names and values differ."""
    numbers = next((cells for _, cells in sheet.rows[k + 1 : k + 4] if _numeric(cells)), [])
    names = sheet.rows[k][1]
    if sheet.delimiter == SPACES and numbers and len(numbers) != len(names):
        fault = f"{len(names)} names above {len(numbers)} columns of numbers, apart by spaces"
        raise unusable(source, fault, "names without spaces in them, or tabs or semicolons between columns")


def _chosen(names: Sequence[str], words: TraceWords) -> dict[str, str] | None:
    """The names of time, force, and travel or gap in this row; None if one is missing."""
    names_by_quantity = {}
    for quantity, known in KNOWN.items():
        said = words.columns.get(quantity)
        if said is None and quantity in ("travel", "gap") and {"travel", "gap"} & set(words.columns):
            continue
        name = next((name for name in ((said,) if said is not None else known) if name in names), None)
        if name is not None:
            names_by_quantity[quantity] = name
        elif quantity in ("time", "force") or said is not None:
            return None
    if "travel" in names_by_quantity:
        names_by_quantity.pop("gap", None)
    return names_by_quantity if len(names_by_quantity) == 3 else None


def _units_below(sheet: CellTable, k: int, place: Mapping[str, int]) -> tuple[dict[str, str], int]:
    """The texts in the row of units below the names in row `k`, if any, and the first row of numbers."""
    texts: list[dict[str, str]] = []
    for cells in cells_of(sheet.rows[k + 1 : k + 1 + _ROWS_BELOW], place.values()):
        if not any(cells) or any(number_of(cell) is not None for cell in cells):
            break
        texts.append({q: str(cell) for q, cell in zip(place, cells, strict=True) if cell})
    if not texts:
        return {}, k + 1
    return max(texts, key=lambda row: sum(map(is_unit, row.values()))), k + 1 + len(texts)


def _no_unit(
    source: str, chosen: Mapping[str, str], missing: Mapping[str, Sequence[Unit | NoUnit]]
) -> TactileFailure:
    """The failure for a missing or unknown unit; it proposes one only if the file states none.

    `missing`: by quantity the statements of the row of units, then of the column's name.
    """
    q, stated = next(iter(missing.items()))
    unit = min(stated, key=lambda reading: not (isinstance(reading, NoUnit) and reading.open), default=None)
    said = f'the unit "{unit.text}", which {unit.why},' if isinstance(unit, NoUnit) else "no unit"
    whole = ",".join(f"{name}={'UNIT' if held else EXAMPLES[name][0]}" for name, held in missing.items())
    ways = "; ".join(f"{quantity} in {', '.join(EXAMPLES[quantity])}, ..." for quantity in missing)
    fault = f'{said} of {q} ("{chosen[q]}") in the file'
    return unusable(source, fault, f"its unit: give --units {whole}, or what it is in ({ways})")


def columns_wanted(source: str, sheets: Sequence[CellTable], words: TraceWords) -> TactileFailure:
    """The failure that lists the file's columns and the option to give."""
    tables = [(sheet, header_above_numbers(sheet.rows)) for sheet in sheets]
    tables = [(sheet, header) for sheet, header in tables if header]
    if not tables:
        return unusable(
            source,
            "no row of names above columns of numbers",
            "a table: a line of names, then one row for each moment with time, force and travel",
        )
    sheet, header = max(tables, key=lambda table: len(table[1]))
    listed = ", ".join(f'"{name}"' if not name or " " in name else name for name in header if name)
    where = f' in the sheet "{sheet.name}"' if sheet.name else ""
    others = [other.name for other, _ in tables if other is not sheet]
    others_named = f" (other sheets with tables: {', '.join(others[:12])})" if others else ""
    for quantity, name in words.columns.items():
        if name not in header:
            near = difflib.get_close_matches(name, [title for title in header if title], n=1, cutoff=0.5)
            meant = f'; did you mean {quantity}="{near[0]}"?' if near else ""
            fault = f'no column "{name}" for {quantity}{where}, but {listed}{others_named}'
            return unusable(source, fault, f"one of these names{meant}")
    return unusable(
        source,
        f"the columns {listed}{where}{others_named}",
        f"time_s, travel_mm and force_N, or these named: give {proposed(header)}",
    )


def proposed(header: Sequence[str]) -> str:
    """The option that names the columns, as the user types it.

    >>> proposed(["", "Time", "GoalForce", "Force", "Pos"])
    '--columns time=Time,force=Force,travel=Pos'
    >>> proposed(["time", "Compressive stress (MPa)", "Compressive load", "Compression (mm)"])
    '--columns "time=time,force=Compressive load,travel=Compression (mm)"'
    """
    measured = sorted(header, key=lambda name: bool(_NOT_MEASURED.search(name)))
    like = dict.fromkeys(_LIKE, "NAME")
    for quantity, words in _LIKE.items():
        fits = (
            name for name in measured if re.search(words, name, re.IGNORECASE) and _may_be(name, quantity)
        )
        like[quantity] = next((name for name in fits if name not in like.values()), "NAME")
    way = "gap" if like["travel"] == "NAME" != like["gap"] else "travel"
    columns = ",".join(f"{quantity}={like[quantity]}" for quantity in ("time", "force", way))
    return f'--columns "{columns}"' if re.search(r"[^\w=,.-]", columns) else f"--columns {columns}"


def _may_be(name: str, quantity: str) -> bool:
    """Whether the unit in a column's name, if any, is not that of another quantity."""
    unit = unit_of_name(name, quantity)
    return not (isinstance(unit, NoUnit) and unit.other is not None)


def header_above_numbers(rows: Sequence[Row]) -> tuple[str, ...]:
    """The names above the first rows with two numbers or more; empty if there are none."""
    for k, (_, cells) in enumerate(rows[:LOOKED_AT]):
        if k == 0 or not (_numeric(cells) and all(_numeric(row[1]) for row in rows[k + 1 : k + 3])):
            continue
        for _, above in reversed(rows[max(k - 3, 0) : k]):
            texts = [cell for cell in above if isinstance(cell, str) and cell]
            if len(texts) < 2 or _numeric(above):
                continue
            if any(re.search(r"[^\W\d_]{3}", cell) and not is_unit(cell) for cell in texts):
                return tuple(cell if isinstance(cell, str) else f"{cell:g}" for cell in above)
        break
    return ()


def _numeric(cells: Sequence[Cell]) -> bool:
    return sum(number_of(cell) is not None for cell in cells) >= 2
