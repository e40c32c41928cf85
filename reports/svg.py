"""A few SVG primitives for charts inside a page: elements, linear scales, axes.

The SVG has no ids, no styles of its own and no scripts: any number of charts share a page without
clashing, the page's style sheet colours them, and text stays text that can be found and read aloud.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from reports.language import decimals as with_comma


def element(name: str, *children: Markup | str, **attributes: object) -> Markup:
    """One element, its text and attribute values escaped; ``text_anchor`` is written text-anchor.

    >>> str(element("text", "a < b", x=1.25, class_="tick"))
    '<text x="1.2" class="tick">a &lt; b</text>'
    """
    head = [name]
    for key, value in attributes.items():
        written = f"{value:.1f}" if isinstance(value, float) else str(value)
        head.append(f'{key.rstrip("_").replace("_", "-")}="{escape(written)}"')
    inside = Markup("").join(children)
    return Markup(f"<{' '.join(head)}>{inside}</{name}>")


def drawing(*children: Markup, width: float, height: float, title: str, description: str) -> Markup:
    """A whole chart, announced to screen readers by its title and description."""
    return element(
        "svg",
        element("title", title),
        element("desc", description),
        *children,
        viewBox=f"0 0 {width:.0f} {height:.0f}",
        width=f"{width:.0f}",
        height=f"{height:.0f}",
        role="img",
        aria_label=f"{title}. {description}",
        class_="chart",
    )


@dataclass(frozen=True, kw_only=True)
class AxisScale:
    """Linear map of values onto pixels: px = start + (value - lowest) (end - start) / (highest - lowest)."""

    lowest: float
    highest: float
    start_px: float
    end_px: float

    def __call__(self, value: float) -> float:
        """Pixel of a value."""
        share = (value - self.lowest) / (self.highest - self.lowest)
        return self.start_px + share * (self.end_px - self.start_px)


def ticks(lowest: float, highest: float, *, at_most: int) -> tuple[float, ...]:
    """Round values (steps of 1, 2 or 5 times a power of ten) inside the interval, at most so many.

    >>> ticks(0.0, 0.93, at_most=6)
    (0.0, 0.2, 0.4, 0.6, 0.8)
    """
    span = highest - lowest
    power = math.floor(math.log10(span / at_most))
    for factor in (1, 2, 5, 10, 20, 50):
        step = factor * 10.0**power
        first, last = math.ceil(lowest / step - 1e-9), math.floor(highest / step + 1e-9)
        if last - first + 1 <= at_most:
            break
    return tuple(float(f"{k * step:.12g}") for k in range(first, last + 1))


def padded(values: Iterable[float], *, from_zero: bool = False) -> tuple[float, float]:
    """Axis limits that hold all finite values with a little air; never empty."""
    finite = [value for value in values if math.isfinite(value)] or [0.0, 1.0]
    lowest, highest = min(finite), max(finite)
    if from_zero:
        lowest = min(lowest, 0.0)
    air = 0.06 * (highest - lowest) or 0.5 * abs(highest) or 0.5
    return (lowest if from_zero and lowest == 0.0 else lowest - air, highest + air)


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A drawn area between edges in px, and the values at them: of x left and right, of y below and above."""

    x_limits: tuple[float, float]
    y_limits: tuple[float, float]
    left: float
    right: float
    top: float
    bottom: float

    @property
    def x(self) -> AxisScale:
        """Values on pixels from left to right."""
        low, high = self.x_limits
        return AxisScale(lowest=low, highest=high, start_px=self.left, end_px=self.right)

    @property
    def y(self) -> AxisScale:
        """Values on pixels from the lower edge to the upper."""
        low, high = self.y_limits
        return AxisScale(lowest=low, highest=high, start_px=self.bottom, end_px=self.top)

    def axis_x(self, words: str, *, at_most: int = 7) -> Markup:
        """Grid lines, at most so many tick labels and the label of the horizontal axis."""
        scale, parts, lines = self.x, [], ""
        for value in ticks(*self.x_limits, at_most=at_most):
            x = scale(value)
            lines += f"M{x:.1f} {self.top:.1f}V{self.bottom:.1f}"
            parts.append(label(with_comma(f"{value:g}"), x, self.bottom + 16, anchor="middle", class_="tick"))
        middle = (self.left + self.right) / 2
        name = label(words, middle, self.bottom + 35, anchor="middle", class_="axis")
        base = rule(self.left, self.right, self.bottom, self.bottom, class_="base")
        return Markup("").join([element("path", d=lines, class_="grid"), *parts, name, base])

    def axis_y(self, words: str, *, at_most: int = 6, above: float = 12.0) -> Markup:
        """Grid lines, at most so many tick labels and, so many px above, the label of the vertical axis."""
        scale, parts, lines = self.y, [], ""
        for value in ticks(*self.y_limits, at_most=at_most):
            y = scale(value)
            lines += f"M{self.left:.1f} {y:.1f}H{self.right:.1f}"
            parts.append(label(with_comma(f"{value:g}"), self.left - 7, y + 4, anchor="end", class_="tick"))
        name = label(words, 4.0, self.top - above, anchor="start", class_="axis")
        return Markup("").join([element("path", d=lines, class_="grid"), *parts, name])

    def line(self, across: np.ndarray, up: np.ndarray, *, class_: str) -> Markup:
        """A line through the points that are finite."""
        finite = np.isfinite(across) & np.isfinite(up)
        return polyline([*map(self.x, across[finite])], [*map(self.y, up[finite])], class_=class_)


