"""Charts of a whole batch: the ranking, and the moduli against Shore readings."""

from __future__ import annotations

import math

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
from reports.svg import (
    AxisScale,
    axis_x,
    axis_y,
    drawing,
    element,
    error_bar_x,
    error_bar_y,
    marker,
    padded,
    polyline,
    ticks,
)
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
    names = tuple(name for name, _ in batch.classes)
    marks = class_marks(names)
    limits = [(name, limit) for name, limit in batch.classes if limit is not None]
    wide = width_px >= 600
    gutter = min(max([len(fruit.fruit_id) for fruit in graded] + [4]) * 7.4 + 14, 0.3 * width_px)
    value_px = 118.0 if wide else 0.0
    top, bottom = 14.0, 14.0 + _ROW_PX * max(len(graded), 1)
    ends = [fruit.E_MPa + (fruit.E_sd_MPa or 0.0) for fruit in graded if fruit.E_MPa is not None]
    near = [limit for _, limit in limits if not ends or limit < 1.4 * max(ends)]
    lowest, highest = padded([*ends, *near], from_zero=True)
    x = AxisScale(lowest=max(lowest, 0.0), highest=highest, start_px=gutter, end_px=width_px - value_px - 12)
    parts = [
        axis_x(
            x, label=say("E, modulus of the flesh (MPa)"), top=top, bottom=bottom, at_most=9 if wide else 5
        )
    ]
    for name, limit in limits:
        if limit <= highest:
            at = x(limit)
            words = f"{say('up to {limit} MPa', limit=with_comma(f'{limit:g}'))}: {name}"
            parts.append(
                element("line", element("title", words), x1=at, x2=at, y1=top - 8, y2=bottom, class_="limit")
            )
    for k, fruit in enumerate(graded):
        parts.append(
            _ranking_row(fruit, x=x, y=top + _ROW_PX * (k + 0.5), gutter=gutter, wide=wide, marks=marks)
        )
    return drawing(
        *parts,
        width=float(width_px),
        height=bottom + 44,
        title=say("Ranking, softest first"),
        description="; ".join(
            f"{fruit.fruit_id} {with_sd(fruit.E_MPa, fruit.E_sd_MPa)} MPa" for fruit in graded
        )
        or say("No fruit has a modulus"),
    )


