"""Charts of every page: layers of marks, lines, areas and rules, which static/charts.js draws with uPlot.

Colours are names in static/palette.css. Two charts of the same `group` zoom along x together.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from datetime import date
from itertools import chain
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from markupsafe import Markup

from reports.entries import ReferenceBodyEntry
from reports.language import decimals, say
from reports.messages import message
from reports.words import number

Chart = dict[str, Any]
"""A chart for static/charts.js: title, description, caption, axes and layers."""
MOST_BATCHES = 60
"""A control chart shows at most this many batches; marks of more would overlap."""
EPOCH = date(1970, 1, 1)
"""Day zero of uPlot's axes with dates, as in Unix time."""
PER_POINT = ("tips", "y_ends", "y_sd")
"""Lists of a layer with one entry per point; an empty one has none."""


def layer(kind: str, x: Iterable[float], y: Iterable[float], **how: object) -> Chart:
    """Marks, a line or an area through the finite points, rounded: a pixel is a thousandth of the chart.
    `how`: colour, name, shape, `dashed`, `faint` (hollow marks), and lists with one entry per given point
    (PER_POINT).
    """
    places = np.column_stack([np.fromiter(x, float), np.fromiter(y, float)])
    finite = np.isfinite(places).all(axis=1)
    for name in PER_POINT:
        if values := how.get(name):
            how[name] = [value for value, kept in zip(cast("list", values), finite, strict=True) if kept]
    places = places[finite]
    return {"kind": kind, "x": rounded(places[:, 0]), "y": rounded(places[:, 1]), **how}


def band(x: Iterable[float], low: Iterable[float], high: Iterable[float]) -> Chart:
    """The area between two lines over x."""
    along = list(x)
    return layer("area", [*along, *along[::-1]], [*low, *[*high][::-1]], colour="cx")


def rules(
    along: str, at: Iterable[float], *, colour: str = "soft", name: str = "", names: Iterable[str] = ()
) -> Chart:
    """Dashed lines at values of the axis "x" or "y", with a `name` in the key, or `names` beside them."""
    words = {"name": name, "names": list(names)}
    return {"kind": "rules", "along": along, "at": rounded(at), "colour": colour, **words}


def rounded(values: Iterable[float]) -> list[float]:
    """The values to five significant digits; to eight from 1e4 on, for days."""
    return [float(f"{value:.{8 if abs(value) >= 1e4 else 5}g}") for value in values]


def padded(values: Iterable[float], *, from_zero: bool = False) -> tuple[float, float]:
    """Axis limits that contain all finite values with a margin of 6 %; never an empty interval."""
    finite = [value for value in values if math.isfinite(value)] or [0.0, 1.0]
    lowest, highest = min(finite), max(finite)
    if from_zero:
        lowest = min(lowest, 0.0)
    air = 0.06 * (highest - lowest) or 0.5 * abs(highest) or 0.5
    return (lowest if from_zero and lowest == 0.0 else lowest - air, highest + air)


def without_outliers(values: Iterable[float]) -> Float[np.ndarray, " k"]:
    """The values that lie no farther beyond the 5 and 95 % quantiles than these are apart, so that a pattern
    of more than one value in 20 keeps its place.

    >>> len(without_outliers([*range(40), 90.0, math.nan]))
    40
    """
    finite = np.array([value for value in values if math.isfinite(value)])
    low, high = np.quantile(finite, (0.05, 0.95)) if len(finite) else (0.0, 0.0)
    return finite[(finite >= 2 * low - high) & (finite <= 2 * high - low)]


def with_note(chart: Chart) -> Chart:
    """The chart; its caption counts the marks beyond its vertical axis, which are arrows at the edge."""
    low, high = chart["y"]["limits"]
    marks = chain(*(each["y"] for each in chart["layers"] if each["kind"] == "marks"))
    beyond = [value for value in marks if not low <= value <= high]
    if not beyond:
        return chart
    farthest = number(max(beyond, key=lambda value: abs(value - (low + high) / 2)))
    note = say("Arrows: {count} beyond the axis, the farthest at {value}", count=len(beyond), value=farthest)
    return chart | {"caption": f"{chart.get('caption', chart['title'])}. {note}"}


def day_limits(days: Iterable[float]) -> tuple[float, float]:
    """Limits of an axis with `dates` that contain all days, with a margin of 4 % and at least half a day."""
    held = list(days)
    air = max(0.04 * (max(held) - min(held)), 0.5)
    return min(held) - air, max(held) + air


def day_number(day: date) -> int:
    """Days since 1970-01-01, the unit of an axis with `dates`."""
    return (day - EPOCH).days


def script_json(content: object) -> str:
    """JSON on one line; it escapes every `<`, so that no text can close the script element."""
    text = json.dumps(content, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


class PlacedCharts:
    """Charts of one page, in the order of their places; the page's script draws each in its place."""

    def __init__(self) -> None:
        self._charts: list[Chart] = []

    def place(self, chart: Chart) -> Markup:
        """Add a chart and return its place in the page."""
        self._charts.append(with_note(chart))
        return Markup('<figure class="drawn"></figure>')

    def json(self) -> Markup:
        """JSON of all charts that have a place so far."""
        return Markup(script_json(self._charts))


def control_chart(body: ReferenceBodyEntry) -> Chart:
    """Measured over known modulus of one reference body over time: one mark per batch, the last 60 at most.

    Dashed lines are at exp(±2 s) and exp(±3 s), s = sd / ratio of each batch. Diamonds are beyond ±3 s.
    """
    points = body.history[-MOST_BATCHES:]
    days = [point.time_utc.timestamp() / 86400 for point in points]
    sds = np.array([point.sd / point.ratio for point in points])
    ends = [math.exp(way * 3 * sd) for sd in sds for way in (-1, 1)]
    tips = [
        say(
            "{day} UTC, lot {lot}: {ratio} ({deviation} sd)",
            day=f"{point.time_utc:%Y-%m-%d %H:%M}",
            lot=point.lot or say("unknown"),
            ratio=decimals(f"{point.ratio:.3f}"),
            deviation=decimals(f"{math.log(point.ratio) / sd:+.1f}"),
        )
        for point, sd in zip(points, sds, strict=True)
    ]
    limits = [
        layer("line", days, np.exp(limit * sds), colour="soft", dashed=True) for limit in (-3, -2, 2, 3)
    ]
    marks = {
        shape: [k for k, point in enumerate(points) if (abs(math.log(point.ratio)) > 3 * sds[k]) == beyond]
        for shape, beyond in (("circle", False), ("diamond", True))
    }
    last_ratios = "; ".join(
        f"{point.time_utc:%Y-%m-%d} {decimals(f'{point.ratio:.3f}')}" for point in points[-10:]
    )
    name = message(body.fruit_id)
    return {
        "title": say("Control chart of {body}", body=name),
        "description": say("E found over E known of the last batches: {ratios}", ratios=last_ratios),
        "caption": say(
            "Control chart of {body}. Each mark is a batch; dashed lines are at 2 and 3 of its standard "
            "deviations from 1",
            body=name,
        ),
        "x": {"label": "", "limits": day_limits(days), "dates": True},
        "y": {
            "label": say("E measured / E known"),
            "limits": padded([*ends, *(point.ratio for point in points)]),
        },
        "layers": [
            *limits,
            *(
                layer(
                    "marks",
                    [days[k] for k in those],
                    [points[k].ratio for k in those],
                    colour="ink",
                    shape=shape,
                    tips=[tips[k] for k in those],
                )
                for shape, those in marks.items()
            ),
        ],
    }
