"""Reads with pint the unit in a text: a column's name, a row of units, an option. It also reports any text
beside the unit that may change its meaning.
"""

import functools
import re
import unicodedata
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pint

STANDARD_GRAVITY = 9.80665
"""m/s2: what turns a mass into a force (CGPM 1901)."""
FORCE, MASS, LENGTH, TIME = "a force", "a mass", "a length", "a time"
PRESSURE, VOLTAGE, RATIO = "a pressure or stress", "a voltage", "a ratio, an angle or a count"
QUANTITIES = {
    "time": ("s", TIME, 1.0, 1e-9, 86_400.0),
    "force": ("N", FORCE, 1.0, 1e-7, 1e4),
    "travel": ("mm", LENGTH, 1e3, 1e-7, 1e3),
    "gap": ("mm", LENGTH, 1e3, 1e-7, 1e3),
}
"""Our unit of each quantity, its kind, our units per SI unit, and the least and largest factor of any press.
These are ns to days, 0.1 uN to a tonne, and 0.1 nm to m. Outside of them pint misreads a header: `Mm` as a
megametre, `pct` as a picocarat."""
EXAMPLES = {
    "time": ("s", "ms", "min"),
    "force": ("N", "kN", "mN", "kgf", "gf", "lbf"),
    "travel": ("mm", "um", "cm", "in"),
    "gap": ("mm", "um", "cm", "in"),
}
"""Units that messages propose, our own first."""
_KINDS = {
    "second": TIME,
    "meter": LENGTH,
    "newton": FORCE,
    "kilogram": MASS,
    "pascal": PRESSURE,
    "volt": VOLTAGE,
    "radian": RATIO,
    "ampere": "a current",
    "meter/second": "a speed",
    "kelvin": "a temperature",
}
"""One unit of each kind that messages name; all others are of "another quantity"."""
_ALIASES = (
    "@alias second = sek = sekunde = sekunden = seconde = secondes = seg = segundo = segundos",
    "@alias minute = minuten = minuto = minutos",
    "@alias gram = gramm = gramme = grammes = gramo = gramos",
    "@alias inch = zoll = pouce = pouces",
    "@alias force_kilogram = kp = kilopond",
)
"""Names in German, French and Spanish exports that pint lacks."""
_MEANT = {'"': "inch", "''": "inch", "′′": "inch", "”": "inch", "mil": "thou", "mils": "thou"}
"""Marks for inches, and `mil` as a length (pint: an angle)."""
_AMBIGUOUS = {"gr": "may be a grain or a gram"}
_PLAIN = re.compile(r"[^\W\d_]{1,20}|%|°[CFK]")
_COMPOUND = re.compile(r"[^\W\d_]{1,12}[23]?(?:[*/·. ]?\^?[^\W\d_]{1,12}[23]?){1,2}")
_IN_BRACKETS = re.compile(r"[(\[{]\s*([^()\[\]{}]+?)\s*[)\]}]")
_AT_END = re.compile(r"(?:[_/,]\s*|\bin\s+|\s)([^\W\d_]{1,12})\.?$")
_ONE_LETTER = "smgN"
"""Units of one letter at the end of a name without brackets; other letters are axes and channels there."""
_NO_FORCE_OR_LENGTH = frozenset({PRESSURE, VOLTAGE, RATIO})
"""Quantities that a column with a similar name may contain in place of a force or travel."""
_FACTOR = re.compile(
    r"(?:(?<![^\W_])[x×✕]|[*·∙⋅÷/^])\s*\d+|\d+\s*(?:[x×✕](?![^\W_])|[*·∙⋅^])"  # x 10, /10, 10x, 10^3
    r"|\d[⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁻]|\d[eE][+-]?\d|(?<![\w.,])(?:10+|0[.,]\d+)\s*$"  # 10³, 1e3, 1000 before the unit
)
"""A multiplication or division. Other numbers identify a channel or cell."""


@dataclass(frozen=True, kw_only=True)
class Unit:
    """`factor`: to s, N or mm. `of_mass`: the unit is a mass, the factor its weight at standard gravity."""

    text: str
    factor: float
    of_mass: bool = False


@dataclass(frozen=True, kw_only=True)
class NoUnit:
    """A text that is no unit of the quantity, and `why`. `other`: the kind of quantity that it measures.
    `open`: it has a unit, but also a factor or a second unit, so that only the user can decide.
    """

    text: str
    why: str
    other: str | None = None
    open: bool = False


