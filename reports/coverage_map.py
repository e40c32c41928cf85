"""Map of how many photos show each part of a fruit's skin, from six sides."""

import numpy as np
from jaxtyping import Float, Int

from reports.skin_map import MapStyle, map_picture, sides_of

_STYLE = MapStyle(
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
    return map_picture(sides, counts, style=_STYLE, seen=views >= seen_by)