def distribution_chart(batch: BatchEntry, *, width_px: int) -> Markup:
    """How many fruit have which modulus: bars over E, coloured by the class that their middle falls in.

    Dashed lines are the limits of classes. ``width_px`` as of `ranking_chart`.
    """
    E_MPa = [fruit.E_MPa for fruit in without_references(batch.fruits) if fruit.E_MPa is not None]
    limits = [(name, limit) for name, limit in batch.classes if limit is not None]
    marks = class_marks(tuple(name for name, _ in batch.classes))
    highest = max([*E_MPa, *(limit for _, limit in limits if limit < 1.4 * max(E_MPa))])
    edges = ticks(0.0, 1.05 * highest, at_most=_BARS)
    step = edges[1] - edges[0]
    counts = [0] * (len(edges) + 1)
    for value in E_MPa:
        counts[min(int(value / step), len(counts) - 1)] += 1
    last = max(k for k, count in enumerate(counts) if count) + 1
    x = AxisScale(lowest=0.0, highest=max(last * step, 1.02 * highest), start_px=44.0, end_px=width_px - 12.0)
    top, bottom = 30.0, 230.0
    y = AxisScale(lowest=0.0, highest=1.05 * max(counts), start_px=bottom, end_px=top)
    parts = [
        axis_x(x, label=say("E, modulus of the flesh (MPa)"), top=top, bottom=bottom, at_most=width_px // 80),
        axis_y(y, label="fruits", left=44.0, right=width_px - 12.0, at_most=6),
    ]
    for k, count in enumerate(counts[:last]):
        middle = (k + 0.5) * step
        name = next((name for name, limit in batch.classes if limit is None or middle <= limit), "")
        colour, _ = marks.get(name, UNKNOWN)
        words = f"{k * step:g} to {(k + 1) * step:g} MPa: {count} fruits"
        left, right = x(k * step) + 0.5, x((k + 1) * step) - 0.5
        bar = {"x": left, "y": y(count), "width": right - left, "height": bottom - y(count), "fill": colour}
        parts.append(element("rect", element("title", words), **bar))
    for name, limit in limits:
        if limit <= x.highest:
            title = element("title", f"{say('up to {limit} MPa', limit=with_comma(f'{limit:g}'))}: {name}")
            at = x(limit)
            parts.append(element("line", title, x1=at, x2=at, y1=top - 8, y2=bottom, class_="limit"))
    return drawing(
        *parts,
        width=float(width_px),
        height=bottom + 44,
        title=say("Distribution of moduli"),
        description="; ".join(
            f"{k * step:g} to {(k + 1) * step:g} MPa: {count}" for k, count in enumerate(counts) if count
        ),
    )


def _ranking_row(
    fruit: FruitEntry, *, x: AxisScale, y: float, gutter: float, wide: bool, marks: dict[str, tuple[str, str]]
) -> Markup:
    """One fruit's line of the ranking: its name, E with its error bar, and its class's mark."""
    E_MPa = fruit.E_MPa or 0.0
    colour, shape = marks.get(fruit.maturity or "", UNKNOWN)
    value = with_sd(E_MPa, fruit.E_sd_MPa)
    words = f"{fruit.fruit_id}: {value} MPa"
    if fruit.maturity:
        words += f", {fruit.maturity} ({percent(fruit.maturity_probability)})"
    elif fruit.class_withheld:
        words += ", class withheld: E is in doubt"
    row = [
        element("title", words),
        element("text", shortened(fruit.fruit_id, px=gutter - 12), x=0.0, y=y + 4.5, class_="label"),
        error_bar_x(x, E_MPa, fruit.E_sd_MPa, y),
        marker(shape, x(E_MPa), y, fill=colour),
    ]
    if wide:
        row.append(element("text", value, x=x.end_px + 124, y=y + 4.5, text_anchor="end", class_="value"))
    return element("g", *row)


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
    fruits = ranked(without_references(batch.fruits))
    pairs = [fruit for fruit in fruits if fruit.E_MPa is not None and fruit.shore_oo is not None]
    marks = class_marks(tuple(name for name, _ in batch.classes))
    tops = [(fruit.E_MPa or 0.0) + (fruit.E_sd_MPa or 0.0) for fruit in pairs]
    low_x, high_x = padded([fruit.shore_oo or 0.0 for fruit in pairs])
    low_y, high_y = padded(tops, from_zero=True)
    x = AxisScale(lowest=low_x, highest=high_x, start_px=48.0, end_px=348.0)
    y = AxisScale(lowest=low_y, highest=high_y, start_px=270.0, end_px=34.0)
    parts = [
        axis_x(x, label="Shore OO", top=34.0, bottom=270.0, at_most=7),
        axis_y(y, label="E (MPa)", left=48.0, right=348.0, at_most=6),
    ]
    for fruit in pairs:
        E_MPa, shore = fruit.E_MPa or 0.0, fruit.shore_oo or 0.0
        colour, shape = marks.get(fruit.maturity or "", UNKNOWN)
        words = f"{fruit.fruit_id}: Shore OO {number(shore)}, E {with_sd(E_MPa, fruit.E_sd_MPa)} MPa"
        parts.append(
            element(
                "g",
                element("title", words),
                error_bar_y(y, E_MPa, fruit.E_sd_MPa, x(shore)),
                marker(shape, x(shore), y(E_MPa), fill=colour),
            )
        )
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
    low, high = padded([*ends, *(point.ratio for point in points)])
    first, last = padded(moments) if moments[-1] > moments[0] else (moments[0] - 1, moments[0] + 1)
    x = AxisScale(lowest=first, highest=last, start_px=52.0, end_px=688.0)
    y = AxisScale(lowest=low, highest=high, start_px=240.0, end_px=34.0)
    parts = [
        axis_y(y, label=say("E measured / E known"), left=52.0, right=688.0, at_most=7),
        element("line", x1=52.0, x2=688.0, y1=y(1.0), y2=y(1.0), class_="base"),
    ]
    across = [52.0, *(x(at) for at in moments), 688.0]
    for limit in (-3, -2, 2, 3):
        heights = [y(math.exp(limit * sd)) for sd in (sds[0], *sds, sds[-1])]
        parts.append(polyline(across, heights, class_="limit"))
    for point, at, sd in zip(points, moments, sds, strict=True):
        z = math.log(point.ratio) / sd
        shape = "diamond" if abs(z) > 3 else "circle"
        words = f"{point.time_utc:%Y-%m-%d %H:%M} UTC, lot {point.lot or UNKNOWN_LOT}: {point.ratio:.3f}"
        parts.append(
            element("g", element("title", f"{words} ({z:+.1f} sd)"), marker(shape, x(at), y(point.ratio)))
        )
    ends_at = {0: "start", len(points) - 1: "end"} if len(points) > 1 else {0: "middle"}
    for k, anchor in ends_at.items():
        day = f"{points[k].time_utc:%Y-%m-%d}"
        parts.append(element("text", day, x=x(moments[k]), y=258.0, text_anchor=anchor, class_="tick"))
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
    return words + (
        f", p{NO_BREAK}<{NO_BREAK}0.001" if shore.p < 0.001 else f", p{NO_BREAK}={NO_BREAK}{shore.p:.3f}"
    )
