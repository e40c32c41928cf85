"""The unit that a column's name states, and whether something beside it may change what it means."""

import math
import re
import unicodedata

from tactile.io.stated_unit import PRESSURE, RATIO, VOLTAGE, NoUnit, Unit, is_unit, read_unit

_IN_BRACKETS = re.compile(r"[(\[{]\s*([^()\[\]{}]+?)\s*[)\]}]")
_AT_END = re.compile(r"(?:[_/,]\s*|\bin\s+|\s)([^\W\d_]{1,12})\.?$")
_ONE_LETTER = "smgN"
"""Units of one letter that a name may end in without brackets; others are axes and channels there."""
_NO_FORCE_OR_LENGTH = frozenset({PRESSURE, VOLTAGE, RATIO})
"""What a column of a like name may hold in place of a force or a travel."""
_NUMBER = r"(?:\d+(?:[.,]\d+)?)"
_TEN = r"(?:10+|1[ .,']000|0[.,]0*1)"
_FACTOR = re.compile(
    rf"(?<![^\W_])[x×✕]\s*(?!1(?![\d.,^e*])){_NUMBER}"  # x 10, (x1000); x1 changes nothing
    rf"|{_NUMBER}\s*[x×✕](?![^\W_])|[*·∙⋅÷/]\s*(?!1(?![\d.,^e*])){_NUMBER}"  # 10x, *1000, /10
    r"|10\s*(?:\^|\*\*|[⁺⁻]?[⁰¹²³⁴⁵⁶⁷⁸⁹])|(?<![\w.])\d+[eE][+-]?\d"  # 10^3, 10³, 1e3
    rf"|[(\[{{]\s*{_TEN}\s*[)\]}}]",  # (1000)
)
"""What multiplies or divides. A number alone is a channel's or a cell's."""
_TEN_BEFORE = re.compile(rf"(?<![\w.,]){_TEN}$")
_SHORT_WORD = re.compile(r"(?<![^\W\d_])[^\W\d_]{2,3}(?![^\W\d_])")


def unit_of_name(name: str, quantity: str) -> Unit | NoUnit | None:
    """The unit that a column's name states: in brackets, or at its end; None where it states none.

    What stands at the end without brackets is a unit only where it fits, or is plainly of another quantity.
    A second unit, a factor, or a number behind the unit leaves the unit open (`NoUnit.open`).

    >>> unit_of_name("Normal force (kN)", "force").factor, unit_of_name("travel_in", "travel").factor
    (1000.0, 25.4)
    >>> unit_of_name("Pos", "travel"), unit_of_name("Load (%)", "force").why
    (None, 'is a ratio, an angle or a count, not a force')
    >>> unit_of_name("Load cell 2 (N)", "force").text, unit_of_name("Force (N) x 10", "force").open
    ('N', True)
    """
    brackets = list(_IN_BRACKETS.finditer(name))
    if not brackets:
        return unit_with_factor(name) or _at_end(name, quantity)
    found = [(read_unit(one[1], quantity), one.end()) for one in brackets]
    unit, end = min(found, key=lambda one: (not isinstance(one[0], Unit), not _of_another(one[0])))
    if _of_another(unit):
        return unit
    units = [one for one, _ in found if isinstance(one, Unit)]
    if units and re.search(r"\d", name[end:]):
        return _open(name, "has a number behind it")
    over = re.match(r"\s*(?:/|per\b)\s*([^\W\d_]+)", name[end:])
    if over is not None and is_unit(over[1]):
        return _open(name, "is divided by another unit")
    return unit_with_factor(name) or _second_unit(name, quantity, units) or unit


def unit_with_factor(text: str) -> NoUnit | None:
    """An open unit where the text holds a factor: nobody can tell which way it was applied."""
    found = _FACTOR.search(text)
    return None if found is None else _open(text, f'has a factor beside it ("{found[0].strip()}")')


def _at_end(name: str, quantity: str) -> Unit | NoUnit | None:
    end = _AT_END.search(name.strip())
    if end is None or (len(end[1]) == 1 and end[1] not in (*_ONE_LETTER, "V")):
        return None
    unit = read_unit(end[1], quantity)
    if isinstance(unit, Unit):
        before = name.strip()[: end.start(1)]
        if _TEN_BEFORE.search(before.rstrip()):
            return _open(name, "has a number before it")
        return _second_unit(before, quantity, [unit]) or unit
    return unit if unit.other in _NO_FORCE_OR_LENGTH else None


def _second_unit(name: str, quantity: str, units: list[Unit]) -> NoUnit | None:
    """A unit of the same quantity and another size beside `units`, in brackets or as a short word."""
    words = [word for word in _SHORT_WORD.findall(_IN_BRACKETS.sub(" ", name)) if word.lower() != "in"]
    every = [*units, *(one for one in (read_unit(word, quantity) for word in words) if isinstance(one, Unit))]
    if all(math.isclose(one.factor, every[0].factor, rel_tol=1e-6) for one in every[1:]) or not units:
        return None
    return _open(name, "has a second unit beside it")


def _open(name: str, why: str) -> NoUnit:
    return NoUnit(text=unicodedata.normalize("NFC", name.strip())[:60], why=why, open=True)


def _of_another(unit: Unit | NoUnit) -> bool:
    return isinstance(unit, NoUnit) and unit.other is not None
