"""Charts of a mismatch: what explains it, E over time, force and residual before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

import numpy as np
from markupsafe import Markup

from reports.charts_batch import shortened
from reports.explain_entries import CandidateEntry, CellEntry, ExplainEntry, TraceEntry
from reports.svg import AxisScale, axis_x, axis_y, drawing, element, error_bar_y, marker, padded, polyline
from reports.words import effect_name, number, percent

_MARKS = ("circle", "square", "triangle", "diamond")
_WIDTH, _LEFT, _RIGHT, _TOP, _BOTTOM = 360.0, 48.0, 348.0, 56.0, 206.0
"""px of the drawing and of its axes' ends: three charts side by side on a page, with room for numbers at the
left, words above and the axis below."""
MOST_BARS = 8
"""Explanations with a bar, set by hand: further ones would be bars of no length."""


def evidence_chart(ranking: Sequence[CandidateEntry], *, verdict: Sequence[str]) -> Markup:
    """One bar per explanation, as long as its probability; those of the verdict in the strong colour."""
    shown = ranking[:MOST_BARS]
    row_px, top, gutter = 30.0, 6.0, 290.0
    x = AxisScale(lowest=0.0, highest=1.0, start_px=gutter, end_px=gutter + 270.0)
    parts = []
    for k, one in enumerate(shown):
        middle = top + row_px * (k + 0.5)
        strong = "named" if one.effect in verdict else "other"
        parts += [
            element(
                "text",
                shortened(effect_name(one.effect), px=gutter - 16),
                x=0.0,
                y=middle + 4.5,
                class_="label",
            ),
            element("rect", x=gutter, y=middle - 9, width=270.0, height=18.0, class_="trough"),
            element(
                "rect",
                x=gutter,
                y=middle - 9,
                width=max(x(one.probability) - gutter, 1.5),
                height=18.0,
                class_=f"bar {strong}",
            ),
            element("text", percent(one.probability), x=572.0, y=middle + 4.5, class_="label"),
        ]
    return drawing(
        *parts,
        width=640.0,
        height=top + row_px * max(len(shown), 1) + 6,
        title="Probability of each explanation",
        description="; ".join(f"{effect_name(one.effect)}: {percent(one.probability)}" for one in shown),
    )


def rms_chart(rms: tuple[float, float, float], *, with_effect: bool) -> Markup:
    """Force residual on recordings that the fit did not see: without the effect, with it, and of noise.

    `with_effect`: whether there is one; else the model has one bar.
    """
    of_model = [("without", rms[0], "before"), ("with the effect", rms[1], "after")]
    rows = [*(of_model if with_effect else [("model", rms[1], "after")]), ("noise alone", rms[2], "noise")]
    x = AxisScale(lowest=0.0, highest=1.1 * max(*rms, 1e-12), start_px=120.0, end_px=500.0)
    parts = []
    for k, (label, value, kind) in enumerate(rows):
        middle = 6.0 + 34.0 * (k + 0.5)
        parts += [
            element("text", label, x=0.0, y=middle + 4.5, class_="label"),
            element(
                "rect",
                x=120.0,
                y=middle - 11,
                width=max(x(value) - 120.0, 1.5),
                height=22.0,
                class_=f"bar {kind}",
            ),
            element("text", number(value), x=x(value) + 8, y=middle + 4.5, class_="label"),
        ]
    return drawing(
        *parts,
        width=560.0,
        height=12.0 + 34.0 * len(rows),
        title="Residual on recordings that the fit did not see",
        description="; ".join(f"{label}: {number(value)}" for label, value, _ in rows),
    )


def modulus_over_time(found: ExplainEntry, *, with_effect: bool) -> list[tuple[str, Markup]]:
    """Per grasp, E of every frame and pad over time; dashed: E without, solid: E with the effect, or E."""
    sure = [cell for cell in found.cells if 0 < cell.E_sd_MPa < 0.25 * abs(cell.E_MPa)]
    if not sure:
        return []
    values = np.array([cell.E_MPa for cell in sure])
    low, high = np.quantile(values, [0.02, 0.98])
    levels = [(found.E_MPa.after.value, "after")]
    if with_effect:
        levels.insert(0, (found.E_MPa.before.value, "before"))
    levels = [(value, kind) for value, kind in levels if math.isfinite(value)]  # E may be withheld
    limits = padded([float(low), float(high), *(value for value, _ in levels)])
    pads = sorted({cell.pad for cell in sure})
    charts = []
    for grasp, cells in groupby(sorted(sure, key=lambda c: (c.grasp, c.time_s)), key=lambda c: c.grasp):
        charts.append((grasp, _cells_chart(grasp, list(cells), levels, limits=limits, pads=pads)))
    return charts


def _cells_chart(
    grasp: str,
    cells: list[CellEntry],
    levels: list[tuple[float, str]],
    *,
    limits: tuple[float, float],
    pads: list[str],
) -> Markup:
    """E of one grasp's frames over time, with E without and with the effect as lines (`levels`)."""
    times = [cell.time_s for cell in cells]
    start, end = padded(times)
    x = AxisScale(lowest=start, highest=end, start_px=_LEFT, end_px=_RIGHT)
    y = AxisScale(lowest=limits[0], highest=limits[1], start_px=_BOTTOM, end_px=_TOP)
    parts = [_phases([(c.time_s, c.phase) for c in cells], x)]
    parts.append(axis_x(x, label="time (s)", top=_TOP, bottom=_BOTTOM, at_most=7))
    parts.append(_axis_y(y, label="E of each frame (MPa)"))
    for value, kind in levels:
        parts.append(element("line", x1=_LEFT, x2=_RIGHT, y1=y(value), y2=y(value), class_=f"level {kind}"))
    for cell in cells:
        k = pads.index(cell.pad)
        if limits[0] <= cell.E_MPa <= limits[1]:
            parts.append(error_bar_y(y, cell.E_MPa, cell.E_sd_MPa, x(cell.time_s), class_=f"thin pad{k % 4}"))
            parts.append(marker(_MARKS[k % 4], x(cell.time_s), y(cell.E_MPa), size=3.0, class_=f"pad{k % 4}"))
    parts += _legend([(_pad_said(pad), "mark", k) for k, pad in enumerate(pads)])
    mean = {pad: np.mean([c.E_MPa for c in cells if c.pad == pad] or [np.nan]) for pad in pads}
    return drawing(
        *parts,
        width=_WIDTH,
        height=_BOTTOM + 42,
        title=f"E over time, {grasp}",
        description="; ".join(
            f"{_pad_said(pad)}: mean {number(float(value))} MPa" for pad, value in mean.items()
        ),
    )


