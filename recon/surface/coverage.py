"""Which of the skin the photos saw: how many cameras see each vertex, and what was closed without one."""

import numpy as np
from jaxtyping import Float, Int

from recon.surface.ray_mesh import RayMesh
from recon.triangle_mesh import face_areas, facing, vertex_normals

SEEN_BY = 2
"""Cameras that must see a place for it to count as seen: one alone tells no depth."""
CLEAR = 1e-3
"""Rays start so far above the skin, as a share of the fruit's size, that its own facets do not hide it."""


def seeing_views(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], places: Float[np.ndarray, "v 3"]
) -> Int[np.ndarray, " n"]:
    """How many of the cameras at `places` (mm) see each vertex of a closed mesh: it faces them, unhidden."""
    skin = RayMesh(vertices, faces)
    normals = vertex_normals(vertices, faces)
    start = vertices + CLEAR * float(np.ptp(vertices, axis=0).max()) * normals
    views = np.zeros(len(vertices), dtype=np.int64)
    for place in places:
        hidden = skin.hidden(start, np.broadcast_to(place, start.shape))
        views += (facing(vertices, normals, place) > 0) & ~hidden
    return views


def seen_and_unseen(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], views: Int[np.ndarray, " n"]
) -> tuple[float, float]:
    """The share of the skin that SEEN_BY cameras or more saw, and the area of the rest, mm^2.

    The rest is the hole in what the photos show, closed by the method. A triangle counts by its corners.
    """
    area = face_areas(vertices, faces)
    hole = float(area @ (views[faces] < SEEN_BY).mean(axis=1))
    return 1 - hole / float(area.sum()), hole
