"""Which of an effect's ways to show a signature is: typed, with the label that people read derived from it.

A start value is rounded, so that the last bits of a machine's arithmetic do not send the search another way.
"""

from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, kw_only=True)
class OneWay:
    """The effect shows in one way only."""

    @property
    def label(self) -> str:
        """Empty."""
        return ""


@dataclass(frozen=True, kw_only=True)
class OfPad:
    """One pad has the effect."""

    pad: str

    @property
    def label(self) -> str:
        """The pad's name."""
        return self.pad


@dataclass(frozen=True, kw_only=True)
class AtValue:
    """The effect with one of its parameters at a value, from which the search starts."""

    symbol: str
    value: float
    unit: str = ""

    @property
    def label(self) -> str:
        """Such as "tau 1 s"."""
        return f"{self.symbol} {self.value:g}{f' {self.unit}' if self.unit else ''}"


@dataclass(frozen=True, kw_only=True)
class AtGap:
    """A gap about the pit, from which the search starts; whether the pit turns in it."""

    gap_mm: float
    pit_turns: bool

    @property
    def label(self) -> str:
        """Such as "gap 0.1 mm, pit turns"."""
        return f"gap {self.gap_mm:g} mm, pit {'turns' if self.pit_turns else 'does not turn'}"


@dataclass(frozen=True, kw_only=True)
class AtPlace:
    """The effect in a ball somewhere in the flesh, fruit frame."""

    centre_mm: tuple[float, float, float]
    radius_mm: float

    @property
    def label(self) -> str:
        """Centre and radius."""
        x, y, z = self.centre_mm
        return f"{x:.2f} {y:.2f} {z:.2f} radius {self.radius_mm:.2f} mm"


Variant: TypeAlias = OneWay | OfPad | AtValue | AtGap | AtPlace
ONE_WAY = OneWay()


def pad_of(variant: Variant) -> str:
    """The pad; raises TypeError where the variant is not a pad's."""
    if not isinstance(variant, OfPad):
        raise TypeError(f"{variant!r} is no variant of a pad")
    return variant.pad


def value_of(variant: Variant) -> float:
    """The value; raises TypeError where the variant is not at one."""
    if not isinstance(variant, AtValue):
        raise TypeError(f"{variant!r} is no variant at a value")
    return variant.value


def gap_of(variant: Variant) -> AtGap:
    """The gap; raises TypeError where the variant is none."""
    if not isinstance(variant, AtGap):
        raise TypeError(f"{variant!r} is no gap about a pit")
    return variant


def significant(value: float, digits: int) -> float:
    """Rounded to so many significant digits.

    >>> significant(0.0012345, 3)
    0.00123
    """
    return float(f"{value:.{digits}g}")
