"""Sheets that a marker mat can be printed on."""

from enum import StrEnum


class Paper(StrEnum):
    """Name of a sheet."""

    A4 = "a4"
    LETTER = "letter"

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height (ISO 216, ANSI/ASME Y14.1)."""
        return (210.0, 297.0) if self is Paper.A4 else (215.9, 279.4)
