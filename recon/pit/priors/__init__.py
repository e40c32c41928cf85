"""Priors of a category (pit, flesh, whole body): numbers in TOML files, with sources."""

import difflib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any

from pipeline.files.plain_file import NotReadable, not_plain, printable, read_text, toml_of
from recon.recon_failure import ReconFailure, ReconProblem
from recon.triangle_mesh import Faces, Vertices

FOLDER = Path(__file__).parent
LEAST_POISSON_RATIO = 0.1
"""Least Poisson's ratio: sources give flesh 0.2 to 0.49 and gels more; 0, as cork's, is an input error."""
MOST_BYTES = 1_000_000
"""Largest file of a category; the shipped ones have 2 kB."""
LEFT = "given_by_batch"
"""Key of the list of fields that a category leaves to the batch."""
MAY_BE_LEFT = {
    "pit": ("axis_ratios", "raised", "exponent"),
    "poisson_ratio": ("poisson_ratio", "poisson_ratio_sd"),
}
"""Groups that a category may leave to the batch, and the fields that its file then omits."""


@dataclass(frozen=True, kw_only=True)
class MeasuredPit:
    """A measured pit: a closed mesh, mm, z to the stem, x to the suture, the centre of its box at 0.

    `digest` (SHA-256) represents the mesh in comparisons and records of a prior.
    """

    vertices: Vertices = field(repr=False, compare=False)
    faces: Faces = field(repr=False, compare=False)
    digest: str


@dataclass(frozen=True, kw_only=True)
class PitBody:
    """Plausible shape and density of a whole body, to check scans; the defaults are for stone fruit.

    `stem_and_suture`: whether the shape shows its orientation (recon.surface.orientation).
    `longest_over_shortest`: largest ratio of its box's sides. `least_convex`: least share of its convex hull
    that it fills. Stone fruit are at most 1.35 times as long as wide and fill 0.95 to 0.99 of their hull
    (estimates). `density_g_per_cm3` of the whole: 0.94 for apricots (Ahmadi et al. 2009, Pakistan Journal of
    Nutrition 8:264), 1.24 for peaches (Emadi et al. 2011, World Applied Sciences Journal 12(1):119), the
    margin an estimate. `pit_mm`: longest side of a measured pit, from below a small cherry's to above a large
    peach's (estimate).
    """

    stem_and_suture: bool = True
    longest_over_shortest: float = 1.45
    least_convex: float = 0.93
    density_g_per_cm3: tuple[float, float] = (0.8, 1.3)
    pit_mm: tuple[float, float] = (4.0, 60.0)


STONE_FRUIT = PitBody()


Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Plausible:
    """Least and greatest plausible value of each quantity of a real fruit of the category; None: unknown.

    The ranges are wide, because values outside are refused. `height_mm` is along the stem axis, `diameter_mm`
    across it. `density_g_per_cm3` is mass over the ellipsoid of height and diameter, so flat or grooved fruit
    deviate. `E_MPa` is Young's modulus of the flesh, from over-ripe to unripe.
    """

    height_mm: Range | None = None
    diameter_mm: Range | None = None
    mass_g: Range | None = None
    shore_oo: Range | None = None
    penetrometer_N: Range | None = None
    density_g_per_cm3: Range | None = None
    E_MPa: Range | None = None


@dataclass(frozen=True, kw_only=True)
class PitPrior:
    """A superellipsoidal pit in the fruit frame, in shares of the fruit's box, and its uncertainty.

    Semi-axis k is `axis_ratios[k]` times half the fruit's box along axis k. The centre lies `raised[k]`
    half-boxes from the box's centre. |x/a|^p + |y/b|^p + |z/c|^p = 1 with p = `exponent` (2: an ellipsoid).
    `offset_sd_mm` is per axis, `size_sd` relative, `poisson_ratio_sd` that of the flesh. `fruit_mm`: least
    and greatest size of a whole fruit (cube root of the box's volume), if the file states it. `plausible`:
    ranges outside which staff's numbers are errors, if the file has the table. A `measured` pit replaces the
    superellipsoid, in its own size. `axis_ratios` and `poisson_ratio` are None in a category that leaves them
    to the batch. `body`: plausible shape of the whole. `sources`: where each number comes from.
    """

    category: str
    offset_sd_mm: float
    size_sd: float
    sources: dict[str, str]
    axis_ratios: tuple[float, float, float] | None = None
    raised: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exponent: float = 2.0
    poisson_ratio: float | None = None
    poisson_ratio_sd: float = 0.0
    fruit_mm: tuple[float, float] | None = None
    measured: MeasuredPit | None = None
    body: PitBody = STONE_FRUIT
    plausible: Plausible | None = None

    @property
    def has_pit(self) -> bool:
        """Whether the prior defines a pit."""
        return self.measured is not None or self.axis_ratios is not None