def read_unit(text: str, quantity: str) -> Unit | NoUnit:
    """The unit of a quantity (a key of QUANTITIES) in `text`, with or without brackets.

    Capitals matter only if they decide (mN, MN).

    >>> read_unit("KN", "force"), read_unit("[µm]", "travel").factor
    (Unit(text='KN', factor=1000.0, of_mass=False), 0.001)
    >>> read_unit("MPa", "force").why
    'is a pressure or stress, not a force'
    """
    ours, kind, ours_per_SI, least, most = QUANTITIES[quantity]
    shown = unicodedata.normalize("NFKC", text).replace("μ", "µ").strip("[](){} \t").rstrip(".")
    if shown == ours:
        return Unit(text=ours, factor=1.0)
    if shown in _AMBIGUOUS:
        return NoUnit(text=shown, why=_AMBIGUOUS[shown])
    other: str | None = None
    for spelt in _spellings(_MEANT.get(shown, shown)):
        dimension, of_SI = _parsed(spelt)
        of_mass = kind == FORCE and dimension == MASS
        if dimension == kind or of_mass:
            factor = of_SI * ours_per_SI * (STANDARD_GRAVITY if of_mass else 1.0)
            if least <= factor * (1 + 1e-9) and factor <= most * (1 + 1e-9):
                return Unit(text=shown, factor=float(f"{factor:.12g}"), of_mass=of_mass)
            return NoUnit(text=shown, why=f"would be {factor:.3g} {ours}, which no press has")
        other = other or dimension
    if other is None:
        return NoUnit(text=shown, why="is no unit that is known")
    return NoUnit(text=shown, why=f"is {other}, not {kind}", other=other)


def is_unit(cell: str) -> bool:
    """Whether a cell is only a unit, of any quantity, or any text in brackets.

    >>> is_unit("(lbf)"), is_unit("sec"), is_unit("Force")
    (True, True, False)
    """
    text = cell.strip()
    if re.fullmatch(r"[\[({][^\])}]*[\])}]", text):
        return True
    return any(_parsed(spelt)[0] is not None for spelt in _spellings(_MEANT.get(text, text)))


def _spellings(plain: str) -> tuple[str, ...]:
    """The text as written, with newton's capital, and in small letters: `KN`, `Sec`, `LBF`, `MM`."""
    low = plain.lower()
    newton = [f"{low[:-1]}N"] if low in ("n", "kn", "mn", "cn", "dan") else []
    return tuple(dict.fromkeys([plain, *newton, low]))


@functools.lru_cache(maxsize=1000)
def _parsed(text: str) -> tuple[str | None, float]:
    """The kind of pint's unit and its factor to SI; None if it is no unit. pint evaluates nothing else."""
    if not (_PLAIN.fullmatch(text) or _COMPOUND.fullmatch(text)):
        return None, 0.0
    registry = _registry()
    try:
        unit = registry.parse_units(text)
        kinds = [kind for dimension, kind in _KINDS.items() if unit.is_compatible_with(dimension)]
        factor = float(registry.Quantity(1.0, unit).to_base_units().magnitude)
    except Exception:  # noqa: BLE001  pint raises more kinds than it documents for texts that are no unit
        return None, 0.0
    return (kinds[0] if kinds else "of another quantity"), factor


@functools.cache
def _registry() -> "pint.UnitRegistry":
    import pint  # takes a second: only for units that are not ours

    registry: pint.UnitRegistry = pint.UnitRegistry()
    for alias in _ALIASES:
        registry.define(alias)
    return registry


def unit_of_name(name: str, quantity: str) -> Unit | NoUnit | None:
    """The unit that a column's name states at its end, with or without brackets; None if it states none.

    A word at the end without brackets counts only if it is a unit of the quantity, or of pressure, voltage or
    ratio. A unit is open (`NoUnit.open`) if text follows the brackets, or with a second unit or a factor.

    >>> unit_of_name("Normal force (kN)", "force").factor, unit_of_name("travel_in", "travel").factor
    (1000.0, 25.4)
    >>> unit_of_name("Pos", "travel"), unit_of_name("Load (%)", "force").why
    (None, 'is a ratio, an angle or a count, not a force')
    >>> unit_of_name("Load cell 2 (N)", "force").text, unit_of_name("Force (N) x 10", "force").open
    ('N', True)
    """
    name = name.strip()
    brackets = list(_IN_BRACKETS.finditer(name))
    if not brackets:
        return _at_end(name, quantity)
    unit = read_unit(brackets[-1][1], quantity)
    if isinstance(unit, NoUnit) and unit.other is not None:
        return unit
    text = name[: brackets[0].start()].strip().removesuffix(" in")
    before = _at_end(text, quantity)
    if isinstance(before, Unit) and isinstance(unit, Unit) and before.factor != unit.factor:
        return _open(name, "has a second unit beside it")
    if len(brackets) > 1 or brackets[-1].end() < len(name):
        return _open(name, "has more than its unit at its end")
    return with_factor(text) or with_factor(brackets[-1][1]) or unit


def with_factor(text: str) -> NoUnit | None:
    """The open unit of a text that multiplies or divides; None for other texts."""
    factor = _FACTOR.search(text)
    return None if factor is None else _open(text, f'has a factor beside it ("{factor[0].strip()}")')


def _at_end(name: str, quantity: str) -> Unit | NoUnit | None:
    end = _AT_END.search(name)
    if end is None or (len(end[1]) == 1 and end[1] not in (*_ONE_LETTER, "V")):
        return with_factor(name)
    unit = read_unit(end[1], quantity)
    if isinstance(unit, Unit):
        return with_factor(name[: end.start(1)]) or unit
    return unit if unit.other in _NO_FORCE_OR_LENGTH else None


def _open(name: str, why: str) -> NoUnit:
    return NoUnit(text=unicodedata.normalize("NFC", name.strip())[:60], why=why, open=True)
