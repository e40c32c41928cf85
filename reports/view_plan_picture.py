"""A fruit from above with the places that photos were taken from, and where to stand for the next ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Wedge

from reports.figures import png_of

_TAKEN, _GAP, _STAND, _FRUIT = "#1d4e89", "#f3c9b8", "#b3361b", "#fdbd78"


def view_plan_picture(
    *,
    names: Sequence[str],
    azimuth_deg: Sequence[float],
    distance: Sequence[float],
    unplaced: Sequence[str],
    gaps_deg: Sequence[tuple[float, float]],
    stand_deg: Sequence[float],
) -> bytes:
    """PNG: photos as dots with their names, sides without any shaded, crosses where to stand.

    Azimuths in degrees, anticlockwise from the first photo, which is drawn at the bottom: the reader stands
    there. Distances in one unit, scaled to their median.
    """
    figure = Figure(figsize=(6.4, 6.8), dpi=100, facecolor="white")
    axes = figure.add_axes((0.02, 0.09, 0.96, 0.84))
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_xlim(-1.75, 1.75)
    axes.set_ylim(-1.6, 1.6)
    for low, high in gaps_deg:
        axes.add_patch(Wedge((0, 0), 1.25, low - 90, high - 90, width=0.9, color=_GAP))
        text = _at((low + high) / 2, 0.62)
        axes.text(
            *text, f"no photo\n{high - low:.0f} degrees", ha="center", va="center", fontsize=9, color=_STAND
        )
    axes.add_patch(Circle((0, 0), 0.24, facecolor=_FRUIT, edgecolor="black"))
    axes.text(0, 0, "fruit", ha="center", va="center", fontsize=10)
    usual = float(np.median(distance)) if len(distance) else 1.0
    for name, angle, away in zip(names, azimuth_deg, distance, strict=True):
        radius = float(np.clip(away / usual, 0.75, 1.25))
        x, y = _at(angle, radius)
        axes.plot([x], [y], "o", color=_TAKEN, markersize=9)
        axes.plot([0.26 * x / radius, x], [0.26 * y / radius, y], color=_TAKEN, linewidth=0.6, alpha=0.5)
        axes.text(*_at(angle, radius + 0.2), name, ha="center", va="center", fontsize=8, color=_TAKEN)
    for angle in stand_deg:
        x, y = _at(angle, 1.0)
        axes.plot([x], [y], "X", color=_STAND, markersize=15)
        axes.text(
            *_at(angle, 1.28), f"stand here\n({angle:.0f}°)", ha="center", va="center", fontsize=9,
            color=_STAND, weight="bold",
        )  # fmt: skip
    figure.text(0.5, 0.965, "From above: where the photos were taken", ha="center", fontsize=12)
    below = f"Degrees run to the right around the fruit from {names[0]} (below)." if names else ""
    if unplaced:
        some = ", ".join(unplaced[:5]) + (f" and {len(unplaced) - 5} more" if len(unplaced) > 5 else "")
        below += f"\nNot placed: {some}"
    figure.text(0.5, 0.03, below, ha="center", fontsize=9)
    return png_of(figure)


def _at(azimuth_deg: float, radius: float) -> tuple[float, float]:
    angle = np.radians(azimuth_deg - 90.0)
    return float(radius * np.cos(angle)), float(radius * np.sin(angle))
