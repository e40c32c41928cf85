"""The page of `drupe firmness`: readings of standard tests, and what size and pit do to them at one E."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
from markupsafe import Markup

from reports.html_templates import page_environment
from reports.svg import Plot, drawing, label, padded

COLOURS = ("c0", "c2", "c3", "c4")
"""Of the lines, from no pit to the largest."""


@dataclass(frozen=True, kw_only=True)
class TradeWords:
    """A test: its column, what it is, its unit and where it comes from. `drawn_for`: the fruit of its chart,
    where not all.
    """

    name: str
    title: str
    unit: str
    source: str
    drawn_for: str = ""


@dataclass(frozen=True, kw_only=True)
class TradeFruit:
    """A fruit's readings by test, each with its standard deviation, or why there are none. NaN: out of the
    simulation's reach. `E_at`: moduli by the column of a limit. `doubt`: what cannot be right in its inputs.
    """

    fruit_id: str
    E_MPa: float | None = None
    E_sd_MPa: float | None = None
    diameter_mm: float | None = None
    pit_share: float | None = None
    readings: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    E_at: Mapping[str, float] = field(default_factory=dict)
    doubt: str = ""
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class SizeEffect:
    """Readings of round fruit of one E: by test, for each pit share a value at each diameter; NaN where
    none holds.
    """

    E_MPa: float
    poisson_ratio: float
    diameters_mm: Sequence[float]
    pit_shares: Sequence[float]
    values: Mapping[str, Sequence[Sequence[float]]]


@dataclass(frozen=True, kw_only=True)
class TradeEntry:
    """What the page shows. `graded_utc`: when the grading ended."""

    made_utc: datetime
    graded_utc: str
    folder: str
    tests: tuple[TradeWords, ...]
    fruit: tuple[TradeFruit, ...]
    sizes: SizeEffect


def trade_html(entry: TradeEntry) -> str:
    """The whole page, the same text for the same entry; all text of the batch is escaped."""
    return (
        page_environment()
        .get_template("templates/trade.html.j2")
        .render(
            charts=[size_chart(test, entry.sizes) for test in entry.tests],
            colours=COLOURS,
            entry=entry,
            made=f"{entry.made_utc:%Y-%m-%d %H:%M} UTC",
        )
    )


def size_chart(test: TradeWords, sizes: SizeEffect) -> Markup:
    """One test's reading over the diameter, a line for each pit."""
    values = np.array(sizes.values[test.name], dtype=float)
    diameters = np.array(sizes.diameters_mm, dtype=float)
    shown = np.isfinite(values)
    plot = Plot(
        x_limits=padded(diameters.tolist()),
        y_limits=padded(values[shown].tolist(), from_zero=True),
        left=52.0,
        right=306.0,
        top=34.0,
        bottom=190.0,
    )
    parts = [plot.axis_x("Diameter (mm)", at_most=7), plot.axis_y(test.unit, at_most=5)]
    for k, line in enumerate(values):
        if np.isfinite(line).any():
            parts.append(plot.line(diameters, line, class_=f"lot {COLOURS[k]}"))
    if not shown.any():
        parts.append(label("out of reach", 180.0, 110.0, anchor="middle"))
    ends = "; ".join(
        f"pit {share:.0%}: {line[there][0]:.3g} to {line[there][-1]:.3g} {test.unit}"
        for share, line, there in zip(sizes.pit_shares, values, shown, strict=True)
        if there.any()
    )
    reached = diameters[shown.any(axis=0)] if shown.any() else diameters
    return drawing(
        *parts,
        width=320.0,
        height=232.0,
        title=test.title,
        description=f"From {reached[0]:g} to {reached[-1]:g} mm at one E: {ends}",
    )
