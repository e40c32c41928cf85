"""Map of how well the place of a fruit's skin is known, from six sides."""

import numpy as np
from jaxtyping import Bool, Float, Int

from reports.skin_map import MapStyle, map_picture, sides_of

MOST_SHARE = 0.98
"""The bar reaches what this share of the seen vertices stays below: a few at the foot hide the rest."""
LEAST_MM = 0.1
"""The bar reaches at least so far, mm, so that a good surface does not look like a bad one."""


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