def label(words: str, x: float, y: float, *, anchor: str = "", class_: str = "label") -> Markup:
    """Text at a place; `anchor`: "start", "middle" or "end"."""
    how = {"text_anchor": anchor} if anchor else {}
    return element("text", words, x=x, y=y, **how, class_=class_)


def rule(x1: float, x2: float, y1: float, y2: float, *, class_: str, title: str = "") -> Markup:
    """A straight line, told by its title."""
    said = [element("title", title)] if title else []
    return element("line", *said, x1=x1, x2=x2, y1=y1, y2=y2, class_=class_)


def marker(shape: str, x: float, y: float, *, size: float = 5.0, class_: str = "") -> Markup:
    """A mark of one of the shapes circle, square, diamond, triangle, down, centred on (x, y)."""
    paint = {"class_": f"mark {class_}".strip()}
    if shape == "circle":
        return element("circle", cx=x, cy=y, r=size, **paint)
    corners = {
        "square": ((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)),
        "diamond": ((0.0, -1.3), (1.3, 0.0), (0.0, 1.3), (-1.3, 0.0)),
        "triangle": ((0.0, -1.2), (1.15, 0.9), (-1.15, 0.9)),
        "down": ((0.0, 1.2), (1.15, -0.9), (-1.15, -0.9)),
    }[shape]
    points = " ".join(f"{x + size * dx:.1f},{y + size * dy:.1f}" for dx, dy in corners)
    return element("polygon", points=points, **paint)


def class_mark(colour: str, shape: str) -> Markup:
    """The mark of a class in a line of text."""
    mark = marker(shape, 7.0, 7.0, size=4.6, class_=colour)
    return element("svg", mark, viewBox="0 0 14 14", class_="dot", aria_hidden="true")


def error_bar(scale: AxisScale, value: float, sd: float | None, at: float, *, class_: str = "") -> Markup:
    """Whiskers of one standard deviation each way, upright at x, if known."""
    if sd is None or not math.isfinite(sd):
        return Markup("")
    low, high = scale(max(value - sd, scale.lowest)), scale(min(value + sd, scale.highest))
    path = f"M{at - 4:.1f},{low:.1f}h8M{at:.1f},{low:.1f}V{high:.1f}M{at - 4:.1f},{high:.1f}h8"
    return element("path", d=path, class_=f"whisker {class_}".strip())


def polyline(xs: list[float], ys: list[float], *, class_: str) -> Markup:
    """A line through the pixels given."""
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(xs, ys, strict=True))
    return element("polyline", points=points, class_=class_)
