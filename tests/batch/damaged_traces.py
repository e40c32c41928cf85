"""What loggers do to the table of a press: each case names the note or the refusal that must come."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from file_damage import Change, put

HEADER = "time_s,travel_mm,force_N"
FORMAT, TRACE = "trace of a press", "sources/trace.csv"
Columns = np.ndarray


def press() -> Columns:
    """Rows of time, travel and force: a ball of 10 mm radius on flesh of 1 MPa, held and drawn back."""
    rng = np.random.default_rng(9)
    time = np.arange(0, 18.0, 0.04)
    travel = np.interp(time, [0, 8, 10, 18], [0, 2.0, 2.0, 0])
    force = 5.287 * np.maximum(travel - 0.5, 0) ** 1.5 + 0.01 * rng.standard_normal(len(time))
    return np.stack([time, travel, force], axis=1)


def table(rows: Columns, *, header: str = HEADER, again: tuple[int, ...] = ()) -> bytes:
    """The rows as a logger writes them, NaN as an empty cell; `again`: rows above which the header stands."""
    lines = [header]
    for k, row in enumerate(rows):
        lines += [header] * (k in again)
        lines.append(",".join("" if np.isnan(value) else f"{value:.5f}" for value in row))
    return ("\n".join(lines) + "\n").encode()


def _written(make: Callable[[Columns], Columns], **options: tuple[int, ...]) -> Change:
    return lambda path, _: put(path, table(make(press()), **options))


def _reserved(rows: Columns, *, fill: float, start: int = 0, end: int = 0) -> Columns:
    blocks = [np.full((count, 3), fill) for count in (start, end)]
    rows += np.array([0.04 * start, 5.0, 0.3])
    if np.isnan(fill):  # the time was written
        blocks[0][:, 0], blocks[1][:, 0] = 0.04 * np.arange(start), rows[-1, 0] + 0.04 * np.arange(1, end + 1)
    return np.concatenate([blocks[0], rows, blocks[1]])


def _set(rows: Columns, *, at: dict[int, float], column: int) -> Columns:
    rows[list(at), column] = list(at.values())
    return rows


def _held(rows: Columns, *, column: int, each: int) -> Columns:
    rows[:, column] = rows[np.arange(len(rows)) // each * each, column]
    return rows


def _stepped(rows: Columns, *, column: int, at: int, step: float) -> Columns:
    rows[at:, column] += step - (rows[at, column] if column == 2 else 0)
    return rows


def _joined(rows: Columns, *, each: float, later: float) -> Columns:
    slow = np.arange(later, rows[-1, 0], each)
    place = np.stack([slow, np.interp(slow, rows[:, 0], rows[:, 1]), np.full(len(slow), np.nan)], axis=1)
    rows[:, 1] = np.nan
    both = np.concatenate([rows, place])
    return both[np.argsort(both[:, 0], kind="stable")]


def _clocks(rows: Columns) -> Columns:
    joined = _joined(rows, each=0.1, later=0.01)
    joined[np.isnan(joined[:, 2]), 0] += 1e6
    return joined


def _runs(rows: Columns, *, count: int) -> Columns:
    return np.tile(rows, (count, 1))


def _set_back(rows: Columns) -> Columns:
    rows[150:, 0] -= 3.0
    return rows


def _holes(rows: Columns, *, share: float) -> Columns:
    rows[5 :: round(1 / share), 2] = np.nan
    return rows


def changes() -> Iterator[tuple[str, Change, str]]:
    """Kind, change and what must come of each."""
    n = len(press())
    for fill in (0.0, -999.0, np.nan):
        for start, end in ((40, 0), (0, 25)):
            make = partial(_reserved, fill=fill, start=start, end=end)
            where = f"{start or end} rows at the {'start' if start else 'end'}"
            yield f"{where} of {fill:g}", _written(make), f"{where}.*left out"
    for column, name in ((2, "force"), (1, "travel")):
        for at in ({30: -196.0}, {30: 98.0, 200: 0.0}, {120: 77.0, 121: -40.0}):
            first = next(iter(at))
            words = f"wild readings? of {name} left out: row {first + 2} "
            yield f"wild {name} {at}", _written(partial(_set, at=at, column=column)), words
    for column, name in ((1, "travel"), (2, "force")):
        for each in (4, 7, 12):
            yield (
                f"{name} held {each}",
                _written(partial(_held, column=column, each=each)),
                f"{name} was read",
            )
    for at, step in ((110, -1.1), (110, 30.0), (300, -5.0)):
        made = partial(_stepped, column=1, at=at, step=step)
        yield f"display set at {at} by {step:g}", _written(made), f"display of the travel.*row {at + 2} "
    for at in (100, 170, 300):
        made = partial(_stepped, column=2, at=at, step=0.0)
        yield f"cell zeroed at {at}", _written(made), f"zeroed under load at row {at + 2} "
    for each in (0.1, 0.17, 0.02):
        yield f"topics, {each:g} s", _written(partial(_joined, each=each, later=0.013)), "two topics"
    yield "topics of two clocks", _written(_clocks), "two clocks"
    for count, name in ((2, "two"), (3, "three"), (5, "five")):
        for again in ((), tuple(n * k for k in range(1, count))):
            yield (
                f"{name} runs, {len(again)} headers",
                _written(partial(_runs, count=count), again=again),
                f"{name} runs.*--run all",
            )
    yield "a clock set back", _written(_set_back), "the clock was set back"
    yield "a hundredth missing", _written(partial(_holes, share=0.01)), "with an empty cell left out"
    yield "a tenth missing", _written(partial(_holes, share=0.1)), r"wild or missing.*at most 2%"


def write_trace(path: Path) -> None:
    """The sound press."""
    path.write_bytes(table(press()))