@cache
def known_categories() -> tuple[str, ...]:
    """Names of the shipped categories."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def load_prior(category_or_path: str | Path) -> PitPrior:
    """A shipped category's prior, or one from a TOML file of the same form.

    Raises ReconFailure: no-prior (no such category or file), bad-prior (a field missing, misspelt, or out of
    its range).
    """
    name = str(category_or_path)
    if not name.endswith(".toml"):
        return _shipped(name)
    path = Path(name)
    if wrong := not_plain(path):
        fault = "is no file" if wrong == "does not exist" else wrong
        raise ReconProblem.NO_PRIOR.failure(
            f"{path} {fault}; write the file (copy a shipped category and edit it: docs/formats.md), "
            f"or name a shipped category: {', '.join(known_categories())}."
        )
    return _read(path)


@cache
def _shipped(name: str) -> PitPrior:
    """A shipped category's prior; cached, because a run opens its batch several times."""
    if name not in known_categories():
        raise ReconProblem.NO_PRIOR.failure(
            f"drupe has no pit prior for {name!r}; known: {', '.join(known_categories())}. You can "
            "also give the path of a TOML file."
        )
    return _read(FOLDER / f"{name}.toml")


Kind = tuple[str, Callable[[Any], Any]]
"""The expected value in words, and a parser that returns None for any other."""


def _numbers(low: float, high: float, count: int = 1, *, rising: bool = False) -> Kind:
    """A number in a range, or a tuple of `count`; `rising`: the smaller first."""

    def read(value: Any) -> float | tuple[float, ...] | None:
        given = value if count > 1 else [value]
        if not isinstance(given, list) or len(given) != count or not all(map(_is_number, given)):
            return None
        fits = low <= min(given) and max(given) <= high and not (rising and given[0] >= given[1])
        return (float(value) if count == 1 else tuple(map(float, given))) if fits else None

    kind = "a number" if count == 1 else f"{count} numbers"
    return f"{kind} from {low:g} to {high:g}" + (", the smaller first" if rising else ""), read


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


_FLAG: Kind = ("true or false", lambda value: value if isinstance(value, bool) else None)
_FIELDS: dict[str, Kind] = {
    "axis_ratios": _numbers(0.05, 0.95, 3),
    "raised": _numbers(-0.5, 0.5, 3),
    "exponent": _numbers(1.5, 6.0),
    "offset_sd_mm": _numbers(0.0, 20.0),
    "size_sd": _numbers(0.0, 0.5),
    "poisson_ratio": _numbers(LEAST_POISSON_RATIO, 0.4999),
    "poisson_ratio_sd": _numbers(0.0, 0.2),
}
"""Fields of pit and flesh that a category states or leaves to the batch; the ranges exceed any fruit's."""
_OF_BODY: dict[str, Kind] = {
    "stem_and_suture": _FLAG,
    "longest_over_shortest": _numbers(1.0, 100.0),
    "least_convex": _numbers(0.0, 1.0),
    "density_g_per_cm3": _numbers(0.0, 25.0, 2, rising=True),
    "pit_mm": _numbers(0.1, 200.0, 2, rising=True),
}
"""Fields of PitBody, with its defaults; the ranges exceed those of any fruit and phantom."""
_OPTIONAL = {**_OF_BODY, "fruit_mm": _numbers(5.0, 200.0, 2, rising=True)}
"""These and the usual size of a whole fruit, mm."""
_PLAUSIBLE = "two numbers of 0 or above, the smaller first", _numbers(0.0, 1e9, 2, rising=True)[1]
"""Kind of each range of Plausible, in its unit; larger numbers are input errors."""


