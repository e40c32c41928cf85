"""Where size comes from: the mat's print, or the fruit's measured height; and the box in which a fruit may
stand.
"""

import numpy as np
from jaxtyping import Float

from recon.mat import Mat

PRINT_SCALE_SD = 0.001
Box = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]


def blank_box(mat: Mat) -> Box:
    """Lowest and highest corner of the space over the mat's blank centre, with room for a fruit that
    overhangs it.
    """
    inner = min(float(np.abs(corners[:, :2]).max(1).min()) for corners in mat.corners_mm.values())
    half = max(inner, 0.12 * mat.width_mm)
    return np.array([-1.45 * half, -1.45 * half, 0.0]), np.array([1.45 * half, 1.45 * half, 2.7 * half])


def scaled_to_height(
    vertices: Float[np.ndarray, "n 3"], height_mm: float
) -> tuple[Float[np.ndarray, "n 3"], float]:
    """Vertices scaled about the origin so that they are `height_mm` tall along z, and the factor."""
    factor = height_mm / float(np.ptp(vertices[:, 2]))
    return vertices * factor, factor


def with_print_error(scale_sd: float) -> float:
    """Relative standard deviation of a scale taken from the mat: the fit's and the print's, in quadrature.

    The print is taken to be true to 0.1 % once its bar was measured (assumed: that is 0.1 mm in 100 mm, about
    what a good ruler or a caliper tells; paper that swells in damp air is not in it).

    >>> with_print_error(0.0)
    0.001
    """
    return float(np.hypot(scale_sd, PRINT_SCALE_SD))


def spread_of_scale(height_mm: float, height_sd_mm: float, surface_sd_mm: float) -> float:
    """Relative standard deviation of a scale taken from the height: the caliper's error and that of two mesh
    ends.
    """
    return float(np.hypot(height_sd_mm, np.sqrt(2) * surface_sd_mm) / height_mm)
