"""Charts of one fruit: force against travel of a grasp, and the modulus each grasp gave."""

from __future__ import annotations

import math

import numpy as np
from markupsafe import Markup

from reports.charts_batch import shortened
from reports.entries import ForceCurve, FruitEntry, GraspEstimate
from reports.svg import AxisScale, axis_x, axis_y, drawing, element, error_bar_x, marker, padded, polyline
from reports.words import number, with_sd

_MOST_POINTS = 80
"""Marks of one pad's curve: on a drawing 360 px wide more would lie less than 4 px apart."""
_PAD_MARKS = ("circle", "square", "circle", "square")
_PAD_DOTS = ("round", "cornered")


def force_chart(curves: tuple[ForceCurve, ...]) -> Markup:
    """Force against travel of the pads of one grasp: marks as recorded, a line for the fitted model."""
    known = [curve for curve in curves if np.isfinite(curve.travel_mm).any()]
    travels = [float(value) for curve in known for value in curve.travel_mm]
    forces = [float(value) for curve in known for value in curve.force_N]
    forces += [float(v) for c in known if c.model_force_N is not None for v in c.model_force_N]
    low_x, high_x = padded(travels, from_zero=True)
    low_y, high_y = padded(forces, from_zero=True)
    x = AxisScale(lowest=low_x, highest=high_x, start_px=44.0, end_px=348.0)
    y = AxisScale(lowest=low_y, highest=high_y, start_px=216.0, end_px=52.0)
    parts = [
        axis_x(x, label="travel since first touch (mm)", top=52.0, bottom=216.0, at_most=7),
        axis_y(y, label="force (N)", left=44.0, right=348.0, at_most=6),
    ]
    for k, curve in enumerate(known):
        parts.append(_pad(curve, k, x=x, y=y))
        parts.append(_legend_item(curve.pad, k, count=len(known)))
    grasp = curves[0].grasp if curves else ""
    return drawing(
        *parts,
        width=360.0,
        height=258.0,
        title=f"Force against travel, {grasp}",
        description="; ".join(
            f"pad {curve.pad}: peak force {number(float(np.nanmax(curve.force_N)))} N" for curve in known
        )
        or "No frames in contact",
    )


def _pad(curve: ForceCurve, k: int, *, x: AxisScale, y: AxisScale) -> Markup:
    """One pad's points of force over travel, and a line through them or of the model."""
    every = max(1, math.ceil(len(curve.travel_mm) / _MOST_POINTS))
    parts = []
    if curve.model_force_N is not None:
        parts += _lines(
            x, y, curve.travel_mm[::every], curve.model_force_N[::every], class_=f"model pad{k % 4}"
        )
    else:
        parts += _lines(x, y, curve.travel_mm[::every], curve.force_N[::every], class_=f"joined pad{k % 4}")
    points = zip(curve.travel_mm[::every], curve.force_N[::every], strict=True)
    dots = "".join(
        f"M{x(float(travel)):.1f} {y(float(force)):.1f}h0"
        for travel, force in points
        if math.isfinite(travel) and math.isfinite(force)
    )
    # a stroke without length is a round or square dot: a tenth of the bytes of an element for each
    parts.append(element("path", d=dots, class_=f"dots {_PAD_DOTS[k % 2]} pad{k % 4}"))
    return element("g", element("title", f"pad {curve.pad}"), *parts)


def _lines(x: AxisScale, y: AxisScale, travel: np.ndarray, force: np.ndarray, *, class_: str) -> list[Markup]:
    """Polylines through the finite stretches."""
    finite = np.isfinite(travel) & np.isfinite(force)
    breaks = np.flatnonzero(np.diff(finite.astype(int))) + 1
    return [
        polyline([x(float(v)) for v in travel[run]], [y(float(v)) for v in force[run]], class_=class_)
        for run in np.split(np.arange(len(travel)), breaks)
        if len(run) > 1 and finite[run[0]]
    ]


def _legend_item(pad: str, k: int, *, count: int) -> Markup:
    step = 300.0 / max(count, 1)
    at = 52.0 + step * k
    return element(
        "g",
        marker(_PAD_MARKS[k % len(_PAD_MARKS)], at, 14.0, size=3.4, class_=f"pad{k % 4}"),
        element("text", shortened(f"pad {pad}", px=step - 14), x=at + 10, y=18.0, class_="label"),
    )


def grasps_chart(fruit: FruitEntry) -> Markup:
    """Modulus by both methods, grasp by grasp; band: the fruit's own value ± one sd."""
    rows = fruit.estimates
    ends: list[float] = []
    for row in rows:
        for value, sd in _methods(row):
            if value is not None:
                ends += [value - (sd or 0.0), value + (sd or 0.0)]
    if fruit.E_MPa is not None:
        ends += [fruit.E_MPa - (fruit.E_sd_MPa or 0.0), fruit.E_MPa + (fruit.E_sd_MPa or 0.0)]
    lowest, highest = padded(ends)
    gutter = min(max([len(row.grasp) for row in rows] + [4]) * 7.4 + 14, 120.0)
    top, row_px = 36.0, 34.0
    bottom = top + row_px * max(len(rows), 1)
    x = AxisScale(lowest=lowest, highest=highest, start_px=gutter, end_px=348.0)
    parts = []
    if fruit.E_MPa is not None:
        low = x(max(fruit.E_MPa - (fruit.E_sd_MPa or 0.0), lowest))
        high = x(min(fruit.E_MPa + (fruit.E_sd_MPa or 0.0), highest))
        parts.append(element("rect", x=low, y=top, width=high - low, height=bottom - top, class_="band"))
        at = x(fruit.E_MPa)
        parts.append(element("line", x1=at, x2=at, y1=top, y2=bottom, class_="centre"))
    parts.append(axis_x(x, label="E (MPa)", top=top, bottom=bottom, at_most=5))
    parts.append(
        element(
            "g",
            marker("circle", 10.0, 14.0, size=4.5, class_="energy"),
            element("text", "energy ratio", x=20.0, y=18.5, class_="label"),
            marker("square", 134.0, 14.0, size=4.5, class_="squares"),
            element("text", "least squares", x=144.0, y=18.5, class_="label"),
        )
    )
    for k, row in enumerate(rows):
        middle = top + row_px * (k + 0.5)
        parts.append(
            element("text", shortened(row.grasp, px=gutter - 12), x=0.0, y=middle + 4.5, class_="label")
        )
        shown = zip(_methods(row), ("circle", "square"), ("energy", "squares"), (-6.0, 6.0), strict=True)
        for (value, sd), shape, class_, shift in shown:
            if value is not None and math.isfinite(value):
                parts.append(error_bar_x(x, value, sd, middle + shift, class_=class_))
                parts.append(marker(shape, x(value), middle + shift, size=4.5, class_=class_))
    return drawing(
        *parts,
        width=360.0,
        height=bottom + 42,
        title="Modulus by grasp and method",
        description="; ".join(
            f"{row.grasp}: energy ratio {with_sd(row.E_energy_MPa, row.E_energy_sd_MPa)} MPa, "
            f"least squares {with_sd(row.E_least_squares_MPa, row.E_least_squares_sd_MPa)} MPa"
            for row in rows
        ),
    )


def _methods(
    row: GraspEstimate,
) -> tuple[tuple[float | None, float | None], tuple[float | None, float | None]]:
    return (
        (row.E_energy_MPa, row.E_energy_sd_MPa),
        (row.E_least_squares_MPa, row.E_least_squares_sd_MPa),
    )
