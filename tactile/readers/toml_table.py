"""Reads a TOML file key by key, and checks each value."""

import datetime
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.files.plain_file import NotReadable, printable, read_text, toml_of
from tactile.readers.pictures import absence
from tactile.readers.recording_fields import Limit, are_rigid, fits
from tactile.tactile_failure import TactileFailure, TactileProblem

MOST_BYTES = 1_000_000
"""Largest description: places of 10,000 markers take 0.4 MB."""
MOST_NAME_BYTES = 255
"""Longest file name on Linux (NAME_MAX): the search for a longer one raises another error."""
LARGEST = 1e9
"""No number of a sensor is larger; products of far larger ones overflow."""


def read_table(path: Path, problem: TactileProblem, *, what: str) -> "Table":
    """The whole file as a table; raises TactileFailure (`problem`) if it is missing or not TOML."""
    if missing := absence(path):
        raise refused(problem, path, "the file", missing, what)
    try:
        return Table(path, problem, toml_of(read_text(path, most_bytes=MOST_BYTES)))
    except NotReadable as cause:
        raise refused(problem, path, "the file", f"that it {cause}", f"{what} in TOML") from cause


def refused(problem: TactileProblem, path: Path, field: str, fault: str, expected: str) -> TactileFailure:
    """The failure sentence: where, what was found, what was expected."""
    shown = fault if len(fault) <= 200 else f"{fault[:197]}..."
    return problem.failure(printable(f"{path.name}: {field}: found {shown}, expected {expected}."))


@dataclass(frozen=True)
class Table:
    """One table of the file; `prefix` names it in failures. Wrong values raise TactileFailure (`problem`)."""

    path: Path
    problem: TactileProblem
    values: dict[str, Any] = field(default_factory=dict)
    prefix: str = ""

    def refusal(self, name: str, fault: str, expected: str) -> TactileFailure:
        """The failure that names this table's field."""
        return refused(self.problem, self.path, self.prefix + name, fault, expected)

    def refuse_unknown(self, known: Collection[str]) -> None:
        """Refuses a key that is not in `known`."""
        for name in self.values:
            if name not in known:
                raise self.refusal(name, "a key that is not known", "one of " + ", ".join(sorted(known)))

    def require_format(self, name: str, version: int) -> None:
        """Refuses a file of another format, or of another version of it."""
        if self.text("format", default="nothing") != name:
            raise self.refusal("format", repr(self.values.get("format")), f'"{name}"')
        if self.values.get("version") != version:
            raise self.refusal("version", repr(self.values.get("version")), str(version))

    def pose(self, name: str) -> Float[np.ndarray, "4 4"]:
        """A rigid motion as a 4x4 matrix, mm."""
        pose: Float[np.ndarray, "4 4"] = self.numbers(name, (4, 4))
        if not are_rigid(pose[None]).all():
            raise self.refusal(name, "a matrix that is no rotation and shift", "a rigid motion, mm")
        return pose

    def __bool__(self) -> bool:
        return bool(self.values)

    def table(self, name: str, *, needed: bool) -> "Table":
        """The table `name` below this one; empty if it is missing and not needed."""
        entry = self.values.get(name, {})
        if not isinstance(entry, dict):
            raise self.refusal(name, repr(entry), f"a table [{name}]")
        if needed and not entry:
            raise self.refusal(name, "nothing", f"a table [{name}]: this kind of sensor needs it")
        return Table(self.path, self.problem, entry, f"{self.prefix}{name}.")

    def text(self, name: str, *, default: str | None = None) -> str:
        """A text of at most 1000 characters; `default` if it is missing."""
        value = self.values.get(name, default)
        if not isinstance(value, str):
            raise self.refusal(name, "nothing" if value is None else repr(value), "a text in quotes")
        if len(value) > 1000:
            raise self.refusal(name, f"{len(value)} characters", "at most 1000")
        return printable(value)

    def file_name(self, name: str, *, default: str | None = None) -> str:
        """A text that can name a file, with or without a path."""
        value = self.text(name, default=default)
        if any(len(part.encode()) > MOST_NAME_BYTES for part in value.split("/")):
            raise self.refusal(name, value, f"a file's name of at most {MOST_NAME_BYTES} bytes")
        return value

    def choice(self, name: str, allowed: Collection[str]) -> str:
        """A text that must be one of `allowed`."""
        value = self.text(name)
        if value not in allowed:
            raise self.refusal(name, repr(value), " or ".join(allowed))
        return value

    def day(self, name: str) -> datetime.date | None:
        """A date, written as one or as text (2026-08-14); None if it is missing."""
        held = self.values.get(name)
        try:
            return None if held is None else datetime.date.fromisoformat(str(held))
        except ValueError:
            raise self.refusal(name, repr(held), "a date like 2026-08-14") from None

    def within(self, name: str, limit: Limit, *, needed: bool) -> float | None:
        """A number within its limit, which is a recording's; None if it is missing and not needed."""
        value = self.number(name, needed=needed, above=0.0)
        if value is not None and not limit.least <= value <= limit.largest:
            expected = f"{limit.least:g} to {limit.largest:g} {limit.unit}".rstrip()
            raise self.refusal(name, f"{value:g}", expected)
        return value

    def number(self, name: str, *, needed: bool, above: float) -> float | None:
        """A number above `above`; None if it is missing and not needed."""
        if name not in self.values and not needed:
            return None
        value = float(self.numbers(name, ())[()])
        if not value > above:
            raise self.refusal(name, f"{value:g}", f"a number above {above:g}")
        return value

    def whole(self, name: str) -> int:
        """A whole number from 1 to 1000."""
        value = self.values.get(name)
        if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= 1000:
            raise self.refusal(name, "nothing" if value is None else repr(value), "a whole number, 1 to 1000")
        return value

    def numbers(self, name: str, shape: tuple[int | None, ...], *, needed: bool = True) -> Any:
        """An array of this shape (None: any length above zero); None if it is missing and not needed."""
        if name not in self.values and not needed:
            return None
        value = self.values.get(name)
        expected = (
            "a number" if not shape else "numbers of shape " + " x ".join(str(n or "any") for n in shape)
        )
        if value is None or _holds_other_than_numbers(value):
            raise self.refusal(name, "nothing" if value is None else repr(value), expected)
        try:
            array = np.asarray(value, dtype=np.float64)
        except (ValueError, OverflowError) as cause:
            raise self.refusal(name, "rows of different length", expected) from cause
        if not fits(array.shape, shape):
            raise self.refusal(name, f"shape {array.shape}", expected)
        if not np.isfinite(array).all():
            raise self.refusal(name, "a number that is not finite", expected)
        if np.abs(array).max(initial=0.0) > LARGEST:
            raise self.refusal(name, f"{np.abs(array).max():g}", f"{expected} up to {LARGEST:g}")
        return array


def _holds_other_than_numbers(value: object) -> bool:
    if isinstance(value, list):
        return any(_holds_other_than_numbers(item) for item in value)
    return isinstance(value, bool) or not isinstance(value, int | float)
