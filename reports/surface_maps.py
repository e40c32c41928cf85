"""Maps of a fruit's skin from six sides: how many photos show each part, and how well its place is known."""

import numpy as np
from jaxtyping import Bool, Float, Int

from reports.skin_map import MapStyle, map_picture, sides_of

MOST_SHARE = 0.98
"""The bar reaches what this share of the seen vertices stays below: a few at the foot hide the rest."""
LEAST_MM = 0.1
"""The bar reaches at least so far, mm, so that a good surface does not look like a bad one."""


_COVERAGE = MapStyle(
    low="photos that show it", high="", signed=False, hatched="not seen, closed by the method", least=1.0
)
"""`least`: the colour scale ends at one photo at least, so that a skin that none shows is drawn too."""


def coverage_map(
    vertices_mm: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "m 3"],
    views: Int[np.ndarray, " n"],
    *,
    seen_by: int,
) -> bytes:
    """PNG of the fruit (fruit frame, mm) coloured by `views`, hatched where fewer than `seen_by` show it."""
    counts = views.astype(float)
    sides = sides_of(vertices_mm, triangles, counts, hatched_below=seen_by, view_px=200)
    return map_picture(sides, counts, style=_COVERAGE, seen=views >= seen_by)


def surface_sd_map(
    vertices_mm: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "m 3"],
    sd_mm: Float[np.ndarray, " n"],
    *,
    seen: Bool[np.ndarray, " n"],
) -> bytes:
    """PNG of the fruit (fruit frame, mm) coloured by the standard deviation of its surface at each vertex.

    Hatched where a vertex was not `seen`; its sd is a guess from the shape around it.
    """
    top = float(np.quantile(sd_mm[seen], MOST_SHARE)) if seen.any() else LEAST_MM
    style = MapStyle(
        low="standard deviation of the surface (mm)",
        high="",
        signed=False,
        hatched="seen by fewer than two photos",
        least=LEAST_MM,
    )
    sides = sides_of(vertices_mm, triangles, seen.astype(float), hatched_below=0.5, view_px=200)
    return map_picture(sides, np.minimum(sd_mm, max(top, LEAST_MM)), style=style, seen=seen)
