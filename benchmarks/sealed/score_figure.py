"""A figure of scores: psychometric curves on the left, the reliability diagram on the right."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from psychometric import fitted_curve
from scipy.special import expit
from sealed_report import reliability_bins
from sealed_scores import Scored, interval

RELIABILITY_BINS = np.linspace(0.0, 1.0, 6)
"""Of stated probabilities."""
KINDS = (("detected", "C0", "-", 0.96), ("named first", "C1", "--", 1.04))
"""Words, colour and line of the curves; the factor that keeps their points apart."""


def score_figure(
    stimuli: Sequence[float], seen: Sequence[Sequence[bool]], cases: Sequence[Scored], words: str
) -> Figure:
    """`stimuli`: amplitudes of cases with one effect over a bound that `words` describe. `seen`: whether each
    was detected, and whether it was named first. `cases`: of the reliability diagram.
    """
    picture = Figure(figsize=(10, 4.2), dpi=120, layout="constrained")
    left, right = picture.subplots(1, 2)
    order = np.argsort(stimuli)
    for (kind, colour, line, shift), truths in zip(KINDS, seen, strict=True):
        for group in np.array_split(order, min(8, max(len(order) // 4, 1))) if len(order) else ():
            middle = shift * float(np.exp(np.mean(np.log(np.array(stimuli)[group]))))
            _point(left, middle, [truths[k] for k in group], colour)
        curve = fitted_curve(stimuli, truths)
        if curve is not None:
            x = np.geomspace(min(stimuli) / 2, max(stimuli) * 2, 300)
            label = f"{kind}: half at {curve.half:.2g} bounds"
            left.plot(x, expit(curve.steepness * np.log(x / curve.half)), line, color=colour, label=label)
    left.set(
        xscale="log", xlabel=words, ylabel="share of cases", ylim=(-0.03, 1.03),
        title=f"{len(stimuli)} cases with one effect",
    )  # fmt: skip
    if left.get_legend_handles_labels()[0]:
        left.legend(loc="lower right")
    right.plot([0, 1], [0, 1], color="0.6", linewidth=1)
    bins = reliability_bins(cases, RELIABILITY_BINS).values()
    for stated, _, count, total in bins:
        _point(right, stated, [True] * count + [False] * (total - count), "C2")
        right.annotate(
            f"{total}", (stated, count / total), textcoords="offset points", xytext=(-8, -4), ha="right"
        )
    right.set(
        xlabel="stated probability of the first name", ylabel="share right", xlim=(0, 1), ylim=(-0.03, 1.03),
        title=f"{sum(total for *_, total in bins)} cases with a mismatch detected",
    )  # fmt: skip
    return picture


def _point(axes: Any, x: float, truths: Sequence[bool], colour: str) -> None:
    """A share with its 95 % interval."""
    middle = float(np.mean(truths))
    low, high = interval(sum(map(bool, truths)), len(truths))
    axes.errorbar(x, middle, [[middle - low], [high - middle]], fmt="o", color=colour, capsize=3)
