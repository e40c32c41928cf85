"""The printable marker mat: a PDF at true size, with one filled path per tag and a measuring bar."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path

_INK = "#000000"
_BAR_MM = 100.0
"""Length of the measuring bar: every ruler has it, and half a millimetre of misreading is only 0.5 %."""
_MM_PER_INCH = 25.4
"""By definition; matplotlib takes sizes in inches."""


def mat_sheet_pdf(
    corners_mm: Mapping[int, Float[np.ndarray, "4 3"]],
    bits: Mapping[int, Bool[np.ndarray, "k k"]],
    *,
    sheet_mm: tuple[float, float],
    title: str,
) -> bytes:
    """PDF of one page, ``sheet_mm`` wide and high, with the mat's origin at its centre, x right, y up.

    ``corners_mm`` holds each tag's outer corners as seen from above, top-left first, clockwise (z is
    ignored). ``bits`` holds its printed cells with their black frame, True where white. The circle for the
    fruit has the largest radius that leaves 3 mm to the tags (at least 2 mm). Bar and words are in the strip
    below the tags. The same arguments give the same bytes.

    Raises ValueError if there are no tags, a tag lacks its cells, or tags or bar (100 mm) exceed the sheet.
    """
    _refuse_what_does_not_fit(corners_mm, bits, sheet_mm)
    width, height = sheet_mm
    with rc_context({"pdf.fonttype": 42, "pdf.compression": 6, "font.family": "DejaVu Sans"}):
        figure = Figure(figsize=(width / _MM_PER_INCH, height / _MM_PER_INCH), facecolor="none")
        FigureCanvasPdf(figure)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_xlim(-width / 2, width / 2)
        axes.set_ylim(-height / 2, height / 2)
        axes.set_axis_off()
        for tag, corners in sorted(corners_mm.items()):
            axes.add_patch(PathPatch(tag_outline(corners, bits[tag]), facecolor=_INK, linewidth=0))
        everything = np.concatenate([corners[:, :2] for corners in corners_mm.values()])
        _centre(axes, max(_nearest_mm(corners_mm) - 3.0, 2.0))
        _bar_and_words(axes, lowest=float(everything[:, 1].min()), bottom=-height / 2, title=title)
        out = io.BytesIO()
        unsigned = {"Title": title, "Creator": None, "Producer": None, "CreationDate": None}
        figure.savefig(out, format="pdf", metadata=unsigned)
    return out.getvalue()


def tag_outline(corners: Float[np.ndarray, "4 3"], bits: Bool[np.ndarray, "k k"]) -> Path:
    """The black cells of one tag as a single compound path, which prints without hairlines between cells."""
    top_left, across, down = corners[0, :2], corners[1, :2] - corners[0, :2], corners[3, :2] - corners[0, :2]
    ring = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    rows, columns = np.moveaxis(np.argwhere(~bits)[:, None] + ring, -1, 0)[..., None] / len(bits)
    return Path.make_compound_path_from_polys(top_left + columns * across + rows * down)


def _refuse_what_does_not_fit(
    corners_mm: Mapping[int, Float[np.ndarray, "4 3"]],
    bits: Mapping[int, Bool[np.ndarray, "k k"]],
    sheet_mm: tuple[float, float],
) -> None:
    """Raises ValueError for a mat without tags, a tag without cells, or a mat larger than its sheet."""
    if not corners_mm:
        raise ValueError("The mat has no tags; expected at least one.")
    bare = sorted(set(corners_mm) - set(bits))
    if bare:
        raise ValueError(f"No cells are given for tag {bare[0]}.")
    needed = 2 * np.abs(np.concatenate([c[:, :2] for c in corners_mm.values()])).max(axis=0)
    needed = np.maximum(needed + np.array([0.0, 2 * _STRIP_MM]), np.array([_BAR_MM, 0.0]))
    if (needed > np.array(sheet_mm)).any():
        raise ValueError(
            f"The mat needs a sheet of {needed[0]:.0f} x {needed[1]:.0f} mm with its measuring bar; "
            f"the sheet is {sheet_mm[0]:.0f} x {sheet_mm[1]:.0f} mm."
        )


_STRIP_MM = 19.0
"""Height of the strip below the tags that holds the bar and the words."""


def _nearest_mm(corners_mm: Mapping[int, Float[np.ndarray, "4 3"]]) -> float:
    """Distance of the origin from the nearest tag's edges, mm."""
    tags = [corners[:, :2].astype(np.float32) for corners in corners_mm.values()]
    return min(abs(cv2.pointPolygonTest(tag, (0.0, 0.0), measureDist=True)) for tag in tags)


def _centre(axes: Axes, radius: float) -> None:
    """Draw circle and cross at the fruit's place, and the arrow along +x that its suture follows."""
    turn = np.linspace(0.0, 2 * np.pi, 181)
    fine: dict[str, Any] = {"color": "#777777", "lw": 0.5}
    axes.plot(radius * np.cos(turn), radius * np.sin(turn), **fine)
    arm = 0.3 * radius
    axes.plot([-arm, arm], [0.0, 0.0], **fine)
    axes.plot([0.0, 0.0], [-arm, arm], **fine)
    head = min(0.12 * radius, 3.0)
    axes.plot([0.45 * radius, 0.93 * radius - head], [0.0, 0.0], color="#444444", lw=1.0)
    end = 0.93 * radius
    axes.fill([end, end - head, end - head], [0.0, 0.45 * head, -0.45 * head], color="#444444", lw=0)
    words: dict[str, Any] = {"ha": "center", "fontsize": float(np.clip(radius / 4.5, 4.0, 8.0))}
    axes.text(0.69 * radius, 0.06 * radius, "suture", va="bottom", color="#444444", **words)
    axes.text(0.0, -0.55 * radius, "stand the fruit here,\nstem up", va="center", color="#777777", **words)


def _bar_and_words(axes: Axes, *, lowest: float, bottom: float, title: str) -> None:
    """Draws the measuring bar with instructions, and the mat's title."""
    y = max(lowest - 6.0, bottom + 13.0)
    half = _BAR_MM / 2
    ink: dict[str, Any] = {"facecolor": _INK, "linewidth": 0}
    axes.add_patch(Rectangle((-half, y - 0.4), _BAR_MM, 0.8, **ink))
    for x in (-half, half):
        inner = 0.4 if x < 0 else -0.4
        axes.add_patch(Rectangle((min(x, x + inner), y - 2.0), 0.4, 4.0, **ink))
    words: dict[str, Any] = {"ha": "center", "va": "top", "color": "#222222"}
    advice = "100 mm from end to end. Print at 100 % (no “fit to page”), then measure this bar."
    axes.text(0.0, y - 3.4, advice, fontsize=7.5, **words)
    axes.text(0.0, y - 7.2, title, fontsize=6.5, **words)
