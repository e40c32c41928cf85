"""Colour and shape of each maturity class: apart in hue, in lightness and in shape.

The colours run from dark red (softest) to dark blue (firmest). Their lightness is at least 3:1 against
white (WCAG 2.2, 1.4.11, non-text contrast), and none rests on telling red from green.
"""

from __future__ import annotations

_SOFT_TO_FIRM = ("#9d0b3f", "#d1495b", "#b87400", "#3c8dbc", "#1d4e89")
_SHAPES = ("circle", "diamond", "square", "triangle", "down")
UNKNOWN = ("#5c6470", "circle")
"""Colour and shape of a fruit without a class."""


def class_marks(names: tuple[str, ...]) -> dict[str, tuple[str, str]]:
    """Colour and shape of each class, named softest first; more than five classes share neighbours' colours.

    >>> class_marks(("ripe", "firm"))
    {'ripe': ('#9d0b3f', 'circle'), 'firm': ('#1d4e89', 'diamond')}
    """
    last = max(len(names) - 1, 1)
    return {
        name: (_SOFT_TO_FIRM[round(k * (len(_SOFT_TO_FIRM) - 1) / last)], _SHAPES[k % len(_SHAPES)])
        for k, name in enumerate(names)
    }