def _pad_said(pad: str) -> str:
    return "all pads" if pad == "all" else f"pad {pad}"


def force_and_residual(trace: TraceEntry, *, with_effect: bool) -> tuple[Markup, Markup]:
    """Force over approach as measured and modelled, and what the models leave of the approach over time.

    `with_effect`: whether there is one; else the model has one line.
    """
    return _force(trace, with_effect=with_effect), _residual(trace, with_effect=with_effect)


def _force(trace: TraceEntry, *, with_effect: bool) -> Markup:
    """One recording's force over approach, measured and modelled."""
    columns = (trace.given_mm, trace.before_mm, trace.after_mm)
    low_x, high_x = padded([float(v) for column in columns for v in column], from_zero=True)
    low_y, high_y = padded([float(v) for v in trace.force_N], from_zero=True)
    x = AxisScale(lowest=low_x, highest=high_x, start_px=_LEFT, end_px=_RIGHT)
    y = AxisScale(lowest=low_y, highest=high_y, start_px=_BOTTOM, end_px=_TOP)
    parts = [
        axis_x(x, label="how far the flesh gave way (mm)", top=_TOP, bottom=_BOTTOM, at_most=7),
        _axis_y(y, label="force (N)"),
    ]
    if with_effect:
        parts.append(_line(x, y, trace.before_mm, trace.force_N, kind="before"))
    for given, force in zip(trace.given_mm, trace.force_N, strict=True):
        if math.isfinite(given) and math.isfinite(force):
            parts.append(marker("circle", x(float(given)), y(float(force)), size=2.8, class_="measured"))
    parts.append(_line(x, y, trace.after_mm, trace.force_N, kind="after"))
    models = [("without", "before", 0), ("with the effect", "after", 0)]
    parts += _legend([("measured", "measured", 0), *(models if with_effect else [("model", "after", 0)])])
    return drawing(
        *parts,
        width=_WIDTH,
        height=_BOTTOM + 42,
        title=f"Force over approach, {trace.grasp}",
        description=f"Peak force {number(float(np.nanmax(trace.force_N, initial=0.0)))} N",
    )


