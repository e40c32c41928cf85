"""Outline and area of a contact patch, halfway between the markers that touch and those that do not."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import Delaunay


@dataclass(frozen=True)
class ContactPatch:
    """`area_mm2` on the gel's face; `outline_mm` are the segments of its border, in the pad's plane."""

    area_mm2: float
    outline_mm: Float[np.ndarray, "s 2 2"]


def patch_of(rest_mm: Float[np.ndarray, "n 3"], touching: Bool[np.ndarray, " n"]) -> ContactPatch:
    """The patch that these markers tell: every edge from a touching marker to one that is not is cut in half.

    A triangle of neighbouring markers then belongs to the patch wholly, by three quarters (two corners
    touch), by one quarter (one does), or not. The rim is known to half a spacing, without a bias: what counts
    the places between two markers as in or out is chance. `rest_mm` must not lie on a line.
    """
    plane = rest_mm[:, :2]
    triangles = Delaunay(plane).simplices
    corners, inside = plane[triangles], touching[triangles]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    whole = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2
    count = inside.sum(axis=1)
    area = float((whole * np.array([0.0, 0.25, 0.75, 1.0])[count]).sum())
    cut = (count == 1) | (count == 2)
    # The corner that is unlike the other two: the border runs between the middles of its two edges.
    odd = np.argmax(inside[cut] == (count[cut] == 1)[:, None], axis=1)
    turn = (odd[:, None] + np.arange(3)) % 3
    where = np.take_along_axis(corners[cut], turn[..., None], axis=1)
    return ContactPatch(area, (where[:, :1] + where[:, 1:]) / 2)
