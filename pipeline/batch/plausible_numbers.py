"""Numbers that can be read and that no fruit has: a unit, a decimal point, a column was slipped.

Each is held against the ranges of its category (recon.pit.priors.Plausible), against the other numbers of its
fruit and against the other fruit of the batch. The sentence names the likely slip.
"""

import bisect
import itertools
import math
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from pipeline.batch.fruits_table import DIAMETERS, HARDNESS, MEASURES, FruitRow
from pipeline.batch.settings import Grading
from recon.pit.priors import STONE_FRUIT, PitBody, PitPrior, Plausible

POINT = "is its decimal point missing"
Slips = tuple[tuple[float, str], ...]
LENGTH_SLIPS: Slips = (
    (10, "is it in cm"), (25.4, "is it in inches"), (1000, "is it in m"), (0.001, "is it in µm"),
    (0.1, POINT), (0.01, POINT),
)  # fmt: skip
"""Factors that turn a length typed in another unit or without its point into mm; units are exact."""
MASS_SLIPS: Slips = (
    (1000, "is it in kg"), (28.35, "is it in ounces"), (453.6, "is it in pounds"), (0.001, "is it in mg"),
    (0.1, POINT), (0.01, POINT),
)  # fmt: skip
"""The same into g: avoirdupois ounce 28.35 g, pound 453.6 g."""
MODULUS_SLIPS: Slips = (
    (1e-3, "is it in kPa"), (1e-6, "is it in Pa"), (1000, "is it in GPa"), (0.006895, "is it in psi")
)  # fmt: skip
"""The same into MPa; 1 psi is 0.006895 MPa."""
SHORE_SLIPS: Slips = ((0.1, POINT), (100, "is it a share of 1"))
"""The same into degrees of Shore hardness, which end at 100."""
FORCE_SLIPS: Slips = ((9.807, "is it in kg"), (4.448, "is it in pounds (lbf)"), (0.1, POINT))
"""The same into N, of a penetrometer's force: kilograms-force, pounds-force."""
LENGTHS = ("height_mm", "diameter_mm", *DIAMETERS)
SLIPS: dict[str, Slips] = {
    **dict.fromkeys(LENGTHS, LENGTH_SLIPS),
    "mass_g": MASS_SLIPS,
    "shore_oo": SHORE_SLIPS,
    "penetrometer_N": FORCE_SLIPS,
}
UNITS = {**dict.fromkeys(LENGTHS, "mm"), "mass_g": "g", "shore_oo": "", "penetrometer_N": "N"}
WORDS = {
    "height_mm": "high",
    "diameter_mm": "wide",
    "mass_g": "in mass",
    "shore_oo": "on the Shore OO scale",
    "penetrometer_N": "to the penetrometer",
    **dict.fromkeys(DIAMETERS, "in size"),
}
FLATTER = 1.8
"""Ratio, no unit: how far height over diameter may go beyond the category's longest over shortest side.
Assumed, nothing was measured: flat peaches are about 2.3 times as wide as high, and 1.8 times a stone fruit's
1.45 is 2.6, a little more."""
BATCH_FACTOR = 3.0
"""Ratio, no unit: a length this far from its batch's median is no fruit of it. Assumed: the fruit of one lot
differ by a half, twice that is left to mixed lots, and a slipped decimal point (10) is far beyond."""
WIDE_BATCH_FACTOR = 8.0
"""Ratio, no unit: the same where specimens of a category are of any size (WIDE). Assumed: the most that is
still clearly less than a slipped decimal point, 10."""
WIDE = 10.0
"""Ratio, no unit: largest over least height from which a category's specimens are of any size. Assumed: the
shipped fruit have 4 to 8, phantoms 40; from 10 on a slipped decimal point stays within the range."""
LIKE_OTHERS = 2.0
"""Ratio, no unit: a number in another unit is what was meant where it comes this near the batch's median.
Assumed: a lot's fruit differ by a half, and no two units of a length are nearer to each other than 2.5."""
FLATTEST = 0.5
"""Ratio, no unit: a mesh's shortest side over the least height or diameter of its category. Assumed: ranges
are of fruit measured over stem or cheeks, and the side across the suture of a flat one is less than either;
half of the least is below every fruit on record, and a mesh in centimetres (0.1) is far below it."""
SAME_FRUIT = 1.6
"""Ratio, no unit: two sides of one fruit differ by no more, where a mass may be a side written in its column.
Assumed: stone fruit's longest over shortest side is at most 1.45 (recon.pit.priors), and a tenth is left
to the calliper."""
FEWEST_OTHERS = 3
"""Fruit beside the one in question whose median says something: of two, either may be the odd one."""


