"""The page of `drupe firmness`: readings of standard tests, and how size and pit change them at one E."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, TypeAlias

import numpy as np

from reports.charts import Chart, layer, padded
from reports.html_templates import charted_page
from reports.language import ENGLISH, decimals, say, spoken
from reports.messages import message
from reports.words import reading_title

Test: TypeAlias = Any
"""A TradeTest of fem/firmness/trade_tests.py; this package imports nothing from fem."""
COLOURS = ("c0", "c2", "c3", "c4")
"""Colours of the lines, from no pit to the largest."""


@dataclass(frozen=True, kw_only=True)
class TradeFruit:
    """A fruit's readings by test with standard deviations, or the `reason` without any. NaN: beyond the range
    of the simulation. `E_at`: moduli by the column of a limit. `doubt`: a contradiction in its inputs.
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
    """Readings of round fruit of one E: by test, for each pit share a value at each diameter; NaN if no value
    is valid.
    """

    E_MPa: float
    poisson_ratio: float
    diameters_mm: Sequence[float]
    pit_shares: Sequence[float]
    values: Mapping[str, Sequence[Sequence[float]]]


def trade_html(
    tests: Sequence[Test],
    fruit: Sequence[TradeFruit],
    sizes: SizeEffect,
    *,
    made_utc: datetime,
    graded_utc: str,
    folder: str,
    language: str = ENGLISH,
) -> str:
    """The whole page; the same content gives the same text. It escapes all text of the batch.

    `graded_utc`: when the grading ended; `folder`: the results' folder; `language`: one of
    reports.language.LANGUAGES.
    """
    with spoken(language):
        return charted_page(
            "trade",
            charts=[size_chart(test, sizes) for test in tests],
            tests=tests,
            titles={test.name: reading_title(test.title) for test in tests},
            fruit=fruit,
            sizes=sizes,
            pit_words=_pit_words,
            made=f"{made_utc:%Y-%m-%d %H:%M} UTC",
            graded=graded_utc.replace("T", " ").replace("Z", " UTC") or "–",
            folder=folder,
        )


def _pit_words(share: float) -> str:
    return say("no pit") if share == 0 else f"{message('pit')} {decimals(f'{share:.2g}')}"


def size_chart(test: Test, sizes: SizeEffect) -> Chart:
    """One test's reading over the diameter, a line for each pit."""
    values = np.array(sizes.values[test.name], dtype=float)
    diameters = np.array(sizes.diameters_mm, dtype=float)
    shown = np.isfinite(values)
    pits = [_pit_words(share) for share in sizes.pit_shares]
    title, out_of_reach = reading_title(test.title), say("out of reach")
    ends = "; ".join(
        f"{pit}: {_range(line[there])} {test.unit}"
        for pit, line, there in zip(pits, values, shown, strict=True)
        if there.any()
    )
    reached = diameters[shown.any(axis=0)] if shown.any() else diameters
    only = f": {say('no pit, large fruit')}" if test.under_ball else ""
    return {
        "title": title,
        "description": f"{_range(reached)} mm: {ends or out_of_reach}",
        "caption": f"{title} ({test.unit}){only}{'' if shown.any() else f': {out_of_reach}'}",
        "x": {"label": say("Diameter (mm)"), "limits": padded(diameters)},
        "y": {"label": test.unit, "limits": padded(values[shown], from_zero=True)},
        "layers": [
            layer("line", diameters, line, colour=COLOURS[k], name=pits[k])
            for k, line in enumerate(values)
            if shown[k].any()
        ],
        "low": True,
    }


def _range(values: np.ndarray) -> str:
    low, high = (decimals(f"{value:.3g}") for value in (values[0], values[-1]))
    return say("{low} to {high}", low=low, high=high)
