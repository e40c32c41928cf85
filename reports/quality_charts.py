"""Charts of the history for quality managers: operating characteristics, and readings against E."""

from __future__ import annotations

from markupsafe import Markup

from reports.history_entries import AcceptanceEntry, FirmnessEntry
from reports.svg import Plot, drawing, element, label, marker, padded, rule


def characteristic_chart(plan: AcceptanceEntry, *, width_px: int) -> Markup:
    """Probability of acceptance over nonconforming fruit, for a long series of lots (line) and for this lot
    (dashed); the AQL as an upright line.
    """
    percent, *probabilities = plan.curve.T
    plot = _plot(padded([*percent], from_zero=True), (0.0, 1.0), width_px)
    parts = [plot.axis_x("Nonconforming fruit (%)"), plot.axis_y("Probability of acceptance")]
    parts += [
        plot.line(percent, probability, class_=class_)
        for probability, class_ in zip(probabilities, ("model pad0", "oc"), strict=False)
    ]
    if plan.aql <= plot.x_limits[1]:
        x = plot.x(plan.aql)
        parts.append(rule(x, x, plot.top, plot.bottom, class_="limit", title=f"AQL {plan.aql:g} %"))
        parts.append(label(f"AQL {plan.aql:g} %", x + 5, plot.top + 12, class_="tick"))
    return drawing(
        *parts,
        width=float(width_px),
        height=plot.bottom + 42.0,
        title="Operating characteristic",
        description=f"{plan.words}. {plan.risks}.",
    )


def firmness_chart(relation: FirmnessEntry, *, width_px: int) -> Markup:
    """Readings of single fruit over E, the fitted line and the band of 90 % of further fruit."""
    highest = [] if relation.line is None else [*relation.line[:, 3]]
    readings = padded([*relation.reading_N, *highest], from_zero=True)
    plot = _plot(padded([*relation.E_MPa]), readings, width_px)
    parts = [plot.axis_x("E, modulus of the flesh (MPa)"), plot.axis_y("Reading (N)")]
    if relation.line is not None:
        E, line, low, high = relation.line.T
        edges = [*zip(E, high, strict=True), *[*zip(E, low, strict=True)][::-1]]
        points = " ".join(f"{plot.x(float(x)):.1f},{plot.y(float(F)):.1f}" for x, F in edges)
        parts += [element("polygon", points=points, class_="band"), plot.line(E, line, class_="model pad0")]
    pairs = zip(relation.E_MPa, relation.reading_N, strict=True)
    parts += [
        marker("circle", plot.x(float(E)), plot.y(float(F)), size=2.6, class_="single") for E, F in pairs
    ]
    return drawing(
        *parts,
        width=float(width_px),
        height=plot.bottom + 42.0,
        title=f"Readings against E, {relation.title}",
        description=relation.words,
    )


def _plot(x_limits: tuple[float, float], y_limits: tuple[float, float], width_px: int) -> Plot:
    return Plot(
        x_limits=(max(x_limits[0], 0.0), x_limits[1]),
        y_limits=(max(y_limits[0], 0.0), y_limits[1]),
        left=52.0,
        right=width_px - 14.0,
        top=34.0,
        bottom=240.0,
    )
