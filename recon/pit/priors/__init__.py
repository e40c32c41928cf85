"""What is known of a category beforehand (pit, flesh, whole body): numbers in TOML files, with sources."""

import difflib
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from pipeline.files.plain_file import NotReadable, not_plain, printable, read_text, toml_of
from recon.pit.priors.plausible import Plausible, is_number, read_plausible
from recon.recon_failure import ReconFailure, ReconProblem

__all__ = [
    "LEAST_POISSON_RATIO", "STONE_FRUIT", "Body", "MeasuredPit", "PitPrior", "Plausible", "known_categories",
    "load_prior",
]  # fmt: skip
FOLDER = Path(__file__).parent
LEAST_POISSON_RATIO = 0.1
"""Of flesh and of phantoms: fruit tissue is given 0.2 to 0.49 and gels more; 0, cork's, is a slip."""
MOST_BYTES = 1_000_000
"""Of a category's file; the shipped ones have 3 kB."""
LEFT = "given_by_batch"
"""The key under which a category names what it leaves to the batch."""
MAY_BE_LEFT = {
    "pit": ("axis_ratios", "raised", "exponent"),
    "poisson_ratio": ("poisson_ratio", "poisson_ratio_sd"),
}
"""What a category may leave, and the fields that it then does not have."""


@dataclass(frozen=True, kw_only=True)
class MeasuredPit:
    """A pit that somebody measured: a closed mesh, mm, z to the stem, x to the suture, its box about 0.

    `digest` (SHA-256) stands for the mesh wherever a prior is compared or written down.
    """

    vertices: Float[np.ndarray, "n 3"] = field(repr=False, compare=False)
    faces: Int[np.ndarray, "m 3"] = field(repr=False, compare=False)
    digest: str


@dataclass(frozen=True, kw_only=True)
class PitBody:
    """What a whole body of a category is like, by which a scan is doubted; as it stands here, a stone fruit.

    `stem_and_suture`: whether the shape shows how it stands (recon.surface.orientation).
    `longest_over_shortest`: of its box, at most; `least_convex`: the least share of its convex hull that
    it fills. Stone fruit are at most 1.35 times as long as wide and fill 0.95 to 0.99 of their hull
    (estimates). `density_g_per_cm3` of the whole: 0.94 for apricots (Ahmadi et al. 2009, Pakistan Journal
    of Nutrition 8:264), 1.24 for peaches (Emadi et al. 2011, World Applied Sciences Journal 12(1):119),
    the margin an estimate. `pit_mm`: the longest side of a measured pit, from less than a small cherry's
    to more than a large peach's (estimate).
    """

    stem_and_suture: bool = True
    longest_over_shortest: float = 1.45
    least_convex: float = 0.93
    density_g_per_cm3: tuple[float, float] = (0.8, 1.3)
    pit_mm: tuple[float, float] = (4.0, 60.0)


STONE_FRUIT = PitBody()


@dataclass(frozen=True, kw_only=True)
class PitPrior:
    """A pit as a superellipsoid in the fruit frame, in shares of the fruit's box, and the spread about it.

    Semi-axis k is `axis_ratios[k]` times half the fruit's box along axis k; its centre lies `raised[k]`
    half-boxes from the box's centre; |x/a|^p + |y/b|^p + |z/c|^p = 1 with p = `exponent` (2: an ellipsoid).
    `offset_sd_mm` is per axis, `size_sd` relative, `poisson_ratio_sd` that of the flesh.
    `fruit_mm` is the least and the greatest size (cube root of the box's volume) that a whole fruit of the
    kind is taken to have, if the file says so; `plausible`: the ranges outside which a number that staff give
    is a slip, if the file has the table. A `measured` pit takes the superellipsoid's place, in its own
    size. `axis_ratios` and `poisson_ratio` are None in a category that leaves them to the batch. `body`: what
    else is expected of the whole. `sources` says where each number comes from.
    """

    category: str
    axis_ratios: tuple[float, float, float] | None
    raised: tuple[float, float, float]
    exponent: float
    offset_sd_mm: float
    size_sd: float
    poisson_ratio: float | None
    poisson_ratio_sd: float
    sources: dict[str, str]
    fruit_mm: tuple[float, float] | None = None
    measured: MeasuredPit | None = None
    body: PitBody = STONE_FRUIT
    plausible: Plausible | None = None

    @property
    def has_pit(self) -> bool:
        """Whether it says which pit to set into a fruit."""
        return self.measured is not None or self.axis_ratios is not None


@cache
def known_categories() -> tuple[str, ...]:
    """Categories that ship with a file."""
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
    """What comes with the package is read once: a run opens its batch several times."""
    if name not in known_categories():
        raise ReconProblem.NO_PRIOR.failure(
            f"drupe has no pit prior for {name!r}; known: {', '.join(known_categories())}. You can "
            "also give the path of a TOML file."
        )
    return _read(FOLDER / f"{name}.toml")


def _read(path: Path) -> PitPrior:
    try:
        table = toml_of(read_text(path, most_bytes=MOST_BYTES))
    except NotReadable as error:
        raise ReconProblem.BAD_PRIOR.failure(f"{path} {error}; copy a shipped prior and edit it.") from error
    return _prior(_Entries(path, table, {}))