def _residual(trace: TraceEntry, *, with_effect: bool) -> Markup:
    """What the models leave of one recording's approach, over time."""
    before, after = 1e3 * (trace.given_mm - trace.before_mm), 1e3 * (trace.given_mm - trace.after_mm)
    start, end = padded([float(v) for v in trace.time_s])
    low, high = padded([*map(float, before), *map(float, after), 0.0])
    x = AxisScale(lowest=start, highest=end, start_px=_LEFT, end_px=_RIGHT)
    y = AxisScale(lowest=low, highest=high, start_px=_BOTTOM, end_px=_TOP)
    rms = [float(np.sqrt(np.nanmean(leftover**2))) if len(leftover) else 0.0 for leftover in (before, after)]
    models = [(f"without: {number(rms[0])} µm", "before", 0), (f"with: {number(rms[1])} µm", "after", 0)]
    parts = [
        _phases(list(zip(map(float, trace.time_s), trace.phase, strict=True)), x),
        axis_x(x, label="time (s)", top=_TOP, bottom=_BOTTOM, at_most=7),
        _axis_y(y, label="measured less model (µm)"),
        element("line", x1=_LEFT, x2=_RIGHT, y1=y(0.0), y2=y(0.0), class_="base"),
        *([_line(x, y, trace.time_s, before, kind="before")] if with_effect else []),
        _line(x, y, trace.time_s, after, kind="after"),
        *_legend(models if with_effect else [(f"model: {number(rms[1])} µm", "after", 0)], step=150.0),
    ]
    return drawing(
        *parts,
        width=_WIDTH,
        height=_BOTTOM + 42,
        title=f"Residual over time, {trace.grasp}",
        description=f"Root mean square {number(rms[0])} µm without the effect, {number(rms[1])} µm with it"
        if with_effect
        else f"Root mean square {number(rms[1])} µm",
    )


def _axis_y(y: AxisScale, *, label: str) -> Markup:
    """The vertical axis, its label high enough to leave a line to the phases' names."""
    name = element("text", label, x=4.0, y=_TOP - 20, text_anchor="start", class_="axis")
    return axis_y(y, label="", left=_LEFT, right=_RIGHT, at_most=6) + name


def _line(x: AxisScale, y: AxisScale, across: np.ndarray, up: np.ndarray, *, kind: str) -> Markup:
    finite = np.isfinite(across) & np.isfinite(up)
    xs, ys = across[finite], up[finite]
    return polyline([x(float(v)) for v in xs], [y(float(v)) for v in ys], class_=f"model {kind}")


def _phases(frames: list[tuple[float, str]], x: AxisScale) -> Markup:
    """Bands behind the frames of a hold, with the names of the phases above."""
    parts = []
    runs = [(phase, [t for t, _ in run]) for phase, run in groupby(frames, key=lambda frame: frame[1])]
    for phase, times in runs:
        left, right = x(min(times)), x(max(times))
        if phase == "hold":
            parts.append(
                element(
                    "rect", x=left, y=_TOP, width=max(right - left, 1.0), height=_BOTTOM - _TOP, class_="band"
                )
            )
        if right - left > 7.0 * len(phase) + 4:
            middle = (left + right) / 2
            parts.append(element("text", phase, x=middle, y=_TOP - 5, text_anchor="middle", class_="phase"))
    return Markup("").join(parts)


def _legend(items: list[tuple[str, str, int]], *, step: float = 104.0) -> list[Markup]:
    """Along the top: a mark for points, a stroke for lines."""
    parts = []
    for n, (words, kind, k) in enumerate(items):
        at = 6.0 + step * n
        if kind == "mark":
            parts.append(marker(_MARKS[k % 4], at + 6, 14.0, size=3.6, class_=f"pad{k % 4}"))
        elif kind == "measured":
            parts.append(marker("circle", at + 6, 14.0, size=3.2, class_="measured"))
        else:
            parts.append(element("line", x1=at, x2=at + 16, y1=14.0, y2=14.0, class_=f"model {kind}"))
        parts.append(
            element(
                "text", words, x=at + (14 if kind in ("mark", "measured") else 21), y=18.5, class_="label"
            )
        )
    return parts


def share_bar(share: float) -> Markup:
    """A small bar for a table's cell, full at 1."""
    width = 90.0
    return element(
        "svg",
        element("rect", x=0.0, y=1.0, width=width, height=10.0, class_="trough"),
        element(
            "rect",
            x=0.0,
            y=1.0,
            width=max(width * min(max(share, 0.0), 1.0), 1.0),
            height=10.0,
            class_="bar named",
        ),
        viewBox="0 0 90 12",
        width="90",
        height="12",
        class_="chart cell",
        aria_hidden="true",
    )
