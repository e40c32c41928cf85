"""Charts of a whole batch: the ranking, and the moduli against Shore readings."""

from __future__ import annotations

import math

import numpy as np
from markupsafe import Markup

from reports.entries import (
    BatchEntry,
    FruitEntry,
    ReferenceBodyEntry,
    ShoreCorrelation,
    ranked,
    without_references,
)
from reports.language import decimals as with_comma
from reports.language import say
from reports.palette import UNKNOWN, class_marks
from reports.svg import Plot, drawing, element, error_bar, label, marker, padded, polyline, rule, ticks
from reports.words import NO_BREAK, number, percent, with_sd

_ROW_PX = 24.0
"""Height of a fruit's row, px: a line of text of 12 px and as much air."""
_BARS = 40
"""Most bars of a distribution: 20 px each on a desk, 8 px on a phone."""
_MOST_POINTS = 60
"""Of a control chart: beyond it the marks run together."""
UNKNOWN_LOT = "unknown"


def ranking_chart(batch: BatchEntry, *, width_px: int) -> Markup:
    """Modulus of every graded fruit, softest on top, whiskers of one standard deviation, limits as lines.

    The mark's colour and shape are the class. ``width_px`` is the width at which text has its natural
    size (about 340 for a phone, 860 for a desk).
    """
    graded = [fruit for fruit in ranked(without_references(batch.fruits)) if fruit.E_MPa is not None]
    wide = width_px >= 600
    ends = [fruit.E_MPa + (fruit.E_sd_MPa or 0.0) for fruit in graded if fruit.E_MPa is not None]
    lowest, highest = padded([*ends, *_near_limits(batch, ends)], from_zero=True)
    rows = max(len(graded), 1)
    plot = Plot(
        x_limits=(max(lowest, 0.0), highest),
        y_limits=(rows, 0.0),
        left=gutter([fruit.fruit_id for fruit in graded], most_px=0.3 * width_px),
        right=width_px - (130.0 if wide else 12.0),
        top=14.0,
        bottom=14.0 + _ROW_PX * rows,
    )
    marks = class_marks(tuple(name for name, _ in batch.classes))
    parts = [
        plot.axis_x(say("E, modulus of the flesh (MPa)"), at_most=9 if wide else 5),
        *_limit_lines(batch, plot),
        *(_ranking_row(fruit, plot, k + 0.5, wide=wide, marks=marks) for k, fruit in enumerate(graded)),
    ]
    each = "; ".join(f"{fruit.fruit_id} {with_sd(fruit.E_MPa, fruit.E_sd_MPa)} MPa" for fruit in graded)
    return drawing(
        *parts,
        width=float(width_px),
        height=plot.bottom + 44,
        title=say("Ranking, softest first"),
        description=each or say("No fruit has a modulus"),
    )