@dataclass(frozen=True, kw_only=True)
class PlausibleRange:
    """A category as the sentences name it, and what is known of it."""

    name: str
    ranges: Plausible
    body: PitBody

    def of(self, measure: str) -> tuple[float, float] | None:
        """The range of one of MEASURES; a diameter that may be any is between least and most of all sides."""
        if measure not in DIAMETERS:
            known: tuple[float, float] | None = getattr(self.ranges, measure)
            return known
        sides = [limits for limits in (self.ranges.height_mm, self.ranges.diameter_mm) if limits is not None]
        return (FLATTEST * min(s[0] for s in sides), max(s[1] for s in sides)) if sides else None

    @property
    def a_fruit(self) -> str:
        """The category with its article."""
        return f"{'an' if self.name[:1].lower() in 'aeiou' else 'a'} {self.name}"


def kind_of(category: PitPrior | None) -> PlausibleRange:
    """What is known of a category; of an unknown one, nothing."""
    if category is None:
        return PlausibleRange(name="fruit", ranges=Plausible(), body=STONE_FRUIT)
    return PlausibleRange(
        name=category.category, ranges=category.plausible or Plausible(), body=category.body
    )


def grading_doubts(grading: Grading, kind: PlausibleRange) -> Iterator[str]:
    """Sentences on numbers of batch.toml that no fruit of the category meets."""
    if kind.ranges.E_MPa is None:
        return
    low, high = kind.ranges.E_MPa
    for grading_class in grading.classes:
        if grading_class.E_max_MPa is not None and not low <= grading_class.E_max_MPa <= high:
            slip = _meant(grading_class.E_max_MPa, MODULUS_SLIPS, (low, high), "MPa")
            yield (
                f'"grading.classes": E_max_MPa of "{grading_class.name}" is {grading_class.E_max_MPa:g}; '
                f"flesh of {kind.a_fruit} has {low:g} to {high:g} MPa{slip}"
            )


