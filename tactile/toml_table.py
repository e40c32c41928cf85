"""Reading a TOML file key by key, each with the check that its kind needs."""

import tomllib
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tactile.failure import TactileFailure, TactileProblem


def read_table(path: Path, problem: TactileProblem, *, what: str) -> "Table":
    """The whole file as a table; raises TactileFailure (`problem`) where there is no such file or no TOML."""
    try:
        with path.open("rb") as file:
            return Table(path, problem, tomllib.load(file))
    except FileNotFoundError as cause:
        raise refused(problem, path, "the file", "no such file", what) from cause
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as cause:
        raise refused(problem, path, "the file", str(cause), f"{what} in TOML") from cause


def refused(problem: TactileProblem, path: Path, field: str, found: str, expected: str) -> TactileFailure:
    """The failure sentence: where, what was found, what was expected."""
    return TactileFailure(problem, f"{path.name}: {field}: found {found}, expected {expected}.")


@dataclass(frozen=True)
class Table:
    """One table of the file, and the name it goes by in failures."""

    path: Path
    problem: TactileProblem
    values: dict[str, Any] = field(default_factory=dict)
    prefix: str = ""

    def refusal(self, name: str, found: str, expected: str) -> TactileFailure:
        """The failure that names this table's field."""
        return refused(self.problem, self.path, self.prefix + name, found, expected)

    def refuse_unknown(self, known: Collection[str]) -> None:
        """Refuses a key that is not in `known`."""
        for name in self.values:
            if name not in known:
                raise self.refusal(name, "a key that is not known", "one of " + ", ".join(sorted(known)))

    def __bool__(self) -> bool:
        return bool(self.values)

    def table(self, name: str, *, needed: bool) -> "Table":
        """The table `name` below this one; empty where it is not there and not needed."""
        found = self.values.get(name, {})
        if not isinstance(found, dict):
            raise self.refusal(name, repr(found), f"a table [{name}]")
        if needed and not found:
            raise self.refusal(name, "nothing", f"a table [{name}]: this kind of sensor needs it")
        return Table(self.path, self.problem, found, f"{self.prefix}{name}.")

    def tables(self, name: str) -> list["Table"]:
        """The list of tables `name`."""
        found = self.values.get(name, [])
        if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
            raise self.refusal(name, repr(found), f"tables [[{name}]]")
        return [Table(self.path, self.problem, item, f"{name}[{k}].") for k, item in enumerate(found)]

    def text(self, name: str, *, default: str | None = None) -> str:
        """A text; `default` where it may be left out."""
        value = self.values.get(name, default)
        if not isinstance(value, str):
            raise self.refusal(name, "nothing" if value is None else repr(value), "a text in quotes")
        return value

    def choice(self, name: str, allowed: Collection[str]) -> str:
        """A text that must be one of `allowed`."""
        value = self.text(name)
        if value not in allowed:
            raise self.refusal(name, repr(value), " or ".join(allowed))
        return value

    def number(self, name: str, *, needed: bool, above: float) -> float | None:
        """A number above `above`; None where it may be left out, and is."""
        if name not in self.values and not needed:
            return None
        value = float(self.numbers(name, ())[()])
        if not value > above:
            raise self.refusal(name, f"{value:g}", f"a number above {above:g}")
        return value

    def whole(self, name: str) -> int:
        """A whole number above zero."""
        value = self.values.get(name)
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise self.refusal(name, "nothing" if value is None else repr(value), "a whole number above 0")
        return value

    def numbers(self, name: str, shape: tuple[int | None, ...], *, needed: bool = True) -> Any:
        """An array of this shape (None: any length above zero); None where it may be left out, and is."""
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
        except ValueError as cause:
            raise self.refusal(name, "rows of different length", expected) from cause
        fits = array.ndim == len(shape) and all(
            have > 0 if want is None else have == want for have, want in zip(array.shape, shape, strict=True)
        )
        if not fits:
            raise self.refusal(name, f"shape {array.shape}", expected)
        if not np.isfinite(array).all():
            raise self.refusal(name, "a number that is not finite", expected)
        return array


def _holds_other_than_numbers(value: object) -> bool:
    if isinstance(value, list):
        return any(_holds_other_than_numbers(item) for item in value)
    return isinstance(value, bool) or not isinstance(value, int | float)
