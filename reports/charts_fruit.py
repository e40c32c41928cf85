"""Charts of one fruit: force against travel of a grasp, and the modulus each grasp gave."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import chain

import numpy as np
from markupsafe import Markup

from reports.charts_batch import gutter, shortened
from reports.entries import FruitEntry
from reports.grasp_record import CurveRecord, GraspRecord, ModelCurveRecord
from reports.language import say
from reports.svg import Plot, drawing, element, error_bar, label, marker, padded, rule
from reports.words import number, with_sd

_MOST_POINTS = 80
"""Marks of one pad's curve: on a drawing 360 px wide more would lie less than 4 px apart."""
_MOST_OF_LINE = 24
"""Points of a model's line: it is smooth."""
LEAST_CERTAIN = 0.2
"""Relative error of a frame's modulus from which it does not set the chart's scale."""
_PAD_MARKS = ("circle", "square", "circle", "square")
_PAD_DOTS = ("round", "cornered")


def force_chart(recording: GraspRecord) -> Markup:
    """Force against travel of a recording's pads: marks as recorded, a line for the fitted model."""
    known = [curve for curve in recording.curves if np.isfinite(curve.travel_mm).any()]
    travels = [curve.travel_mm for curve in known]
    travels += [curve.model.travel_mm for curve in known if curve.model is not None]
    plot = _over_travel(
        travel_mm=chain(*travels),
        up=padded((value for curve in known for value in curve.force_N), from_zero=True),
    )
    parts = [plot.axis_x(say("travel since first touch (mm)")), plot.axis_y(say("force (N)"))]
    for k, curve in enumerate(known):
        parts += [_pad(curve, k, plot), _legend_item(f"{say('pad')} {curve.pad}", k, count=len(known))]
    peaks = (f"pad {curve.pad}: peak force {number(float(np.nanmax(curve.force_N)))} N" for curve in known)
    return drawing(
        *parts,
        width=360.0,
        height=258.0,
        title=f"{say('Force against travel')}, {recording.grasp}",
        description="; ".join(peaks) or say("No frames in contact"),
    )


def _over_travel(*, travel_mm: Iterable[float], up: tuple[float, float]) -> Plot:
    """A plot over travel, with room for a legend above."""
    across = padded(travel_mm, from_zero=True)
    return Plot(x_limits=across, y_limits=up, left=44.0, right=348.0, top=52.0, bottom=216.0)


def _pad(curve: CurveRecord, k: int, plot: Plot) -> Markup:
    """One pad's points of force over travel, and a line through them or of the model."""
    every = max(1, math.ceil(len(curve.travel_mm) / _MOST_POINTS))
    travel, force = curve.travel_mm[::every], curve.force_N[::every]
    if curve.model is not None:
        parts = _model(curve.model, k, plot)
    else:
        parts = _lines(plot, np.array(travel), np.array(force), class_=f"joined pad{k % 4}")
    dots = plot.dots(zip(travel, force, strict=True))
    parts.append(element("path", d=dots, class_=f"dots {_PAD_DOTS[k % 2]} pad{k % 4}"))
    return element("g", element("title", f"pad {curve.pad}"), *parts)


def _model(line: ModelCurveRecord, k: int, plot: Plot) -> list[Markup]:
    """The model's line in the order of the frames, over its band of two standard deviations of E."""
    every = max(1, math.ceil(len(line.travel_mm) / _MOST_OF_LINE))
    chosen = np.unique(np.r_[0 : len(line.travel_mm) : every, len(line.travel_mm) - 1])
    travel, force, sd = (np.array(numbers)[chosen] for numbers in (line.travel_mm, line.force_N, line.sd_mm))
    edges = zip(np.r_[travel - 2 * sd, (travel + 2 * sd)[::-1]], np.r_[force, force[::-1]], strict=True)
    band = " ".join(f"{plot.x(float(across)):.1f},{plot.y(float(up)):.1f}" for across, up in edges)
    return [
        element("polygon", points=band, class_=f"spread pad{k % 4}"),
        *_lines(plot, travel, force, class_=f"model pad{k % 4}"),
    ]


