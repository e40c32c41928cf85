"""Finds implausible numbers in the input: a wrong unit, a missing decimal point, a swapped column.

Compares each with the range of its category (recon.pit.priors.Plausible), and mass with sizes. The sentence
names the likely mistake.
"""

import math
import statistics
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

from pipeline.batch.fruits_table import DIAMETERS, MEASURES, FruitRow
from pipeline.batch.settings import Grading
from recon.pit.priors import STONE_FRUIT, PitBody, PitPrior, Plausible

POINT = "is its decimal point missing"
Slips = dict[str, float]
"""Factors that correct a number in another unit, or without its decimal point."""
LENGTH_SLIPS: Slips = {
    "is it in cm": 10, "is it in inches": 25.4, "is it in m": 1000, "is it in µm": 0.001, POINT: 0.1,
}  # fmt: skip
"""Factors into mm, exact."""
MASS_SLIPS: Slips = {
    "is it in kg": 1000, "is it in ounces": 28.35, "is it in pounds": 453.6, "is it in mg": 0.001, POINT: 0.1,
}  # fmt: skip
"""Factors into g: avoirdupois ounce 28.35 g, pound 453.6 g."""
MODULUS_SLIPS: Slips = {
    "is it in kPa": 1e-3, "is it in Pa": 1e-6, "is it in GPa": 1000, "is it in psi": 0.006895
}  # fmt: skip
"""Factors into MPa; 1 psi is 0.006895 MPa."""
FLATTEST = 0.5
"""Least ratio of a mesh's shortest side to the least height or diameter of its category. Assumed: ranges are
of fruit measured over stem or cheeks, and a flat fruit is narrower across the suture. Half of the least is
below every fruit on record, and far above a mesh in centimetres (0.1)."""


@dataclass(frozen=True)
class Measure:
    """A column of fruits.csv: its unit, its words in a sentence, and likely mistakes with it."""

    unit: str
    words: str
    slips: Slips


MEASURED = {
    "height_mm": Measure("mm", "high", LENGTH_SLIPS),
    "diameter_mm": Measure("mm", "wide", LENGTH_SLIPS),
    **dict.fromkeys(DIAMETERS, Measure("mm", "in size", LENGTH_SLIPS)),
    "mass_g": Measure("g", "in mass", MASS_SLIPS),
    "shore_oo": Measure("", "on the Shore OO scale", {POINT: 0.1, "is it a share of 1": 100}),
    "penetrometer_N": Measure(
        "N", "to the penetrometer", {"is it in kg": 9.807, "is it in pounds (lbf)": 4.448, POINT: 0.1}
    ),
}
"""Columns by name. Shore hardness ends at 100 degrees; kilograms-force and pounds-force convert into N."""


@dataclass(frozen=True, kw_only=True)
class PlausibleRange:
    """A category's name in sentences, its plausible ranges and its body."""

    name: str
    ranges: Plausible
    body: PitBody

    def of(self, measure: str) -> tuple[float, float] | None:
        """The range of one of MEASURES. Diameters a to c: FLATTEST times the least size to the most."""
        if measure in DIAMETERS:
            return self.sizes and (FLATTEST * self.sizes[0], self.sizes[1])
        known: tuple[float, float] | None = getattr(self.ranges, measure)
        return known

    @property
    def sizes(self) -> tuple[float, float] | None:
        """Least and most of height and diameter, mm."""
        sides = [limits for limits in (self.ranges.height_mm, self.ranges.diameter_mm) if limits is not None]
        return (min(low for low, _ in sides), max(high for _, high in sides)) if sides else None

    @property
    def a_fruit(self) -> str:
        """The category with its article."""
        return f"{'an' if self.name[:1].lower() in 'aeiou' else 'a'} {self.name}"


def kind_of(category: PitPrior | None) -> PlausibleRange:
    """The ranges of a category; for an unknown one, no ranges and the body of a stone fruit."""
    if category is None:
        return PlausibleRange(name="fruit", ranges=Plausible(), body=STONE_FRUIT)
    return PlausibleRange(
        name=category.category, ranges=category.plausible or Plausible(), body=category.body
    )


