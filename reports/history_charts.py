"""Charts of the history: softening, lots of a cultivar, operating characteristics, and readings against E."""

from __future__ import annotations

import numpy as np

from reports.charts import Chart, band, day_limits, day_number, layer, padded, rounded, rules
from reports.history_entries import AcceptanceEntry, FirmnessEntry, GroupEntry, SeriesEntry
from reports.language import decimals, fruit_count, say
from reports.palette import class_marks
from reports.words import lot_words, number, plunger_words

_MOST_SINGLE = 400
"""Most single fruit drawn per day: marks of more would overlap."""


def softening_chart(series: SeriesEntry) -> Chart:
    """Single fruit, daily means with 90 % intervals, the fitted law with its band, dashed class limits."""
    first = day_number(series.days[0].day)
    law, days = series.softening, series.days
    single = [(day_number(day.day), E) for day in days for E in day.single_E_MPa[:_MOST_SINGLE]]
    values = [value for day in days for value in (*day.single_E_MPa, day.E_high_MPa)]
    near = [limit for limit in series.limits if limit.E_max_MPa < 1.4 * max(values)]
    low, high = padded([*values, *(limit.E_max_MPa for limit in near)], from_zero=True)
    at_days = [day_number(day.day) for day in days]
    along = [] if law is None else [first + float(day) for day in law.day]
    layers = [rules("y", [limit.E_max_MPa for limit in near], names=[limit.name for limit in near])]
    if law is not None:
        layers += [
            band(along, law.E_low_MPa, np.minimum(law.E_high_MPa, high)),
            layer("line", along, np.minimum(law.E_MPa, high), colour="pad0"),
        ]
    singles = [float(day) for day, _ in single], [E for _, E in single]
    layers.append(layer("marks", *singles, colour="noise", faint=True, tips=[]))
    layers.append(
        layer(
            "marks",
            at_days,
            [day.E_MPa for day in days],
            colour="ink",
            shape="diamond",
            y_ends=[rounded((day.E_low_MPa, day.E_high_MPa)) for day in days],
            tips=[
                say(
                    "{day}: geometric mean {E} MPa ({low} to {high}, 90 %) of {count} fruit",
                    day=day.day,
                    E=number(day.E_MPa),
                    low=number(day.E_low_MPa),
                    high=number(day.E_high_MPa),
                    count=day.fruit,
                )
                for day in days
            ],
        )
    )
    last = "; ".join(f"{day.day} {number(day.E_MPa)} MPa ({fruit_count(day.fruit)})" for day in days[-10:])
    return {
        "title": say("Modulus over days, {lot}", lot=lot_words(series.name)),
        "description": say("Geometric means of the last days: {means}", means=last),
        "x": {"label": "", "limits": day_limits([*at_days, *along]), "dates": True},
        "y": {"label": say("E, modulus of the flesh (MPa)"), "limits": (max(low, 0.0), high)},
        "layers": layers,
    }


def lots_chart(group: GroupEntry) -> Chart:
    """Daily geometric means of every lot of a cultivar; each lot has a line, a colour and a shape."""
    marks = class_marks(tuple(lot.lot for lot in group.series))
    layers = []
    for lot in group.series:
        colour, shape = marks[lot.lot]
        means = [day_number(day.day) for day in lot.days], [day.E_MPa for day in lot.days]
        layers.append(layer("line", *means, colour=colour))
        name = lot.lot or say("without a lot")
        layers.append(layer("marks", *means, colour=colour, shape=shape, name=name))
    last = "; ".join(
        f"{lot_words(lot.name)}: {lot.days[-1].day} {number(lot.days[-1].E_MPa)} MPa" for lot in group.series
    )
    return {
        "title": say("Lots of {group} over days", group=lot_words(group.name)),
        "description": say("Geometric means of the last days: {means}", means=last),
        "x": {"label": "", "limits": day_limits(x for each in layers for x in each["x"]), "dates": True},
        "y": {
            "label": say("E, geometric mean (MPa)"),
            "limits": padded((y for each in layers for y in each["y"]), from_zero=True),
        },
        "layers": layers,
    }


def characteristic_chart(plan: AcceptanceEntry) -> Chart:
    """Probability of acceptance over nonconforming fruit (%), for lots of a long series and, by attributes,
    for this lot. A dashed vertical line marks the AQL.
    """
    percent, *probabilities = plan.curve.T
    styles = (
        {"colour": "pad0", "name": say("lots of a long series")},
        {"colour": "noise", "name": say("one lot")},
    )
    return {
        "title": say("Operating characteristic"),
        "description": f"{plan.words}. {plan.risks}.",
        "caption": say("The dashed line is the AQL, {aql} %.", aql=decimals(f"{plan.aql:g}")),
        "x": {"label": say("Nonconforming fruit (%)"), "limits": padded(percent, from_zero=True)},
        "y": {"label": say("Probability of acceptance"), "limits": (0.0, 1.0)},
        "layers": [
            rules("x", [plan.aql]),
            *(
                layer("line", percent, probability, **style)
                for probability, style in zip(probabilities, styles, strict=False)
            ),
        ],
    }


def firmness_chart(relation: FirmnessEntry) -> Chart:
    """Readings of single fruit over E, the fitted line, and the band that holds 90 % of further fruit."""
    highest = [] if relation.line is None else [*relation.line[:, 3]]
    layers = [layer("marks", relation.E_MPa, relation.reading_N, colour="noise")]
    if relation.line is not None:
        E, line, low, high = relation.line.T
        layers = [band(E, low, high), layer("line", E, line, colour="pad0"), *layers]
    return {
        "title": say("Readings against E, {name}", name=plunger_words(relation)),
        "description": relation.words,
        "x": {"label": say("E, modulus of the flesh (MPa)"), "limits": padded(relation.E_MPa)},
        "y": {"label": say("Reading (N)"), "limits": padded([*relation.reading_N, *highest], from_zero=True)},
        "layers": layers,
    }
