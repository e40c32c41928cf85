"""What is known of a category's pit and flesh before any measurement: numbers in TOML files, each with
its source.
"""

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from recon.failure import ReconFailure, ReconProblem

FOLDER = Path(__file__).parent


@dataclass(frozen=True, kw_only=True)
class MeasuredPit:
    """A pit that somebody measured: a closed mesh, mm, z its stem end, x to the suture, about its box's
    centre.

    `digest` (SHA-256) stands for the mesh wherever a prior is compared or written down.
    """

    vertices: Float[np.ndarray, "n 3"] = field(repr=False, compare=False)
    faces: Int[np.ndarray, "m 3"] = field(repr=False, compare=False)
    digest: str


@dataclass(frozen=True, kw_only=True)
class PitPrior:
    """A pit as a superellipsoid in the fruit frame, in shares of the fruit's box, and the spread about it.

    Semi-axis k is `axis_ratios[k]` times half the fruit's box along axis k; its centre lies `raised[k]`
    half-boxes from the box's centre; |x/a|^p + |y/b|^p + |z/c|^p = 1 with p = `exponent` (2: an ellipsoid).
    `offset_sd_mm` is per axis, `size_sd` relative, `poisson_ratio_sd` that of the flesh.
    `fruit_mm` is the least and the greatest size (cube root of the box's volume) that a whole fruit of the
    kind is taken to have, if the file says so. A `measured` pit takes the superellipsoid's place, in its own
    size. `sources` says where each number comes from.
    """

    category: str
    axis_ratios: tuple[float, float, float]
    raised: tuple[float, float, float]
    exponent: float
    offset_sd_mm: float
    size_sd: float
    poisson_ratio: float
    poisson_ratio_sd: float
    sources: dict[str, str]
    fruit_mm: tuple[float, float] | None = None
    measured: MeasuredPit | None = None


def known_categories() -> tuple[str, ...]:
    """Categories that ship with a prior."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def load_prior(category_or_path: str | Path) -> PitPrior:
    """A shipped category's prior, or one from a TOML file of the same form.

    Raises ReconFailure: no-prior (no such category or file), bad-prior (a field missing, or out of its
    range).
    """
    name = str(category_or_path)
    path = Path(name) if name.endswith(".toml") else FOLDER / f"{name}.toml"
    if not (name.endswith(".toml") or name in known_categories()) or not path.is_file():
        raise ReconFailure(
            ReconProblem.NO_PRIOR,
            f"There is no pit prior for {name!r}; known are {', '.join(known_categories())}, "
            "or give the path of a TOML file with one.",
        )
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ReconFailure(
            ReconProblem.BAD_PRIOR,
            f"{path} cannot be read as TOML ({error}); copy a shipped prior and edit it.",
        ) from error
    sources: dict[str, str] = {}

    def number(field: str, low: float, high: float, length: int | None = None) -> Any:
        entry: Any = table.get(field)
        value = entry.get("value") if isinstance(entry, dict) else None
        source = entry.get("source") if isinstance(entry, dict) else None
        values: Any = [value] if length is None else value
        fits = isinstance(values, list) and len(values) == (length or 1) and all(map(_is_number, values))
        if not (fits and isinstance(source, str) and source and all(low <= v <= high for v in values)):
            kind = "a number" if length is None else f"{length} numbers"
            raise ReconFailure(
                ReconProblem.BAD_PRIOR,
                f"{path}: {field} is {entry!r}; expected {{ value = {kind} from {low:g} to {high:g}, "
                'source = "where it comes from" }.',
            )
        sources[field] = source
        return float(values[0]) if length is None else tuple(map(float, values))

    return PitPrior(
        category=str(table.get("category", path.stem)),
        axis_ratios=number("axis_ratios", 0.05, 0.95, 3),
        raised=number("raised", -0.5, 0.5, 3),
        exponent=number("exponent", 1.5, 6.0),
        offset_sd_mm=number("offset_sd_mm", 0.0, 20.0),
        size_sd=number("size_sd", 0.0, 0.5),
        poisson_ratio=number("poisson_ratio", 0.0, 0.4999),
        poisson_ratio_sd=number("poisson_ratio_sd", 0.0, 0.2),
        fruit_mm=number("fruit_mm", 5.0, 200.0, 2) if "fruit_mm" in table else None,
        sources=sources,
    )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