def _read(path: Path) -> PitPrior:
    try:
        table = toml_of(read_text(path, most_bytes=MOST_BYTES))
    except NotReadable as error:
        raise ReconProblem.BAD_PRIOR.failure(f"{path} {error}; copy a shipped prior and edit it.") from error
    category = table.get("category", path.stem)
    if not isinstance(category, str) or not 0 < len(printable(category).strip()) <= 200:
        shown = _shown(category)
        raise _bad(path, f"category is {shown}; expected a name in quotes of at most 200 characters.")
    left = _left_to_batch(path, table)
    wanted = {name: kind for name, kind in _FIELDS.items() if name not in left}
    given = {name: kind for name, kind in _OPTIONAL.items() if name in table}
    values, sources = {}, {}
    for name, (expected, read) in {**wanted, **given}.items():
        entry = table.get(name)
        said = entry if isinstance(entry, dict) else {}
        source, values[name] = said.get("source"), read(said.get("value"))
        if values[name] is None or not (isinstance(source, str) and source):
            advice = "" if name in table else " Add it; shipped categories show how."
            message = (
                f"{name} is {_shown(entry)}; "
                f'expected {{ value = {expected}, source = "where it comes from" }}.{advice}'
            )
            raise _bad(path, message)
        sources[name] = printable(source)
    known = {*_FIELDS, *_OPTIONAL, "category", "plausible", LEFT}
    for key in table.keys() - known:  # other keys are notes of the file's owner
        if near := difflib.get_close_matches(key, known, n=1, cutoff=0.8):
            raise _bad(path, f'unknown key "{key}"; did you mean "{near[0]}"?')
    body = PitBody(**{name: values.pop(name) for name in _OF_BODY if name in values})
    return PitPrior(
        category=printable(category).strip(),
        body=body,
        plausible=_plausible(path, table.get("plausible")),
        sources=sources,
        **values,
    )


def _left_to_batch(path: Path, table: Mapping[str, Any]) -> set[str]:
    """Fields that the file leaves to the batch; raises ReconFailure (bad-prior) if it also states them."""
    named = table.get(LEFT, [])
    if not isinstance(named, list) or not all(isinstance(n, str) and n in MAY_BE_LEFT for n in named):
        choice = " and ".join(f'"{n}"' for n in MAY_BE_LEFT)
        raise _bad(path, f"{LEFT} is {_shown(named)}; expected a list of {choice}, or no such key.")
    for group in named:
        for name in (name for name in MAY_BE_LEFT[group] if name in table):
            message = f'{name} is given, but {LEFT} leaves "{group}" to the batch; remove one of the two.'
            raise _bad(path, message)
    return {name for group in named for name in MAY_BE_LEFT[group]}


def _plausible(path: Path, table: object) -> Plausible | None:
    """The table [plausible] of a category's file, each entry `[low, high]`; None without the table."""
    if table is None:
        return None
    if not isinstance(table, dict):
        shown = _shown(table)
        raise _bad(path, f"plausible is {shown}; expected a table [plausible] of ranges [low, high].")
    known = [each.name for each in fields(Plausible)]
    ranges = {}
    for key, value in table.items():
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f'did you mean "{near[0]}"?' if near else f"known are {', '.join(known)}."
            raise _bad(path, f'unknown key "plausible.{key}"; {hint}')
        expected, read = _PLAUSIBLE
        ranges[key] = read(value)
        if ranges[key] is None:
            raise _bad(path, f"plausible.{key} is {_shown(value)}; expected [low, high]: {expected}.")
    return Plausible(**ranges)


def _shown(value: object) -> str:
    return repr(value)[:120]


def _bad(path: Path, detail: str) -> ReconFailure:
    return ReconProblem.BAD_PRIOR.failure(f"{path}: {detail}")
