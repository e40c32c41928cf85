"""A few SVG primitives for charts inside a page: elements, linear scales, axes.

The SVG has no ids, no styles of its own and no scripts: any number of charts share a page without
clashing, the page's style sheet colours them, and text stays text that can be found and read aloud.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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


def padded(values: list[float], *, from_zero: bool = False) -> tuple[float, float]:
    """Axis limits that hold all finite values with a little air; never empty."""
    finite = [value for value in values if math.isfinite(value)] or [0.0, 1.0]
    lowest, highest = min(finite), max(finite)
    if from_zero:
        lowest = min(lowest, 0.0)
    air = 0.06 * (highest - lowest) or 0.5 * abs(highest) or 0.5
    return (lowest if from_zero and lowest == 0.0 else lowest - air, highest + air)


def axis_x(scale: AxisScale, *, label: str, top: float, bottom: float, at_most: int) -> Markup:
    """Grid lines, tick labels and the label of a horizontal axis."""
    parts, lines = [], ""
    for value in ticks(scale.lowest, scale.highest, at_most=at_most):
        x = scale(value)
        lines += f"M{x:.1f} {top:.1f}V{bottom:.1f}"
        parts.append(
            element("text", with_comma(f"{value:g}"), x=x, y=bottom + 16, text_anchor="middle", class_="tick")
        )
    parts.insert(0, element("path", d=lines, class_="grid"))
    middle = (scale.start_px + scale.end_px) / 2
    parts.append(element("text", label, x=middle, y=bottom + 35, text_anchor="middle", class_="axis"))
    parts.append(element("line", x1=scale.start_px, x2=scale.end_px, y1=bottom, y2=bottom, class_="base"))
    return Markup("").join(parts)


def axis_y(scale: AxisScale, *, label: str, left: float, right: float, at_most: int) -> Markup:
    """Grid lines, tick labels and, above the axis, the label of a vertical axis."""
    parts, lines = [], ""
    for value in ticks(scale.lowest, scale.highest, at_most=at_most):
        y = scale(value)
        lines += f"M{left:.1f} {y:.1f}H{right:.1f}"
        parts.append(
            element("text", with_comma(f"{value:g}"), x=left - 7, y=y + 4, text_anchor="end", class_="tick")
        )
    parts.insert(0, element("path", d=lines, class_="grid"))
    parts.append(element("text", label, x=4.0, y=scale.end_px - 12, text_anchor="start", class_="axis"))
    return Markup("").join(parts)


def marker(shape: str, x: float, y: float, *, size: float = 5.0, class_: str = "", fill: str = "") -> Markup:
    """A mark of one of the shapes circle, square, diamond, triangle, down, centred on (x, y)."""
    paint = {"class_": f"mark {class_}".strip()} | ({"fill": fill} if fill else {})
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
    mark = marker(shape, 7.0, 7.0, size=4.6, fill=colour)
    return element("svg", mark, viewBox="0 0 14 14", class_="dot", aria_hidden="true")


def error_bar_x(scale: AxisScale, value: float, sd: float | None, y: float, *, class_: str = "") -> Markup:
    """Whiskers from one standard deviation below to one above; nothing where the deviation is not known."""
    if sd is None or not math.isfinite(sd):
        return Markup("")
    low, high = scale(max(value - sd, scale.lowest)), scale(min(value + sd, scale.highest))
    path = f"M{low:.1f},{y - 4:.1f}v8M{low:.1f},{y:.1f}H{high:.1f}M{high:.1f},{y - 4:.1f}v8"
    return element("path", d=path, class_=f"whisker {class_}".strip())


def error_bar_y(scale: AxisScale, value: float, sd: float | None, x: float, *, class_: str = "") -> Markup:
    """The same, upright: y pixels by ``scale`` at the given x."""
    if sd is None or not math.isfinite(sd):
        return Markup("")
    low, high = scale(max(value - sd, scale.lowest)), scale(min(value + sd, scale.highest))
    path = f"M{x - 4:.1f},{low:.1f}h8M{x:.1f},{low:.1f}V{high:.1f}M{x - 4:.1f},{high:.1f}h8"
    return element("path", d=path, class_=f"whisker {class_}".strip())


def polyline(xs: list[float], ys: list[float], *, class_: str) -> Markup:
    """A line through the pixels given."""
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(xs, ys, strict=True))
    return element("polyline", points=points, class_=class_)