def frames_chart(fruit: FruitEntry) -> Markup:
    """Modulus by each frame alone against travel, all grasps; band: the fruit's own value ± one sd."""
    by_recording = {recording.grasp: recording.frames for recording in fruit.recordings if recording.frames}
    rows = [frame for frames in by_recording.values() for frame in frames]
    sure = [row.E_MPa for row in rows if row.E_sd_MPa < LEAST_CERTAIN * row.E_MPa]
    low, high = padded([*sure, *_spread(fruit)])
    plot = _over_travel(travel_mm=(row.travel_mm for row in rows), up=(low, high))
    parts = []
    if ends := _spread(fruit):
        top, bottom = plot.y(min(ends[1], high)), plot.y(max(ends[0], low))
        parts.append(element("rect", x=plot.left, y=top, width=304.0, height=bottom - top, class_="band"))
    parts += [plot.axis_x(say("travel since first touch (mm)")), plot.axis_y("E (MPa)")]
    for k, (name, frames) in enumerate(by_recording.items()):
        for unloading, faint in ((False, ""), (True, " faint")):
            shown = [row for row in frames if low <= row.E_MPa <= high and row.unloading == unloading]
            if dots := plot.dots((row.travel_mm, row.E_MPa) for row in shown):
                shape = _PAD_DOTS[k % 2]
                parts.append(element("path", d=dots, class_=f"dots {shape} pad{k % 4}{faint}"))
        parts.append(_legend_item(name, k, count=len(by_recording)))
    return drawing(
        *parts,
        width=360.0,
        height=258.0,
        title=say("Modulus by frame"),
        description="; ".join(
            f"{name}: " + _range([frame.E_MPa for frame in frames]) for name, frames in by_recording.items()
        ),
    )


def _spread(fruit: FruitEntry) -> list[float]:
    """E less and plus one standard deviation; empty where it is not known."""
    sd = fruit.E_sd_MPa or 0.0
    return [] if fruit.E_MPa is None else [fruit.E_MPa - sd, fruit.E_MPa + sd]


def _range(values: list[float]) -> str:
    return f"{number(min(values))} to {number(max(values))} MPa in {len(values)} frames"


def _lines(plot: Plot, travel: np.ndarray, force: np.ndarray, *, class_: str) -> list[Markup]:
    """Polylines through the finite stretches."""
    finite = np.isfinite(travel) & np.isfinite(force)
    breaks = np.flatnonzero(np.diff(finite.astype(int))) + 1
    return [
        plot.line(travel[run], force[run], class_=class_)
        for run in np.split(np.arange(len(travel)), breaks)
        if len(run) > 1 and finite[run[0]]
    ]


def _legend_item(words: str, k: int, *, count: int) -> Markup:
    step = 300.0 / max(count, 1)
    at = 52.0 + step * k
    mark = marker(_PAD_MARKS[k % len(_PAD_MARKS)], at, 14.0, size=3.4, class_=f"pad{k % 4}")
    return element("g", mark, label(shortened(words, px=step - 14), at + 10, 18.0))


def grasps_chart(fruit: FruitEntry) -> Markup:
    """Modulus by both methods, grasp by grasp; band: the fruit's own value ± one sd."""
    rows = fruit.recordings
    known = [(value, sd or 0.0) for row in rows for value, sd in _methods(row) if value is not None]
    ends = [value + way * sd for value, sd in known for way in (-1, 1)]
    lowest, highest = padded([*ends, *_spread(fruit)])
    count = max(len(rows), 1)
    plot = Plot(
        x_limits=(lowest, highest),
        y_limits=(count, 0.0),
        left=gutter([row.grasp for row in rows], most_px=120.0),
        right=348.0,
        top=36.0,
        bottom=36.0 + 34.0 * count,
    )
    top, bottom, x = plot.top, plot.bottom, plot.x
    parts = []
    if fruit.E_MPa is not None:
        below, above = _spread(fruit)
        low, high, at = x(max(below, lowest)), x(min(above, highest)), x(fruit.E_MPa)
        parts += [
            element("rect", x=low, y=top, width=high - low, height=bottom - top, class_="band"),
            rule(at, at, top, bottom, class_="centre"),
        ]
    parts += [
        plot.axis_x("E (MPa)", at_most=5),
        element(
            "g",
            marker("circle", 10.0, 14.0, size=4.5, class_="energy"),
            label(say("energy ratio"), 20.0, 18.5),
            marker("square", 134.0, 14.0, size=4.5, class_="squares"),
            label(say("least squares"), 144.0, 18.5),
        ),
    ]
    for k, row in enumerate(rows):
        middle = plot.y(k + 0.5)
        parts.append(label(shortened(row.grasp, px=plot.left - 12), 0.0, middle + 4.5))
        shown = zip(_methods(row), ("circle", "square"), ("energy", "squares"), (-6.0, 6.0), strict=True)
        for (value, sd), shape, class_, shift in shown:
            if value is not None and math.isfinite(value):
                parts.append(error_bar(x, value, sd, middle + shift, class_=class_))
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


def _methods(row: GraspRecord) -> tuple[tuple[float | None, float | None], ...]:
    return (
        (row.E_energy_MPa, row.E_energy_sd_MPa),
        (row.E_least_squares_MPa, row.E_least_squares_sd_MPa),
    )
