"""Charts of a mismatch: E over time, force and residual without the effect and with it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from reports.charts import Chart, band, layer, padded, rounded, rules, without_outliers
from reports.explain_entries import ExplainEntry, Record
from reports.language import say
from reports.messages import message
from reports.words import effect_name, number, percent

ALL_PADS = "all"
"""Pad name of values that all pads determine together."""
_MARKS = ("circle", "square", "triangle", "diamond")
MOST_BARS = 8
"""Most explanations with a bar (set by hand): the bars of further ones would have no visible length."""
WITHOUT: Chart = {"colour": "before", "dashed": True}
WITH: Chart = {"colour": "pad0"}
"""Lines of the model without the effect and with it."""
Bar = tuple[str, float, str, str]
"""Words, length as a share of the full width, value in words, and the class of its colour."""


def evidence_bars(ranking: Sequence[Record], *, verdict: Sequence[str]) -> list[Bar]:
    """One bar per explanation: its length is the probability, the verdict has the strong colour."""
    return [
        (
            effect_name(candidate.effect),
            candidate.probability,
            percent(candidate.probability),
            "named" if candidate.effect in verdict else "noise",
        )
        for candidate in ranking[:MOST_BARS]
    ]


def rms_bars(heldout: Record, *, with_effect: bool) -> list[Bar]:
    """Normalised force residual on held-out recordings: without the effect, with it, and by noise alone.

    `with_effect`: whether an effect was found; otherwise the model has one bar.
    """
    model = [(say("with the effect") if with_effect else say("model"), heldout.rms_after, "named")]
    without = [(say("without"), heldout.rms_before, "before")] if with_effect else []
    rows = [*without, *model, (say("noise alone"), heldout.noise_rms, "noise")]
    longest = max(heldout.rms_before, heldout.rms_after, heldout.noise_rms, 1e-12)
    return [(words, value / longest, number(value), kind) for words, value, kind in rows]


def modulus_over_time(entry: ExplainEntry, *, with_effect: bool) -> list[Chart]:
    """One chart per grasp: E of each frame and pad (sd < 25 %) over time; E without and with the effect."""
    sure = [cell for cell in entry.cells if 0 < cell.E_sd_MPa < 0.25 * abs(cell.E_MPa)]
    if not sure:
        return []
    levels = [(entry.after.value, say("with the effect") if with_effect else say("all frames"), "pad0")]
    if with_effect:
        levels.insert(0, (entry.before.value, say("without"), "before"))
    levels = [known for known in levels if math.isfinite(known[0])]  # E may be withheld
    limits = padded([*without_outliers(cell.E_MPa for cell in sure), *(value for value, *_ in levels)])
    pads = sorted({cell.pad for cell in sure}, key=lambda pad: (pad == ALL_PADS, pad))
    ordered = sorted(sure, key=lambda cell: (cell.grasp, cell.time_s))
    return [
        _cells_chart(grasp, list(cells), levels, limits=limits, pads=pads)
        for grasp, cells in groupby(ordered, key=lambda cell: cell.grasp)
    ]


def _cells_chart(
    grasp: str,
    cells: list[Record],
    levels: list[tuple[float, str, str]],
    *,
    limits: tuple[float, float],
    pads: list[str],
) -> Chart:
    """E of one grasp's frames over time, with E without and with the effect as lines (`levels`)."""
    of_pads = {pad: [cell for cell in cells if cell.pad == pad] for pad in pads}
    means = {pad: np.mean([cell.E_MPa for cell in known] or [np.nan]) for pad, known in of_pads.items()}
    return {
        "title": say("E over time, {grasp}", grasp=grasp),
        "description": "; ".join(
            say("{pad}: mean {modulus} MPa", pad=_pad_words(pad), modulus=number(float(mean)))
            for pad, mean in means.items()
        ),
        "caption": grasp,
        "x": {"label": say("time (s)"), "limits": padded(cell.time_s for cell in cells)},
        "y": {"label": say("E of each frame (MPa)"), "limits": limits},
        "layers": [
            *_holds([(cell.time_s, cell.phase) for cell in cells], limits),
            *(rules("y", [value], colour=colour, name=words) for value, words, colour in levels),
            *(
                layer(
                    "marks",
                    [cell.time_s for cell in known],
                    [cell.E_MPa for cell in known],
                    y_sd=rounded(cell.E_sd_MPa for cell in known),
                    name=_pad_words(pad),
                    colour=f"pad{k % 4}",
                    shape=_MARKS[k % 4],
                )
                for k, (pad, known) in enumerate(of_pads.items())
            ),
        ],
    }


def force_and_residual(trace: Record, *, with_effect: bool) -> tuple[Chart, Chart]:
    """Force over approach, measured and modelled, and the models' residuals of the approach over time (µm).

    `with_effect`: whether an effect was found; otherwise the model has one line.
    """
    before = WITHOUT | {"name": say("without")}
    after = WITH | {"name": say("with the effect") if with_effect else say("model")}
    travel = np.concatenate([trace.given_mm, trace.before_mm, trace.after_mm])
    force: Chart = {
        "title": say("Force over approach, {grasp}", grasp=trace.grasp),
        "description": say(
            "Peak force {force} N", force=number(float(np.nanmax(trace.force_N, initial=0.0)))
        ),
        "x": {"label": say("how far the flesh gave way (mm)"), "limits": padded(travel, from_zero=True)},
        "y": {"label": say("force (N)"), "limits": padded(trace.force_N, from_zero=True)},
        "layers": [
            *([layer("line", trace.before_mm, trace.force_N, **before)] if with_effect else []),
            layer(
                "marks", trace.given_mm, trace.force_N, colour="soft", shape="circle", name=say("measured")
            ),
            layer("line", trace.after_mm, trace.force_N, **after),
        ],
    }
    leftover_um = {say("without"): 1e3 * (trace.given_mm - trace.before_mm)} if with_effect else {}
    leftover_um[say("with") if with_effect else say("model")] = 1e3 * (trace.given_mm - trace.after_mm)
    rms = {
        words: number(float(np.sqrt(np.nanmean(values**2))) if len(values) else 0.0)
        for words, values in leftover_um.items()
    }
    limits = padded([0.0, *np.concatenate(list(leftover_um.values()))])
    styles = [WITHOUT, WITH][-len(leftover_um) :]
    residual: Chart = {
        "title": say("Residual over time, {grasp}", grasp=trace.grasp),
        "description": say(
            "Root mean square {residuals}",
            residuals=", ".join(f"{value} µm {words}" for words, value in rms.items()),
        ),
        "x": {"label": say("time (s)"), "limits": padded(trace.time_s)},
        "y": {"label": say("measured less model (µm)"), "limits": limits},
        "layers": [
            *_holds(list(zip(trace.time_s.tolist(), trace.phase, strict=True)), limits),
            rules("y", [0.0]),
            *(
                layer("line", trace.time_s, values, **style | {"name": f"{words}: {rms[words]} µm"})
                for style, (words, values) in zip(styles, leftover_um.items(), strict=True)
            ),
        ],
    }
    return force, residual


def _pad_words(pad: str) -> str:
    return say("all pads") if pad == ALL_PADS else f"{say('pad')} {message(pad)}"


def _holds(frames: list[tuple[float, str]], limits: tuple[float, float]) -> Iterator[Chart]:
    """Bands behind the frames of a hold."""
    for phase, run in groupby(frames, key=lambda frame: frame[1]):
        if phase == "hold":
            times = [time_s for time_s, _ in run]
            low, high = limits
            yield band((min(times), max(times)), (low, low), (high, high))
