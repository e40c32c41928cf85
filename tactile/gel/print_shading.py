"""How strongly the colours of one picture of a gel show that something is pressed into it.

A face that slopes turns to one light and away from another, so that the ratio of a picture's channels changes
within a fraction of the markers' spacing; uneven light and a change of exposure do neither. The logarithm of
each channel less their mean is therefore held against itself twice as blurred. What repeats at every marker
(its halo and rim) is taken out as the median over markers of what lies at the same place beside each. Where
all channels are one (grey pictures), the logarithm itself is taken.
"""

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial import cKDTree

SCALE = 0.2
"""Of the markers' spacing: standard deviation of the finer blur. Of 0.1, 0.2 and 0.3 the one that tells most
printed first frames from empty ones (benchmarks/gel_references.py FOLDER --half even)."""
HIDDEN_RADII, HIDDEN_SPACING = 1.5, 0.22
"""A marker hides the gel to so many of its radii, or to this share of the spacing, where that is more: its
edge is blurred by lens and codec. Set by hand."""
RIM = 0.3
"""Of the spacing: the picture's own edge, where blurs see half. Set by hand."""
CELLS = 11
"""Places beside a marker, in each direction, that are told apart: a ninth of the spacing each."""
CELL_SPAN = 1.3
"""Of the spacing, that they cover: the corners of a square between markers lie 0.71 from the nearest one."""
DARKEST = 8.0
"""Grey levels: darker pixels count as this, whose noise of one level is an eighth. Set by hand."""
QUANTILE = 0.95
"""Over the pixels: a print on a twentieth of the face counts."""
GREY_TO = 1.0
"""Grey levels by which channels may differ on average for a picture to be grey."""


def print_shading(
    picture: UInt8[np.ndarray, "h w 3"],
    markers_px: Float[np.ndarray, "n 2"],
    *,
    spacing_px: float,
    disc_px: float,
) -> float:
    """Relative change of colour within a fraction of a spacing that a twentieth of the gel exceeds.

    `markers_px`: where the picture has its markers, of radius `disc_px`. 0 where they hide all of the gel.
    """
    height, width = picture.shape[:2]
    light = np.log(np.maximum(cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.float32), DARKEST))
    grey = float(np.ptp(picture.astype(np.int16), axis=2).mean()) < GREY_TO
    colour = light[..., :1] if grey else light - light.mean(axis=2, keepdims=True)
    clear = np.ones((height, width), dtype=np.float32)
    hidden = round(max(HIDDEN_RADII * disc_px, HIDDEN_SPACING * spacing_px))
    for x, y in np.rint(markers_px[np.isfinite(markers_px[:, 0])]).astype(int).tolist():
        cv2.circle(clear, (x, y), hidden, 0.0, -1)
    detail = _blurred(colour, clear, SCALE * spacing_px) - _blurred(colour, clear, 2 * SCALE * spacing_px)
    rim = int(RIM * spacing_px)
    inner = np.zeros_like(clear)
    inner[rim : height - rim, rim : width - rim] = clear[rim : height - rim, rim : width - rim]
    rows, columns = np.nonzero(inner)
    if not len(rows):
        return 0.0
    own = detail[rows, columns] - _usual(detail[rows, columns], rows, columns, markers_px, spacing_px)
    return float(np.quantile(np.linalg.norm(own, axis=1), QUANTILE))


def _blurred(
    values: Float[np.ndarray, "h w c"], clear: Float[np.ndarray, "h w"], sigma: float
) -> Float[np.ndarray, "h w c"]:
    """Mean over clear pixels round about, by a Gaussian."""
    share = np.maximum(cv2.GaussianBlur(clear, (0, 0), sigma), 1e-6)
    total = cv2.GaussianBlur(values * clear[..., None], (0, 0), sigma).reshape(values.shape)
    return np.asarray(total / share[..., None])


def _usual(
    detail: Float[np.ndarray, "p c"],
    rows: np.ndarray,
    columns: np.ndarray,
    markers_px: Float[np.ndarray, "n 2"],
    spacing_px: float,
) -> Float[np.ndarray, "p c"]:
    """Of each pixel the median of `detail` over all that lie alike beside their nearest marker."""
    known = markers_px[np.isfinite(markers_px[:, 0])]
    place = np.stack([columns, rows], axis=1).astype(np.float64)
    offset = (place - known[np.asarray(cKDTree(known).query(place)[1])]) / (CELL_SPAN * spacing_px)
    cell = np.clip(np.floor((offset + 0.5) * CELLS), 0, CELLS - 1).astype(np.int64) @ [CELLS, 1]
    order = np.argsort(cell, kind="stable")
    starts = np.flatnonzero(np.diff(cell[order], prepend=-1))
    usual = np.zeros((CELLS * CELLS, detail.shape[1]))
    for first, end in zip(starts, [*starts[1:], len(order)], strict=True):
        usual[cell[order[first]]] = np.median(detail[order[first:end]], axis=0)
    return np.asarray(usual[cell])