@dataclass(frozen=True)
class _Entries:
    """The fields of one file; `sources` collects where the numbers come from as they are read."""

    path: Path
    table: dict[str, Any]
    sources: dict[str, str]

    def number(self, name: str, low: float, high: float, length: int | None = None) -> Any:
        """One number, or a tuple of `length`."""
        value = self._value(name)
        values: Any = [value] if length is None else value
        fits = isinstance(values, list) and len(values) == (length or 1) and all(map(is_number, values))
        if not (fits and name in self.sources and all(low <= v <= high for v in values)):
            kind = "a number" if length is None else f"{length} numbers"
            raise self._wrong(name, f"{kind} from {low:g} to {high:g}")
        return float(values[0]) if length is None else tuple(map(float, values))

    def limits(self, name: str, low: float, high: float) -> tuple[float, float]:
        """A least and a greatest value."""
        least, greatest = self.number(name, low, high, 2)
        if not least < greatest:
            raise self._wrong(name, f"2 numbers from {low:g} to {high:g}, the smaller first")
        return least, greatest

    def name(self) -> str:
        """What the category is called: as it says, or as its file is."""
        said = self.table.get("category", self.path.stem)
        if not isinstance(said, str) or not 0 < len(printable(said).strip()) <= 200:
            raise self.bad(
                f"category is {repr(said)[:120]}; expected a name in quotes of at most 200 characters."
            )
        return printable(said).strip()

    def flag(self, name: str) -> bool:
        """True or false."""
        value = self._value(name)
        if not isinstance(value, bool) or name not in self.sources:
            raise self._wrong(name, "true or false")
        return value

    def left_to_batch(self) -> frozenset[str]:
        """What the file leaves to the batch; it must not say it as well."""
        named = self.table.get(LEFT, [])
        if not isinstance(named, list) or not all(isinstance(n, str) and n in MAY_BE_LEFT for n in named):
            choice = " and ".join(f'"{n}"' for n in MAY_BE_LEFT)
            raise self.bad(f"{LEFT} is {repr(named)[:120]}; expected a list of {choice}, or no such key.")
        for group in named:
            for given in (name for name in MAY_BE_LEFT[group] if name in self.table):
                raise self.bad(
                    f'{given} is given, but {LEFT} leaves "{group}" to the batch; remove one of the two.'
                )
        return frozenset(named)

    def refuse_slips(self, known: set[str]) -> None:
        """A key that is nearly one that is known is a slip of the pen; others are notes of its owner's."""
        for key in self.table.keys() - known:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.8)
            if near:
                raise self.bad(f'unknown key "{key}"; did you mean "{near[0]}"?')

    def bad(self, detail: str) -> ReconFailure:
        """The failure that names the file."""
        return ReconProblem.BAD_PRIOR.failure(f"{self.path}: {detail}")

    def _value(self, name: str) -> Any:
        entry = self.table.get(name)
        if not isinstance(entry, dict):
            return None
        source = entry.get("source")
        if isinstance(source, str) and source:
            self.sources[name] = printable(source)
        return entry.get("value")

    def _wrong(self, name: str, expected: str) -> ReconFailure:
        advice = "" if name in self.table else " Add it; shipped categories show how."
        return self.bad(
            f"{name} is {repr(self.table.get(name))[:120]}; expected {{ value = {expected}, "
            f'source = "where it comes from" }}.{advice}'
        )


def _prior(entries: _Entries) -> PitPrior:
    """A category's table as a prior; raises ValueError as the entries do."""
    left = entries.left_to_batch()
    number, table = entries.number, entries.table
    pit, ratio = "pit" not in left, "poisson_ratio" not in left
    prior = PitPrior(
        category=entries.name(),
        axis_ratios=number("axis_ratios", 0.05, 0.95, 3) if pit else None,
        raised=number("raised", -0.5, 0.5, 3) if pit else (0.0, 0.0, 0.0),
        exponent=number("exponent", 1.5, 6.0) if pit else 2.0,
        offset_sd_mm=number("offset_sd_mm", 0.0, 20.0),
        size_sd=number("size_sd", 0.0, 0.5),
        poisson_ratio=number("poisson_ratio", LEAST_POISSON_RATIO, 0.4999) if ratio else None,
        poisson_ratio_sd=number("poisson_ratio_sd", 0.0, 0.2) if ratio else 0.0,
        fruit_mm=entries.limits("fruit_mm", 5.0, 200.0) if "fruit_mm" in table else None,
        body=_body(entries),
        plausible=read_plausible(table.get("plausible"), refuse=entries.bad),
        sources=entries.sources,
    )
    named = {f.name for f in (*fields(PitPrior), *fields(PitBody))} - {"sources", "measured", "body"}
    entries.refuse_slips({*named, LEFT})
    return prior


def _body(entries: _Entries) -> PitBody:
    """What the file says of the whole body; what it leaves out is a stone fruit's."""
    readers: dict[str, Callable[[str], Any]] = {
        "stem_and_suture": entries.flag,
        "longest_over_shortest": lambda name: entries.number(name, 1.0, 100.0),
        "least_convex": lambda name: entries.number(name, 0.0, 1.0),
        "density_g_per_cm3": lambda name: entries.limits(name, 0.0, 25.0),
        "pit_mm": lambda name: entries.limits(name, 0.1, 200.0),
    }
    return PitBody(**{name: read(name) for name, read in readers.items() if name in entries.table})
