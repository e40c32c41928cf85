"""Which of the skin the photos saw: how many cameras each vertex faces, and what was closed without one."""

import numpy as np
from jaxtyping import Float, Int

from recon.closed import face_areas, facing, vertex_normals

SEEN_BY = 2
"""Cameras that a place must face to count as seen: one alone tells no depth."""


def facing_views(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], places: Float[np.ndarray, "v 3"]
) -> Int[np.ndarray, " n"]:
    """How many of the cameras at `places` (mm) each vertex of a closed mesh faces.

    Skin that another part of the fruit hides, rare on stone fruit, is counted all the same.
    """
    normals = vertex_normals(vertices, faces)
    return np.asarray(sum((facing(vertices, normals, place) > 0).astype(int) for place in places))


def seen_and_unseen(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], views: Int[np.ndarray, " n"]
) -> tuple[float, float]:
    """The share of the skin that SEEN_BY cameras or more saw, and the area of the rest, mm^2.

    The rest is the hole in what the photos show, closed by the method. A triangle counts by its corners.
    """
    area = face_areas(vertices, faces)
    hole = float(area @ (views[faces] < SEEN_BY).mean(axis=1))
    return 1 - hole / float(area.sum()), hole
