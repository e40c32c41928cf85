"""Colour and shape of each maturity class; classes differ in hue, in lightness and in shape.

Colours are names in static/palette.css, which defines them for light and dark pages. They run from red
(softest) to blue (firmest), at least 3:1 against the page (WCAG 2.2, 1.4.11, non-text contrast). Readers need
not distinguish red from green.
"""

from __future__ import annotations

from collections.abc import Iterable

from markupsafe import Markup

from reports.language import say
from reports.messages import message
from reports.skin_layer import PADS

_SOFT_TO_FIRM = ("c0", "c1", "c2", "c3", "c4")
_SHAPES = ("circle", "diamond", "square", "triangle", "down")
UNKNOWN = ("cx", "circle")
"""Colour and shape of a fruit without a class."""
_CORNERS = {
    "square": ((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)),
    "diamond": ((0.0, -1.3), (1.3, 0.0), (0.0, 1.3), (-1.3, 0.0)),
    "triangle": ((0.0, -1.2), (1.15, 0.9), (-1.15, 0.9)),
    "down": ((0.0, 1.2), (1.15, -0.9), (-1.15, -0.9)),
}
"""Corners of the shapes in units of their size; static/charts.js has the same."""


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


def class_mark(colour: str, shape: str) -> Markup:
    """The mark of a class as SVG for a line of text."""
    if shape == "circle":
        mark = Markup('<circle cx="7" cy="7" r="4.6" class="mark {}"></circle>').format(colour)
    else:
        points = " ".join(f"{7 + 4.6 * x:.1f},{7 + 4.6 * y:.1f}" for x, y in _CORNERS[shape])
        mark = Markup('<polygon points="{}" class="mark {}"></polygon>').format(points, colour)
    return Markup('<svg viewBox="0 0 14 14" class="dot" aria-hidden="true">{}</svg>').format(mark)


def pad_marks(pads: Iterable[str]) -> list[tuple[Markup, str]]:
    """The mark of each pad in pictures of the skin, and its name."""
    return [
        (class_mark(f"pad{k % len(PADS)}", "circle"), f"{say('pad')} {message(pad)}")
        for k, pad in enumerate(pads)
    ]
