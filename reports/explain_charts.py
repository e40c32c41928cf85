"""Charts of a mismatch: what explains it, E over time, force and residual before and after."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

import numpy as np
from markupsafe import Markup

from reports.charts_batch import shortened
from reports.explain_entries import ExplainEntry, Record
from reports.svg import AxisScale, Plot, drawing, element, error_bar, label, marker, padded, rule
from reports.words import effect_name, number, percent

_MARKS = ("circle", "square", "triangle", "diamond")
MOST_BARS = 8
"""Explanations with a bar, set by hand: further ones would be bars of no length."""


def evidence_chart(ranking: Sequence[Record], *, verdict: Sequence[str]) -> Markup:
    """One bar per explanation, as long as its probability; those of the verdict in the strong colour."""
    shown = ranking[:MOST_BARS]
    row_px, gutter = 30.0, 290.0
    x = AxisScale(lowest=0.0, highest=1.0, start_px=gutter, end_px=gutter + 270.0)
    parts = []
    for k, candidate in enumerate(shown):
        middle = 6.0 + row_px * (k + 0.5)
        strong = "named" if candidate.effect in verdict else "other"
        long = max(x(candidate.probability) - gutter, 1.5)
        parts += [
            label(shortened(effect_name(candidate.effect), px=gutter - 16), 0.0, middle + 4.5),
            _bar(gutter, middle - 9, 270.0, 18.0, class_="trough"),
            _bar(gutter, middle - 9, long, 18.0, class_=f"bar {strong}"),
            label(percent(candidate.probability), 572.0, middle + 4.5),
        ]
    return drawing(
        *parts,
        width=640.0,
        height=12.0 + row_px * max(len(shown), 1),
        title="Probability of each explanation",
        description="; ".join(
            f"{effect_name(candidate.effect)}: {percent(candidate.probability)}" for candidate in shown
        ),
    )


def _bar(x: float, y: float, width: float, height: float, *, class_: str) -> Markup:
    return element("rect", x=x, y=y, width=width, height=height, class_=class_)


def rms_chart(heldout: Record, *, with_effect: bool) -> Markup:
    """Force residual on recordings that the fit did not see: without the effect, with it, and of noise.

    `with_effect`: whether there is one; else the model has one bar.
    """
    rms = heldout.rms_before, heldout.rms_after, heldout.noise_rms
    of_model = [("without", rms[0], "before"), ("with the effect", rms[1], "after")]
    rows = [*(of_model if with_effect else [("model", rms[1], "after")]), ("noise alone", rms[2], "noise")]
    x = AxisScale(lowest=0.0, highest=1.1 * max(*rms, 1e-12), start_px=120.0, end_px=500.0)
    parts = []
    for k, (words, value, kind) in enumerate(rows):
        middle = 6.0 + 34.0 * (k + 0.5)
        parts += [
            label(words, 0.0, middle + 4.5),
            _bar(120.0, middle - 11, max(x(value) - 120.0, 1.5), 22.0, class_=f"bar {kind}"),
            label(number(value), x(value) + 8, middle + 4.5),
        ]
    return drawing(
        *parts,
        width=560.0,
        height=12.0 + 34.0 * len(rows),
        title="Residual on recordings that the fit did not see",
        description="; ".join(f"{words}: {number(value)}" for words, value, _ in rows),
    )


def modulus_over_time(entry: ExplainEntry, *, with_effect: bool) -> list[tuple[str, Markup]]:
    """Per grasp, E of every frame and pad over time; dashed: E without, solid: E with the effect, or E."""
    sure = [cell for cell in entry.cells if 0 < cell.E_sd_MPa < 0.25 * abs(cell.E_MPa)]
    if not sure:
        return []
    levels = [(entry.after.value, "after")]
    if with_effect:
        levels.insert(0, (entry.before.value, "before"))
    levels = [(value, kind) for value, kind in levels if math.isfinite(value)]  # E may be withheld
    common = np.quantile([cell.E_MPa for cell in sure], [0.02, 0.98]).tolist()
    limits = padded([*common, *(value for value, _ in levels)])
    pads = sorted({cell.pad for cell in sure})
    ordered = sorted(sure, key=lambda cell: (cell.grasp, cell.time_s))
    return [
        (grasp, _cells_chart(grasp, list(cells), levels, limits=limits, pads=pads))
        for grasp, cells in groupby(ordered, key=lambda cell: cell.grasp)
    ]


def _cells_chart(
    grasp: str,
    cells: list[Record],
    levels: list[tuple[float, str]],
    *,
    limits: tuple[float, float],
    pads: list[str],
) -> Markup:
    """E of one grasp's frames over time, with E without and with the effect as lines (`levels`)."""
    plot = _plot(padded(cell.time_s for cell in cells), limits)
    x, y = plot.x, plot.y
    parts = [
        _phases([(cell.time_s, cell.phase) for cell in cells], plot),
        plot.axis_x("time (s)"),
        plot.axis_y("E of each frame (MPa)", above=20.0),
        *(_level(plot, value, class_=f"level {kind}") for value, kind in levels),
    ]
    for cell in cells:
        k = pads.index(cell.pad)
        if limits[0] <= cell.E_MPa <= limits[1]:
            at, pad = x(cell.time_s), f"pad{k % 4}"
            parts.append(error_bar(y, cell.E_MPa, cell.E_sd_MPa, at, class_=f"thin {pad}"))
            parts.append(marker(_MARKS[k % 4], at, y(cell.E_MPa), size=3.0, class_=pad))
    mean = {pad: np.mean([c.E_MPa for c in cells if c.pad == pad] or [np.nan]) for pad in pads}
    return _finished(
        plot,
        [*parts, *_legend([(_pad_said(pad), "mark", k) for k, pad in enumerate(pads)])],
        title=f"E over time, {grasp}",
        description="; ".join(
            f"{_pad_said(pad)}: mean {number(float(value))} MPa" for pad, value in mean.items()
        ),
    )


