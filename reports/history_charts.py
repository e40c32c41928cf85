"""The chart of a lot: moduli over days, the fitted softening with its band, and the limits of classes."""

from __future__ import annotations

from datetime import timedelta

from markupsafe import Markup

from reports.history_entries import SeriesEntry
from reports.svg import AxisScale, axis_y, drawing, element, marker, padded, polyline, ticks
from reports.words import number

_LEFT, _TOP, _BOTTOM = 52.0, 34.0, 260.0
"""Edges of the drawn area, px: room for labels."""
_MOST_SINGLE = 400
"""Fruit of a day that are drawn one by one: beyond it marks run together."""


def softening_chart(series: SeriesEntry, *, width_px: int) -> Markup:
    """Single fruit as small marks, each day's mean with its interval, the law's line and band, limits dashed.

    ``width_px`` is the width at which text has its natural size.
    """
    first = series.days[0].day
    at_days = [float((day.day - first).days) for day in series.days]
    law = series.softening
    right = width_px - 14.0
    ends = [*at_days, *([] if law is None else [float(law.day[-1])])]
    x = _scale(min(ends), max(ends), _LEFT, right)
    values = [value for day in series.days for value in (*day.single_E_MPa, day.E_high_MPa)]
    near = [one.E_max_MPa for one in series.limits if one.E_max_MPa < 1.4 * max(values)]
    low, high = padded([*values, *near], from_zero=True)
    y = AxisScale(lowest=max(low, 0.0), highest=high, start_px=_BOTTOM, end_px=_TOP)
    parts = [axis_y(y, label="E, modulus of the flesh (MPa)", left=_LEFT, right=right, at_most=6)]
    if law is not None:
        top = [min(float(value), high) for value in law.E_high_MPa]
        across = [x(float(day)) for day in law.day]
        band = [*zip(across, map(y, top), strict=True)]
        band += [*zip(across, (y(float(value)) for value in law.E_low_MPa), strict=True)][::-1]
        parts.append(
            element("polygon", points=" ".join(f"{px:.1f},{py:.1f}" for px, py in band), class_="band")
        )
        heights = [y(min(float(value), high)) for value in law.E_MPa]
        parts.append(polyline(across, heights, class_="model pad0"))
    for limit in series.limits:
        if limit.E_max_MPa <= high:
            title = element("title", f"{limit.name}: up to {limit.E_max_MPa:g} MPa")
            height = y(limit.E_max_MPa)
            parts.append(element("line", title, x1=_LEFT, x2=right, y1=height, y2=height, class_="limit"))
            parts.append(element("text", limit.name, x=right, y=height - 5, text_anchor="end", class_="tick"))
    for at, day in zip(at_days, series.days, strict=True):
        parts += [
            marker("circle", x(at), y(E), size=2.2, class_="single") for E in day.single_E_MPa[:_MOST_SINGLE]
        ]
        words = (
            f"{day.day}: mean {number(day.E_MPa)} MPa ({number(day.E_low_MPa)} to "
            f"{number(day.E_high_MPa)}, 90 %) of {day.fruit} fruit"
        )
        bar = element("line", x1=x(at), x2=x(at), y1=y(day.E_low_MPa), y2=y(day.E_high_MPa), class_="whisker")
        parts.append(element("g", element("title", words), bar, marker("diamond", x(at), y(day.E_MPa))))
    parts.append(_date_axis(series, x, width_px))
    said = "; ".join(f"{day.day} {number(day.E_MPa)} MPa of {day.fruit} fruit" for day in series.days[-10:])
    return drawing(
        *parts,
        width=float(width_px),
        height=_BOTTOM + 30.0,
        title=f"Modulus over days, {series.name}",
        description=f"Means of the last days: {said}",
    )


def _scale(low: float, high: float, start_px: float, end_px: float) -> AxisScale:
    """Days on pixels, half a day of air on either side."""
    air = max(0.04 * (high - low), 0.5)
    return AxisScale(lowest=low - air, highest=high + air, start_px=start_px, end_px=end_px)


def _date_axis(series: SeriesEntry, x: AxisScale, width_px: int) -> Markup:
    """Whole days as dates below the chart."""
    first = series.days[0].day
    at_most = max(2, width_px // 110)
    days = [day for day in ticks(x.lowest, x.highest, at_most=at_most) if day == round(day)]
    parts = [element("line", x1=x.start_px, x2=x.end_px, y1=_BOTTOM, y2=_BOTTOM, class_="base")]
    for day in days:
        label = f"{first + timedelta(days=round(day)):%Y-%m-%d}"
        anchor = "start" if x(day) < x.start_px + 35 else "end" if x(day) > x.end_px - 35 else "middle"
        parts.append(element("text", label, x=x(day), y=_BOTTOM + 18, text_anchor=anchor, class_="tick"))
        parts.append(element("line", x1=x(day), x2=x(day), y1=_BOTTOM, y2=_BOTTOM + 4, class_="base"))
    return Markup("").join(parts)
