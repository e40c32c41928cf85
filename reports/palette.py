"""Colour and shape of each maturity class: apart in hue, in lightness and in shape.

Colours are names in static/palette.css, which has them for light and dark pages. They run from red (softest)
to blue (firmest), at least 3:1 against the page (WCAG 2.2, 1.4.11, non-text contrast). None rests on telling
red from green.
"""

from __future__ import annotations

_SOFT_TO_FIRM = ("c0", "c1", "c2", "c3", "c4")
_SHAPES = ("circle", "diamond", "square", "triangle", "down")
UNKNOWN = ("cx", "circle")
"""Colour and shape of a fruit without a class."""


def class_marks(names: tuple[str, ...]) -> dict[str, tuple[str, str]]:
    """Colour and shape of each class, named softest first; more than five classes share neighbours' colours.

    >>> class_marks(("ripe", "firm"))
    {'ripe': ('c0', 'circle'), 'firm': ('c4', 'diamond')}
    """
    last = max(len(names) - 1, 1)
    return {
        name: (_SOFT_TO_FIRM[round(k * (len(_SOFT_TO_FIRM) - 1) / last)], _SHAPES[k % len(_SHAPES)])
        for k, name in enumerate(names)
    }
