"""Charts of one fruit: force against travel of a grasp, and the modulus each grasp gave."""

from __future__ import annotations

import math

import numpy as np
from markupsafe import Markup

from reports.charts_batch import shortened
from reports.entries import FruitEntry
from reports.grasp_record import CurveRecord, GraspRecord, ModelCurveRecord
from reports.language import say
from reports.svg import AxisScale, axis_x, axis_y, drawing, element, error_bar_x, marker, padded, polyline
from reports.words import number, with_sd

_MOST_POINTS = 80
"""Marks of one pad's curve: on a drawing 360 px wide more would lie less than 4 px apart."""
_MOST_OF_LINE = 24
"""Points of a model's line: it is smooth."""
LEAST_CERTAIN = 0.2
"""Relative error of a frame's modulus from which it does not set the scale of the chart: the first frames
after touch carry little."""
_PAD_MARKS = ("circle", "square", "circle", "square")
_PAD_DOTS = ("round", "cornered")


def force_chart(recording: GraspRecord) -> Markup:
    """Force against travel of a recording's pads: marks as recorded, a line for the fitted model."""
    known = [curve for curve in recording.curves if np.isfinite(curve.travel_mm).any()]
    travels = [value for curve in known for value in curve.travel_mm]
    forces = [value for curve in known for value in curve.force_N]
    for line in (curve.model for curve in known if curve.model is not None):
        travels += line.travel_mm
    low_x, high_x = padded(travels, from_zero=True)
    low_y, high_y = padded(forces, from_zero=True)
    x = AxisScale(lowest=low_x, highest=high_x, start_px=44.0, end_px=348.0)
    y = AxisScale(lowest=low_y, highest=high_y, start_px=216.0, end_px=52.0)
    parts = [
        axis_x(x, label=say("travel since first touch (mm)"), top=52.0, bottom=216.0, at_most=7),
        axis_y(y, label=say("force (N)"), left=44.0, right=348.0, at_most=6),
    ]
    for k, curve in enumerate(known):
        parts.append(_pad(curve, k, x=x, y=y))
        parts.append(_legend_item(curve.pad, k, count=len(known)))
    return drawing(
        *parts,
        width=360.0,
        height=258.0,
        title=f"{say('Force against travel')}, {recording.grasp}",
        description="; ".join(
            f"pad {curve.pad}: peak force {number(float(np.nanmax(curve.force_N)))} N" for curve in known
        )
        or say("No frames in contact"),
    )


def _pad(curve: CurveRecord, k: int, *, x: AxisScale, y: AxisScale) -> Markup:
    """One pad's points of force over travel, and a line through them or of the model."""
    every = max(1, math.ceil(len(curve.travel_mm) / _MOST_POINTS))
    parts = []
    if curve.model is not None:
        parts += _model(curve.model, k, x=x, y=y)
    else:
        travel, force = np.array(curve.travel_mm), np.array(curve.force_N)
        parts += _lines(x, y, travel[::every], force[::every], class_=f"joined pad{k % 4}")
    points = zip(curve.travel_mm[::every], curve.force_N[::every], strict=True)
    dots = "".join(
        f"M{x(travel):.1f} {y(force):.1f}h0"
        for travel, force in points
        if math.isfinite(travel) and math.isfinite(force)
    )
    # a stroke without length is a round or square dot: a tenth of the bytes of an element for each
    parts.append(element("path", d=dots, class_=f"dots {_PAD_DOTS[k % 2]} pad{k % 4}"))
    return element("g", element("title", f"pad {curve.pad}"), *parts)


def _model(line: ModelCurveRecord, k: int, *, x: AxisScale, y: AxisScale) -> list[Markup]:
    """The model's line in the order of the frames, over its band of two standard deviations of E."""
    every = max(1, math.ceil(len(line.travel_mm) / _MOST_OF_LINE))
    chosen = np.unique(np.r_[0 : len(line.travel_mm) : every, len(line.travel_mm) - 1])
    travel, force, sd = (np.array(numbers)[chosen] for numbers in (line.travel_mm, line.force_N, line.sd_mm))
    edges = [
        *zip(travel - 2 * sd, force, strict=True),
        *list(zip(travel + 2 * sd, force, strict=True))[::-1],
    ]
    band = " ".join(f"{x(float(one)):.1f},{y(float(other)):.1f}" for one, other in edges)
    return [
        element("polygon", points=band, class_=f"spread pad{k % 4}"),
        *_lines(x, y, travel, force, class_=f"model pad{k % 4}"),
    ]