def _plot(x_limits: tuple[float, float], y_limits: tuple[float, float]) -> Plot:
    """Three charts side by side on a page, with room for numbers at the left, words above, the axis below."""
    return Plot(x_limits=x_limits, y_limits=y_limits, left=48.0, right=348.0, top=56.0, bottom=206.0)


def _level(plot: Plot, value: float, *, class_: str) -> Markup:
    return rule(plot.left, plot.right, plot.y(value), plot.y(value), class_=class_)


def _finished(plot: Plot, parts: Sequence[Markup], *, title: str, description: str) -> Markup:
    return drawing(*parts, width=360.0, height=plot.bottom + 42, title=title, description=description)


def _pad_said(pad: str) -> str:
    return "all pads" if pad == "all" else f"pad {pad}"


def force_and_residual(trace: Record, *, with_effect: bool) -> tuple[Markup, Markup]:
    """Force over approach as measured and modelled, and what the models leave of the approach over time.

    `with_effect`: whether there is one; else the model has one line.
    """
    return _force(trace, with_effect=with_effect), _residual(trace, with_effect=with_effect)


def _force(trace: Record, *, with_effect: bool) -> Markup:
    """One recording's force over approach, measured and modelled."""
    travel = np.concatenate([trace.given_mm, trace.before_mm, trace.after_mm])
    plot = _plot(padded(travel.tolist(), from_zero=True), padded(trace.force_N.tolist(), from_zero=True))
    points = [
        marker("circle", plot.x(given), plot.y(force), size=2.8, class_="measured")
        for given, force in zip(trace.given_mm.tolist(), trace.force_N.tolist(), strict=True)
        if math.isfinite(given) and math.isfinite(force)
    ]
    models = [("without", "before", 0), ("with the effect", "after", 0)]
    before = plot.line(trace.before_mm, trace.force_N, class_="model before")
    return _finished(
        plot,
        [
            plot.axis_x("how far the flesh gave way (mm)"),
            plot.axis_y("force (N)", above=20.0),
            *([before] if with_effect else []),
            *points,
            plot.line(trace.after_mm, trace.force_N, class_="model after"),
            *_legend([("measured", "measured", 0), *(models if with_effect else [("model", "after", 0)])]),
        ],
        title=f"Force over approach, {trace.grasp}",
        description=f"Peak force {number(float(np.nanmax(trace.force_N, initial=0.0)))} N",
    )


def _residual(trace: Record, *, with_effect: bool) -> Markup:
    """What the models leave of one recording's approach, over time."""
    before, after = 1e3 * (trace.given_mm - trace.before_mm), 1e3 * (trace.given_mm - trace.after_mm)
    plot = _plot(padded(trace.time_s.tolist()), padded([*before.tolist(), *after.tolist(), 0.0]))
    rms = [float(np.sqrt(np.nanmean(leftover**2))) if len(leftover) else 0.0 for leftover in (before, after)]
    without, with_it = map(number, rms)
    models = [(f"without: {without} µm", "before", 0), (f"with: {with_it} µm", "after", 0)]
    said = f"{without} µm without the effect, {with_it} µm with it" if with_effect else f"{with_it} µm"
    return _finished(
        plot,
        [
            _phases(list(zip(trace.time_s.tolist(), trace.phase, strict=True)), plot),
            plot.axis_x("time (s)"),
            plot.axis_y("measured less model (µm)", above=20.0),
            _level(plot, 0.0, class_="base"),
            *([plot.line(trace.time_s, before, class_="model before")] if with_effect else []),
            plot.line(trace.time_s, after, class_="model after"),
            *_legend(models if with_effect else [(f"model: {with_it} µm", "after", 0)], step=150.0),
        ],
        title=f"Residual over time, {trace.grasp}",
        description=f"Root mean square {said}",
    )


def _phases(frames: list[tuple[float, str]], plot: Plot) -> Markup:
    """Bands behind the frames of a hold, with the names of the phases above."""
    parts = []
    for phase, run in groupby(frames, key=lambda frame: frame[1]):
        times = [time_s for time_s, _ in run]
        left, right = plot.x(min(times)), plot.x(max(times))
        if phase == "hold":
            width = max(right - left, 1.0)
            parts.append(_bar(left, plot.top, width, plot.bottom - plot.top, class_="band"))
        if right - left > 7.0 * len(phase) + 4:
            middle = (left + right) / 2
            parts.append(label(phase, middle, plot.top - 5, anchor="middle", class_="phase"))
    return Markup("").join(parts)


def _legend(entries: list[tuple[str, str, int]], *, step: float = 104.0) -> list[Markup]:
    """Along the top: a mark for points, a stroke for lines."""
    parts = []
    for n, (words, kind, k) in enumerate(entries):
        at = 6.0 + step * n
        if kind == "mark":
            parts.append(marker(_MARKS[k % 4], at + 6, 14.0, size=3.6, class_=f"pad{k % 4}"))
        elif kind == "measured":
            parts.append(marker("circle", at + 6, 14.0, size=3.2, class_="measured"))
        else:
            parts.append(rule(at, at + 16, 14.0, 14.0, class_=f"model {kind}"))
        parts.append(label(words, at + (14 if kind in ("mark", "measured") else 21), 18.5))
    return parts
