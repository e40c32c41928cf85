"""The control chart of a reference body, and what the Shore readings of a batch say in words."""

from __future__ import annotations

import math

from markupsafe import Markup

from reports.entries import ReferenceBodyEntry, ShoreCorrelation
from reports.language import say
from reports.svg import Plot, drawing, element, label, marker, padded, polyline, rule
from reports.words import NO_BREAK

_MOST_POINTS = 60
"""Of a control chart: beyond it the marks run together."""
UNKNOWN_LOT = "unknown"


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