def frames_chart(fruit: FruitEntry) -> Markup:
    """Modulus by each frame alone against travel, all grasps; band: the fruit's own value ± one sd."""
    by_recording = {recording.grasp: recording.frames for recording in fruit.recordings if recording.frames}
    rows = [frame for frames in by_recording.values() for frame in frames]
    ends = [row.E_MPa for row in rows if row.E_sd_MPa < LEAST_CERTAIN * row.E_MPa]
    if fruit.E_MPa is not None:
        ends += [fruit.E_MPa - (fruit.E_sd_MPa or 0.0), fruit.E_MPa + (fruit.E_sd_MPa or 0.0)]
    low_y, high_y = padded(ends)
    low_x, high_x = padded([row.travel_mm for row in rows], from_zero=True)
    x = AxisScale(lowest=low_x, highest=high_x, start_px=44.0, end_px=348.0)
    y = AxisScale(lowest=low_y, highest=high_y, start_px=216.0, end_px=52.0)
    parts = []
    if fruit.E_MPa is not None:
        top = y(min(fruit.E_MPa + (fruit.E_sd_MPa or 0.0), high_y))
        bottom = y(max(fruit.E_MPa - (fruit.E_sd_MPa or 0.0), low_y))
        parts.append(element("rect", x=44.0, y=top, width=304.0, height=bottom - top, class_="band"))
    parts += [
        axis_x(x, label=say("travel since first touch (mm)"), top=52.0, bottom=216.0, at_most=7),
        axis_y(y, label="E (MPa)", left=44.0, right=348.0, at_most=6),
    ]
    for k, (name, frames) in enumerate(by_recording.items()):
        shown = [frame for frame in frames if low_y <= frame.E_MPa <= high_y]
        for unloading in (False, True):
            dots = "".join(
                f"M{x(row.travel_mm):.1f} {y(row.E_MPa):.1f}h0" for row in shown if row.unloading == unloading
            )
            if dots:
                faint = " faint" if unloading else ""
                shape = _PAD_DOTS[k % 2]
                parts.append(element("path", d=dots, class_=f"dots {shape} pad{k % 4}{faint}"))
        parts.append(_legend_item(name, k, count=len(by_recording), word=""))
    return drawing(
        *parts,
        width=360.0,
        height=258.0,
        title=say("Modulus by frame"),
        description="; ".join(
            f"{name}: " + _range([frame.E_MPa for frame in frames]) for name, frames in by_recording.items()
        ),
    )


def _range(values: list[float]) -> str:
    return f"{number(min(values))} to {number(max(values))} MPa in {len(values)} frames"


def _lines(x: AxisScale, y: AxisScale, travel: np.ndarray, force: np.ndarray, *, class_: str) -> list[Markup]:
    """Polylines through the finite stretches."""
    finite = np.isfinite(travel) & np.isfinite(force)
    breaks = np.flatnonzero(np.diff(finite.astype(int))) + 1
    return [
        polyline([x(float(v)) for v in travel[run]], [y(float(v)) for v in force[run]], class_=class_)
        for run in np.split(np.arange(len(travel)), breaks)
        if len(run) > 1 and finite[run[0]]
    ]


def _legend_item(name: str, k: int, *, count: int, word: str | None = None) -> Markup:
    step = 300.0 / max(count, 1)
    at = 52.0 + step * k
    return element(
        "g",
        marker(_PAD_MARKS[k % len(_PAD_MARKS)], at, 14.0, size=3.4, class_=f"pad{k % 4}"),
        element(
            "text",
            shortened(f"{say('pad') + ' ' if word is None else word}{name}", px=step - 14),
            x=at + 10,
            y=18.0,
            class_="label",
        ),
    )


def grasps_chart(fruit: FruitEntry) -> Markup:
    """Modulus by both methods, grasp by grasp; band: the fruit's own value ± one sd."""
    rows = fruit.recordings
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
            element("text", say("energy ratio"), x=20.0, y=18.5, class_="label"),
            marker("square", 134.0, 14.0, size=4.5, class_="squares"),
            element("text", say("least squares"), x=144.0, y=18.5, class_="label"),
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
        title=say("Modulus by grasp and method"),
        description="; ".join(
            f"{row.grasp}: energy ratio {with_sd(row.E_energy_MPa, row.E_energy_sd_MPa)} MPa, "
            f"least squares {with_sd(row.E_least_squares_MPa, row.E_least_squares_sd_MPa)} MPa"
            for row in rows
        ),
    )


def _methods(
    row: GraspRecord,
) -> tuple[tuple[float | None, float | None], tuple[float | None, float | None]]:
    return (
        (row.E_energy_MPa, row.E_energy_sd_MPa),
        (row.E_least_squares_MPa, row.E_least_squares_sd_MPa),
    )
