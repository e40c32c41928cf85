"""Diagrams of the sealed proof: reliability, and psychometric curves. PNG and SVG."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from psychometric import fitted_curve
from sealed_report import SEEN, STIMULI, name_probabilities
from sealed_scores import Scored, scored

mpl.use("Agg")
import matplotlib.pyplot as plt

SIZE_INCHES = (8.0, 3.6)
"""Of each figure: two panels side by side."""


def draw_figures(folder: Path, rows: Sequence[Mapping[str, Any]], labels: Mapping[str, Any]) -> None:
    """Write reliability-ABLATION and psychometric-ABLATION of each alteration that has answers."""
    folder.mkdir(parents=True, exist_ok=True)
    answered = [row for row in rows if "failure" not in row]
    for ablation in dict.fromkeys(str(row["ablation"]) for row in answered):
        cases = [scored(row, labels[row["case"]]) for row in answered if row["ablation"] == ablation]
        _reliability(folder / f"reliability-{ablation}", cases)
        _curves(folder / f"psychometric-{ablation}", [one for one in cases if one.kind == "single"])


def _reliability(path: Path, cases: Sequence[Scored]) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=SIZE_INCHES, layout="constrained")
    p = np.sort([one.p for one in cases if one.kind == "sound"])
    left.step(np.r_[0, p, 1], np.r_[0, np.arange(1, len(p) + 1) / max(len(p), 1), 1], where="post")
    left.plot([0, 1], [0, 1], ":", color="grey")
    left.set(xlabel="p", ylabel="share of sound cases below", title=f"p of {len(p)} sound cases")
    said = name_probabilities(cases)
    if said:
        q, true = (np.array(x, dtype=float) for x in zip(*said, strict=True))
        order = np.argsort(q)
        parts = np.array_split(order, min(6, len(order)))
        right.plot([q[k].mean() for k in parts], [true[k].mean() for k in parts], "o-")
    right.plot([0, 1], [0, 1], ":", color="grey")
    right.set(xlabel="probability of the first name", ylabel="share true", title=f"{len(said)} named cases")
    _saved(figure, path)


def _curves(path: Path, singles: Sequence[Scored]) -> None:
    figure, panels = plt.subplots(1, 2, figsize=SIZE_INCHES, layout="constrained")
    for panel, (words, stimulus) in zip(panels, STIMULI, strict=True):
        for seen, how, mark in zip(SEEN, ("detected", "named first"), "ox", strict=True):
            usable = [(x, seen(one)) for one in singles if (x := stimulus(one)) is not None and x > 0]
            x, y = [x for x, _ in usable], [y for _, y in usable]
            curve = fitted_curve(x, y)
            if curve is not None:
                along = np.geomspace(min(x), max(x), 100)
                panel.plot(along, [curve.share(one) for one in along], label=how)
            panel.plot(x, np.array(y, dtype=float), mark, alpha=0.5, color="grey")
        panel.set(xscale="log", xlabel=words, ylabel="share of single effects")
    if panels[1].get_legend_handles_labels()[1]:
        panels[1].legend()
    _saved(figure, path)


def _saved(figure: "plt.Figure", path: Path) -> None:
    for suffix in (".png", ".svg"):
        figure.savefig(path.with_suffix(suffix), dpi=120)
    plt.close(figure)
