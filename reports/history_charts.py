"""The chart of a lot: moduli over days, the fitted softening with its band, and the limits of classes."""

from __future__ import annotations

from datetime import date, timedelta

import numpy as np
from markupsafe import Markup

from reports.history_entries import GroupEntry, SeriesEntry
from reports.palette import class_marks
from reports.svg import Plot, drawing, element, label, marker, padded, rule, ticks
from reports.words import number

_MOST_SINGLE = 400
"""Fruit of a day that are drawn one by one: beyond it marks run together."""
_LEGEND = 20
"""Characters of a lot's name in a legend: 130 px."""


def softening_chart(series: SeriesEntry, *, width_px: int) -> Markup:
    """Single fruit as small marks, each day's mean with its interval, the law's line and band, limits dashed.

    ``width_px`` is the width at which text has its natural size.
    """
    first = series.days[0].day
    at_days = [float((day.day - first).days) for day in series.days]
    law = series.softening
    ends = [*at_days, *([] if law is None else [float(law.day[-1])])]
    air = max(0.04 * (max(ends) - min(ends)), 0.5)
    values = [value for day in series.days for value in (*day.single_E_MPa, day.E_high_MPa)]
    near = [limit.E_max_MPa for limit in series.limits if limit.E_max_MPa < 1.4 * max(values)]
    low, high = padded([*values, *near], from_zero=True)
    plot = Plot(
        x_limits=(min(ends) - air, max(ends) + air),
        y_limits=(max(low, 0.0), high),
        left=52.0,
        right=width_px - 14.0,
        top=34.0,
        bottom=260.0,
    )
    x, y = plot.x, plot.y
    parts = [plot.axis_y("E, modulus of the flesh (MPa)")]
    if law is not None:
        edges = [*zip(law.day, np.minimum(law.E_high_MPa, high), strict=True)]
        edges += [*zip(law.day, law.E_low_MPa, strict=True)][::-1]
        band = " ".join(f"{x(float(day)):.1f},{y(float(E)):.1f}" for day, E in edges)
        parts.append(element("polygon", points=band, class_="band"))
        parts.append(plot.line(law.day, np.minimum(law.E_MPa, high), class_="model pad0"))
    for limit in series.limits:
        if limit.E_max_MPa <= high:
            title, height = f"{limit.name}: up to {limit.E_max_MPa:g} MPa", y(limit.E_max_MPa)
            parts.append(rule(plot.left, plot.right, height, height, class_="limit", title=title))
            parts.append(label(limit.name, plot.right, height - 5, anchor="end", class_="tick"))
    for at, day in zip(at_days, series.days, strict=True):
        parts += [
            marker("circle", x(at), y(E), size=2.2, class_="single") for E in day.single_E_MPa[:_MOST_SINGLE]
        ]
        words = (
            f"{day.day}: mean {number(day.E_MPa)} MPa ({number(day.E_low_MPa)} to "
            f"{number(day.E_high_MPa)}, 90 %) of {day.fruit} fruit"
        )
        bar = rule(x(at), x(at), y(day.E_low_MPa), y(day.E_high_MPa), class_="whisker")
        parts.append(element("g", element("title", words), bar, marker("diamond", x(at), y(day.E_MPa))))
    said = "; ".join(f"{day.day} {number(day.E_MPa)} MPa of {day.fruit} fruit" for day in series.days[-10:])
    return drawing(
        *parts,
        _date_axis(first, plot, at_most=max(2, width_px // 110)),
        width=float(width_px),
        height=plot.bottom + 30.0,
        title=f"Modulus over days, {series.name}",
        description=f"Means of the last days: {said}",
    )


def lots_chart(group: GroupEntry, *, width_px: int) -> Markup:
    """The days' means of every lot of a cultivar, joined, each lot with its colour and shape."""
    series = group.series
    first = min(lot.days[0].day for lot in series)
    values = [day.E_MPa for lot in series for day in lot.days]
    spans = [(day.day - first).days for lot in series for day in lot.days]
    air = max(0.04 * max(spans), 0.5)
    low, high = padded(values, from_zero=True)
    rows = 1 + (len(series) - 1) // max(1, width_px // 150)
    plot = Plot(
        x_limits=(min(spans) - air, max(spans) + air),
        y_limits=(max(low, 0.0), high),
        left=52.0,
        right=width_px - 14.0,
        top=34.0 + 18.0 * rows,
        bottom=260.0 + 18.0 * rows,
    )
    parts = [plot.axis_y("E, mean of each day (MPa)")]
    marks = class_marks(tuple(lot.name for lot in series))
    for k, lot in enumerate(series):
        colour, shape = marks[lot.name]
        places = [(plot.x(float((day.day - first).days)), plot.y(day.E_MPa)) for day in lot.days]
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        line = element("polyline", points=points, class_=f"lot {colour}")
        means = [marker(shape, x, y, size=4.0, class_=colour) for x, y in places]
        parts.append(element("g", element("title", lot.name), line, *means))
        across, down = k % max(1, width_px // 150), k // max(1, width_px // 150)
        x, y = 12.0 + 150.0 * across, 12.0 + 18.0 * down
        parts += [marker(shape, x, y, size=4.0, class_=colour)]
        parts += [label((lot.lot or "without a lot")[:_LEGEND], x + 10, y + 4, class_="tick")]
    last = "; ".join(f"{lot.name}: {number(lot.days[-1].E_MPa)} MPa on {lot.days[-1].day}" for lot in series)
    return drawing(
        *parts,
        _date_axis(first, plot, at_most=max(2, width_px // 150)),
        width=float(width_px),
        height=plot.bottom + 30.0,
        title=f"Lots of {group.name} over days",
        description=f"Means of the last days: {last}",
    )


def _date_axis(first: date, plot: Plot, *, at_most: int) -> Markup:
    """Whole days as dates below the chart."""
    parts = [rule(plot.left, plot.right, plot.bottom, plot.bottom, class_="base")]
    for day in ticks(*plot.x_limits, at_most=at_most):
        if day != round(day):
            continue
        x = plot.x(day)
        anchor = "start" if x < plot.left + 35 else "end" if x > plot.right - 35 else "middle"
        words = f"{first + timedelta(days=round(day)):%Y-%m-%d}"
        parts.append(label(words, x, plot.bottom + 18, anchor=anchor, class_="tick"))
        parts.append(rule(x, x, plot.bottom, plot.bottom + 4, class_="base"))
    return Markup("").join(parts)