def grading_doubts(grading: Grading, kind: PlausibleRange) -> Iterator[str]:
    """Sentences on limits of classes in batch.toml outside the category's range of E."""
    if kind.ranges.E_MPa is None:
        return
    low, high = kind.ranges.E_MPa
    for grading_class in grading.classes:
        if grading_class.E_max_MPa is not None and not low <= grading_class.E_max_MPa <= high:
            yield (
                f'"grading.classes": E_max_MPa of "{grading_class.name}" is {grading_class.E_max_MPa:g}; '
                f"flesh of {kind.a_fruit} has {low:g} to {high:g} MPa"
                f"{_meant(grading_class.E_max_MPa, MODULUS_SLIPS, (low, high), 'MPa')}"
            )


def table_doubts(rows: Iterable[FruitRow], kind: PlausibleRange) -> dict[str, str]:
    """By column: one sentence if every row (at least two) is outside the range, instead of one per row."""
    said, fruit = {}, [row for row in rows if not row.reference]
    for name in MEASURES:
        values = [value for row in fruit if (value := getattr(row, name)) is not None]
        limits = kind.of(name)
        if limits is None or len(values) < 2 or not (max(values) < limits[0] or min(values) > limits[1]):
            continue
        slip = _meant(statistics.median(values), MEASURED[name].slips, limits, MEASURED[name].unit)
        spread = f"{min(values):g} to {max(values):g}"
        said[name] = f"{name} of all {len(values)} fruit is {spread}; {_range(name, kind)}{slip}"
    return said


def row_doubts(row: FruitRow, kind: PlausibleRange, *, said: Collection[str] = ()) -> Iterator[str]:
    """Sentences on implausible numbers of one fruit, alone and as density 6 m / (pi h d^2). `said`: columns
    on which `table_doubts` has a sentence.
    """
    wrong = False
    for name in MEASURES:
        value, limits = getattr(row, name), kind.of(name)
        if value is None or limits is None or limits[0] <= value <= limits[1]:
            continue
        wrong = True
        if name not in said or row.reference:
            slip = _meant(value, MEASURED[name].slips, limits, MEASURED[name].unit)
            yield f"{name} {value:g}: {_range(name, kind)}{slip}"
    dense, height, diameter, mass = kind.ranges.density_g_per_cm3, row.height_mm, row.diameter_mm, row.mass_g
    if wrong or dense is None or height is None or diameter is None or mass is None:
        return
    density = 6000 * mass / (math.pi * height * diameter**2)
    if not dense[0] <= density <= dense[1]:
        yield (
            f"height_mm {height:g}, diameter_mm {diameter:g} and mass_g {mass:g}: together they give a "
            f"density of {density:.2g} g per cm3, but {kind.a_fruit} has {dense[0]:g} to {dense[1]:g}. "
            "Check whether two are swapped, typing errors and units."
        )


def mesh_doubt(box_mm: Sequence[float], kind: PlausibleRange) -> str:
    """A sentence if no fruit has the size of a ready mesh; else empty.

    The longest side must be in the range of sizes, the shortest at least FLATTEST times the least size.
    """
    shortest, longest = min(box_mm), max(box_mm)
    if kind.sizes is None:
        return ""
    low, high = kind.sizes
    if low <= longest <= high and shortest >= FLATTEST * low:
        return ""
    size = " x ".join(f"{side:.3g}" for side in box_mm)
    slip = _meant(longest, LENGTH_SLIPS, kind.sizes, "mm")
    return f"the mesh measures {size} mm; {kind.a_fruit} is {low:g} to {high:g} mm in size{slip}"


def _range(name: str, kind: PlausibleRange) -> str:
    (low, high), measure = kind.of(name) or (0.0, math.inf), MEASURED[name]
    return (
        f"{kind.a_fruit} is {low:g} to {high:g}{f' {measure.unit}' if measure.unit else ''} {measure.words}"
    )


def _meant(value: float, slips: Slips, limits: tuple[float, float], unit: str) -> str:
    """A question with the likely unit: the value nearest to the limits' geometric mean. Else advice."""
    fits = {
        word: value * factor for word, factor in slips.items() if limits[0] <= value * factor <= limits[1]
    }
    if not fits:
        return "; correct it."
    middle = math.sqrt(max(limits[0], 1e-12) * limits[1])
    word = min(fits, key=lambda word: abs(math.log(fits[word] / middle)))
    return f"; {word} ({f'{fits[word]:.4g} {unit}'.strip()})?"