class TableColumns:
    """The measures of a table's fruit, in order of size: one of many fruit is held against the others in no
    more time than one of few.
    """

    def __init__(self, rows: Iterable[FruitRow]) -> None:
        fruit = [row for row in rows if not row.reference]
        self._ids = {row.fruit_id for row in fruit}
        self._values: dict[str, list[float]] = {
            name: sorted(float(value) for row in fruit if (value := getattr(row, name)) is not None)
            for name in MEASURES
        }

    def of(self, name: str) -> Sequence[float]:
        """Its values, least first."""
        return self._values[name]

    def middle_without(self, row: FruitRow, name: str) -> float | None:
        """The median of the other fruit, where there are enough."""
        values = self._values[name]
        measurement: float | None = getattr(row, name)
        if row.fruit_id not in self._ids or measurement is None:
            return statistics.median(values) if len(values) >= FEWEST_OTHERS else None
        count = len(values) - 1
        if count < FEWEST_OTHERS:
            return None
        at = bisect.bisect_left(values, measurement)
        low, high = (values[k if k < at else k + 1] for k in ((count - 1) // 2, count // 2))
        return (low + high) / 2


def table_doubts(columns: TableColumns, kind: PlausibleRange) -> dict[str, str]:
    """Sentences on the columns that are out of range in every row: one slip, not many."""
    said = {}
    for name in MEASURES:
        values = columns.of(name)
        limits = kind.of(name)
        if limits is None or len(values) < 2 or not (values[-1] < limits[0] or values[0] > limits[1]):
            continue
        slip = _meant(statistics.median(values), SLIPS[name], limits, UNITS[name])
        said[name] = f"{name} of all {len(values)} fruit is {_spread(values)}; {_range(name, kind)}{slip}"
    return said


def row_doubts(row: FruitRow, columns: TableColumns, kind: PlausibleRange) -> Iterator[str]:
    """Sentences on what one fruit's numbers cannot be: alone, together, and among the other fruit.

    What `table_doubts` says of a whole column is not said again. A reference body stands alone, and no fruit
    is held against one.
    """
    if row.reference:
        columns = TableColumns(())
    measurements = {name: value for name in MEASURES if (value := getattr(row, name)) is not None}
    if said := _exchanged(measurements, kind):
        yield said
        return
    wrong = {name for name in table_doubts(columns, kind) if name in measurements}
    for name, value in measurements.items():
        limits = kind.of(name)
        if name not in wrong and limits is not None and not _within(value, limits):
            wrong.add(name)
            like = columns.middle_without(row, name)
            slip = _meant(value, SLIPS[name], limits, UNITS[name], like=like)
            yield f"{name} {value:g}: {_range(name, kind)}{slip}"
    for name in [measure for measure in measurements if measure not in HARDNESS and measure not in wrong]:
        said = _apart(name, measurements[name], columns.middle_without(row, name), kind)
        if said:
            wrong.add(name)
            yield said
    if not wrong:
        yield from _together(measurements, kind)


def mesh_doubt(box_mm: Sequence[float], height_mm: float | None, kind: PlausibleRange) -> str:
    """A sentence where a ready mesh is of no fruit's size, or ten times the height that staff measured; empty
    where it can be.

    The longest side must not pass what a height or diameter can be, nor the shortest fall below it.
    """
    shortest, longest = min(box_mm), max(box_mm)
    ranges = [r for r in (kind.ranges.height_mm, kind.ranges.diameter_mm) if r is not None]
    size = f"{box_mm[0]:.3g} x {box_mm[1]:.3g} x {box_mm[2]:.3g}"
    if ranges:
        low, high = min(r[0] for r in ranges), max(r[1] for r in ranges)
        if longest < low or longest > high or shortest < FLATTEST * low:
            slip = _meant(longest, LENGTH_SLIPS, (low, high), "mm", like=height_mm, shown=box_mm[2])
            return (
                f"the mesh is {box_mm[2]:.3g} mm high ({size} mm); {kind.a_fruit} is {low:g} to {high:g} mm "
                f"in size{slip}"
            )
    if height_mm is not None and not 1 / BATCH_FACTOR < box_mm[2] / height_mm < BATCH_FACTOR:
        return (
            f"the mesh is {box_mm[2]:.3g} mm high ({size} mm), but fruits.csv says height_mm {height_mm:g}; "
            "is it in mm, with the stem along z, and of this fruit?"
        )
    return ""


def _range(name: str, kind: PlausibleRange) -> str:
    low, high = kind.of(name) or (0.0, math.inf)
    unit = f" {UNITS[name]}" if UNITS[name] else ""
    return f"{kind.a_fruit} is {low:g} to {high:g}{unit} {WORDS[name]}"


def _meant(
    value: float,
    slips: Slips,
    limits: tuple[float, float],
    unit: str,
    *,
    like: float | None = None,
    shown: float | None = None,
) -> str:
    """What the number would be, had it been meant in another unit; the nearest to `like` first.

    `shown`: the number that the sentence begins with, where that is not the one held against the limits.
    """
    fits = [(factor, word) for factor, word in slips if _within(value * factor, limits)]
    if not fits:
        return "; correct it."
    centre = like or math.sqrt(max(limits[0], 1e-12) * limits[1])
    said = value if shown is None else shown
    factor, word = min(fits, key=lambda fit: abs(math.log((said if like else value) * fit[0] / centre)))
    after = f"{said * factor:.4g} {unit}".strip()
    return f"; {word} ({after})?"


def _exchanged(measurements: Mapping[str, float], kind: PlausibleRange) -> str:
    """A sentence where two numbers fit each other's column, and one fits its own in no unit."""
    for a, b in itertools.combinations(measurements, 2):
        of_a, of_b = kind.of(a), kind.of(b)
        if of_a is None or of_b is None or {a, b} <= set(LENGTHS):
            continue
        lost = not (_in_some_unit(a, measurements[a], of_a) and _in_some_unit(b, measurements[b], of_b))
        if lost and _within(measurements[a], of_b) and _within(measurements[b], of_a):
            both = f"{a} {measurements[a]:g} and {b} {measurements[b]:g}"
            return f"{both}: are the two swapped? {_range(a, kind)}."
    return ""


def _in_some_unit(name: str, value: float, limits: tuple[float, float]) -> bool:
    return any(_within(value * factor, limits) for factor, _ in ((1.0, ""), *SLIPS[name]))


def _within(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] <= value <= limits[1]


def _apart(name: str, value: float, middle: float | None, kind: PlausibleRange) -> str:
    """A sentence where a number is far from the batch's median, `middle`; empty where it is not."""
    if middle is None:
        return ""
    sizes = kind.ranges.height_mm
    narrow = sizes is not None and sizes[1] / sizes[0] < WIDE
    factor = BATCH_FACTOR if narrow else WIDE_BATCH_FACTOR
    if name == "mass_g":
        factor = factor**2 if narrow else factor**3
    if 1 / factor < value / middle < factor:
        return ""
    slip = _meant(value, SLIPS[name], (middle / LIKE_OTHERS, middle * LIKE_OTHERS), UNITS[name], like=middle)
    return f"{name} {value:g}: other fruit of the batch have about {middle:.4g}{slip}"


def _together(measurements: Mapping[str, float], kind: PlausibleRange) -> Iterator[str]:
    """Height against diameter, and the density that mass, height and diameter make, an ellipsoid's."""
    height, diameter, mass = (measurements.get(name) for name in ("height_mm", "diameter_mm", "mass_g"))
    most = FLATTER * kind.body.longest_over_shortest
    limits = kind.ranges.density_g_per_cm3
    if limits is None:
        return
    if height is not None and diameter is not None and not 1 / most <= height / diameter <= most:
        yield (
            f"height_mm {height:g} and diameter_mm {diameter:g}: no {kind.name} has a ratio of "
            f"{most:.2g} or more between the two; is one of them in another unit?"
        )
        return
    if mass is None or (height is None and diameter is None):
        return
    # What is not measured lies between the flattest and the longest fruit.
    if height is not None and diameter is not None:
        least = greatest = math.pi / 6000 * height * diameter**2
    elif height is not None:
        least, greatest = (math.pi / 6000 * height**3 * share for share in (1 / most**2, most**2))
    else:
        least, greatest = (math.pi / 6000 * float(diameter or 0) ** 3 * share for share in (1 / most, most))
    if mass / least < limits[0] or mass / greatest > limits[1]:
        if diameter is not None and height is not None and _swapped(mass, diameter, height, kind, limits):
            yield f"diameter_mm {diameter:g} and mass_g {mass:g}: are the two swapped?"
            return
        if diameter is not None and height is not None and _swapped(mass, height, diameter, kind, limits):
            yield f"height_mm {height:g} and mass_g {mass:g}: are the two swapped?"
            return
        said = ", ".join(f"{name} {value:g}" for name, value in measurements.items() if name not in HARDNESS)
        density = mass / least if mass / least < limits[0] else mass / greatest
        yield (
            f"{said}: together they give a density of {density:.2g} g per cm3, but {kind.a_fruit} has "
            f"{limits[0]:g} to {limits[1]:g}. Check both for typing errors and units."
        )


def _swapped(
    mass: float, size: float, other: float, kind: PlausibleRange, limits: tuple[float, float]
) -> bool:
    """Whether the fruit can be, had mass and `size` been written in each other's column."""
    sizes, masses = kind.ranges.diameter_mm, kind.ranges.mass_g
    if sizes is None or masses is None or not (_within(mass, sizes) and _within(size, masses)):
        return False
    near = 1 / SAME_FRUIT < mass / other < SAME_FRUIT
    return near and _within(size * 6000 / math.pi / (mass * mass * other), limits)


def _spread(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