def distribution_chart(batch: BatchEntry, *, width_px: int) -> Markup:
    """How many fruit have which modulus: bars over E, coloured by the class that their middle falls in.

    Dashed lines are the limits of classes. ``width_px`` as of `ranking_chart`.
    """
    E_MPa = [fruit.E_MPa for fruit in without_references(batch.fruits) if fruit.E_MPa is not None]
    marks = class_marks(tuple(name for name, _ in batch.classes))
    highest = max([*E_MPa, *_near_limits(batch, E_MPa)])
    edges = ticks(0.0, 1.05 * highest, at_most=_BARS)
    step = edges[1] - edges[0]
    counts = np.bincount((np.array(E_MPa) / step).astype(int)).tolist()
    plot = Plot(
        x_limits=(0.0, max(len(counts) * step, 1.02 * highest)),
        y_limits=(0.0, 1.05 * max(counts)),
        left=44.0,
        right=width_px - 12.0,
        top=30.0,
        bottom=230.0,
    )
    parts = [
        plot.axis_x(say("E, modulus of the flesh (MPa)"), at_most=width_px // 80),
        plot.axis_y("fruits"),
    ]
    for k, count in enumerate(counts):
        middle = (k + 0.5) * step
        name = next((name for name, limit in batch.classes if limit is None or middle <= limit), "")
        colour, _ = marks.get(name, UNKNOWN)
        title = element("title", f"{k * step:g} to {(k + 1) * step:g} MPa: {count} fruits")
        left, right, y = plot.x(k * step) + 0.5, plot.x((k + 1) * step) - 0.5, plot.y(count)
        size = {"width": right - left, "height": plot.bottom - y}
        parts.append(element("rect", title, x=left, y=y, **size, fill=colour))
    return drawing(
        *parts,
        *_limit_lines(batch, plot),
        width=float(width_px),
        height=plot.bottom + 44,
        title=say("Distribution of moduli"),
        description="; ".join(
            f"{k * step:g} to {(k + 1) * step:g} MPa: {count}" for k, count in enumerate(counts) if count
        ),
    )


def _near_limits(batch: BatchEntry, E_MPa: list[float]) -> list[float]:
    """Limits of classes that the moduli come near; all where there is no modulus."""
    limits = [limit for _, limit in batch.classes if limit is not None]
    return [limit for limit in limits if not E_MPa or limit < 1.4 * max(E_MPa)]


def _limit_lines(batch: BatchEntry, plot: Plot) -> list[Markup]:
    """A dashed line at each limit in the plot."""
    return [
        rule(
            plot.x(limit),
            plot.x(limit),
            plot.top - 8,
            plot.bottom,
            class_="limit",
            title=f"{say('up to {limit} MPa', limit=with_comma(f'{limit:g}'))}: {name}",
        )
        for name, limit in batch.classes
        if limit is not None and limit <= plot.x.highest
    ]


def gutter(names: list[str], *, most_px: float) -> float:
    """Room for names at the left, px."""
    return min(max([len(name) for name in names] + [4]) * 7.4 + 14, most_px)


def _ranking_row(
    fruit: FruitEntry, plot: Plot, row: float, *, wide: bool, marks: dict[str, tuple[str, str]]
) -> Markup:
    """One fruit's line of the ranking: its name, E with its error bar, and its class's mark."""
    E_MPa, y = fruit.E_MPa or 0.0, plot.y(row)
    colour, shape = marks.get(fruit.maturity or "", UNKNOWN)
    value = with_sd(E_MPa, fruit.E_sd_MPa)
    words = f"{fruit.fruit_id}: {value} MPa"
    if fruit.maturity:
        words += f", {fruit.maturity} ({percent(fruit.maturity_probability)})"
    elif fruit.class_withheld:
        words += ", class withheld: E is in doubt"
    parts = [
        element("title", words),
        label(shortened(fruit.fruit_id, px=plot.left - 12), 0.0, y + 4.5),
        error_bar(plot.x, E_MPa, fruit.E_sd_MPa, y),
        marker(shape, plot.x(E_MPa), y, fill=colour),
    ]
    if wide:
        parts.append(label(value, plot.right + 124, y + 4.5, anchor="end", class_="value"))
    return element("g", *parts)


def shortened(text: str, *, px: float, px_per_letter: float = 7.4) -> str:
    """Text cut to a width, an ellipsis in the middle: both ends of an identifier tell it from its neighbours.

    >>> shortened("orchard-7-row-12-tree-3", px=100.0)
    'orchar…tree-3'
    """
    room = max(int(px / px_per_letter), 3)
    if len(text) <= room:
        return text
    tail = (room - 1) // 2
    return f"{text[: room - 1 - tail]}…{text[len(text) - tail :]}"


def shore_chart(batch: BatchEntry) -> Markup:
    """Modulus against the Shore OO reading of the same fruit; a mark per fruit, coloured by its class."""
    pairs = [
        (fruit, fruit.E_MPa, fruit.shore_oo)
        for fruit in ranked(without_references(batch.fruits))
        if fruit.E_MPa is not None and fruit.shore_oo is not None
    ]
    marks = class_marks(tuple(name for name, _ in batch.classes))
    plot = Plot(
        x_limits=padded(shore for _, _, shore in pairs),
        y_limits=padded((E_MPa + (fruit.E_sd_MPa or 0.0) for fruit, E_MPa, _ in pairs), from_zero=True),
        left=48.0,
        right=348.0,
        top=34.0,
        bottom=270.0,
    )
    parts = [plot.axis_x("Shore OO"), plot.axis_y("E (MPa)")]
    for fruit, E_MPa, shore in pairs:
        colour, shape = marks.get(fruit.maturity or "", UNKNOWN)
        words = f"{fruit.fruit_id}: Shore OO {number(shore)}, E {with_sd(E_MPa, fruit.E_sd_MPa)} MPa"
        bar = error_bar(plot.y, E_MPa, fruit.E_sd_MPa, plot.x(shore), upright=True)
        mark = marker(shape, plot.x(shore), plot.y(E_MPa), fill=colour)
        parts.append(element("g", element("title", words), bar, mark))
    return drawing(
        *parts,
        width=360.0,
        height=314.0,
        title=say("Modulus against Shore OO reading"),
        description=correlation_words(batch.shore) if batch.shore else f"{len(pairs)} fruits with both",
    )


def control_chart(body: ReferenceBodyEntry) -> Markup:
    """Found over known modulus of one reference body by time, oldest left; one mark a batch, at most 60.

    The inner pair of dashed lines is 1 with 2 of each point's standard deviations either way, the outer 3.
    """
    points = body.history[-_MOST_POINTS:]
    sds = [point.sd / point.ratio for point in points]
    moments = [point.time_utc.timestamp() for point in points]
    ends = [math.exp(way * 3 * sd) for sd in sds for way in (-1, 1)]
    plot = Plot(
        x_limits=padded(moments) if moments[-1] > moments[0] else (moments[0] - 1, moments[0] + 1),
        y_limits=padded([*ends, *(point.ratio for point in points)]),
        left=52.0,
        right=688.0,
        top=34.0,
        bottom=240.0,
    )
    x, y = plot.x, plot.y
    parts = [
        plot.axis_y(say("E measured / E known"), at_most=7),
        rule(plot.left, plot.right, y(1.0), y(1.0), class_="base"),
    ]
    across = [plot.left, *map(x, moments), plot.right]
    for limit in (-3, -2, 2, 3):
        heights = [y(math.exp(limit * sd)) for sd in (sds[0], *sds, sds[-1])]
        parts.append(polyline(across, heights, class_="limit"))
    for point, at, sd in zip(points, moments, sds, strict=True):
        z = math.log(point.ratio) / sd
        words = f"{point.time_utc:%Y-%m-%d %H:%M} UTC, lot {point.lot or UNKNOWN_LOT}: {point.ratio:.3f}"
        mark = marker("diamond" if abs(z) > 3 else "circle", x(at), y(point.ratio))
        parts.append(element("g", element("title", f"{words} ({z:+.1f} sd)"), mark))
    for k, anchor in ({0: "start", -1: "end"} if len(points) > 1 else {0: "middle"}).items():
        day = f"{points[k].time_utc:%Y-%m-%d}"
        parts.append(label(day, x(moments[k]), 258.0, anchor=anchor, class_="tick"))
    said = ", ".join(f"{point.time_utc:%Y-%m-%d} {point.ratio:.3f}" for point in points[-10:])
    return drawing(
        *parts,
        width=700.0,
        height=270.0,
        title=f"Control chart of {body.fruit_id}",
        description=f"E found over E known of the last batches: {said}",
    )


def correlation_words(shore: ShoreCorrelation) -> str:
    """The correlation in one line."""
    words = (
        f"{shore.n} fruits with both: Spearman rank correlation {shore.spearman:.2f}, "
        f"Pearson correlation {shore.pearson:.2f}"
    )
    if shore.p is None:
        return words
    p = f"<{NO_BREAK}0.001" if shore.p < 0.001 else f"={NO_BREAK}{shore.p:.3f}"
    return f"{words}, p{NO_BREAK}{p}"
