"""Closed triangle surfaces as they are handed in: what they must fulfil, and which boundary is whose."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from fem.creases import Creases, creases_of
from fem.failure import FemFailure, FemProblem
from fem.tets import pieces
from fem.triangles import closest_on_triangles, enclosed_volume_mm3


@dataclass(frozen=True)
class Surface:
    """A closed surface with outward normals."""

    name: str
    vertices_mm: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    volume_mm3: float

    def closest(self, points_mm: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """The surface's point next to each point."""
        return closest_on_triangles(points_mm, self.vertices_mm, self.faces).point_mm

    @cached_property
    def creases(self) -> Creases:
        """Its sharp edges and corners."""
        return creases_of(self.vertices_mm, self.faces)


def must_enclose(
    skin: tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]], pit_vertices_mm: Float[np.ndarray, "w 3"]
) -> None:
    """Raise PIT_OUTSIDE_FRUIT where a vertex of the pit lies outside the closed, outward-oriented skin."""
    vertices_mm, faces = skin
    near = closest_on_triangles(pit_vertices_mm, vertices_mm, faces)
    a, b, c = np.moveaxis(vertices_mm[faces[near.face]], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    out_mm = np.einsum("px,px->p", pit_vertices_mm - near.point_mm, normal)
    worst = int(out_mm.argmax())
    if out_mm[worst] >= 0:
        where = ", ".join(f"{x:.1f}" for x in pit_vertices_mm[worst])
        raise FemFailure(
            FemProblem.PIT_OUTSIDE_FRUIT,
            f"the pit pokes {out_mm[worst]:.2f} mm out of the fruit at ({where}) mm; "
            "check the pit prior and the scale of the scan",
        )


def checked_surface(
    vertices_mm: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], *, name: str
) -> Surface:
    """The surface, turned outward; raises BAD_SURFACE (NaN, indices) or NOT_WATERTIGHT (open edges)."""
    vertices_mm = np.ascontiguousarray(vertices_mm, dtype=float)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    if (
        len(faces) < 4
        or not np.isfinite(vertices_mm).all()
        or faces.min() < 0
        or faces.max() >= len(vertices_mm)
    ):
        raise FemFailure(
            FemProblem.BAD_SURFACE,
            f"the {name} surface has {len(faces)} triangles on {len(vertices_mm)} vertices with missing or "
            "non-finite ones; a closed surface in mm is expected",
        )
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forward = ends[:, 0] << 32 | ends[:, 1]
    backward = ends[:, 1] << 32 | ends[:, 0]
    open_edges = int((~np.isin(forward, backward)).sum() + len(forward) - len(np.unique(forward)))
    if open_edges:
        raise FemFailure(
            FemProblem.NOT_WATERTIGHT,
            f"the {name} surface has {open_edges} edges that do not join exactly two triangles of like "
            "orientation; a closed surface is expected: repair the mesh",
        )
    volume_mm3 = enclosed_volume_mm3(vertices_mm, faces)
    if volume_mm3 < 0:
        faces, volume_mm3 = np.ascontiguousarray(faces[:, ::-1]), -volume_mm3
    return Surface(name, vertices_mm, faces, volume_mm3)


def split_boundary(
    nodes_mm: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "k c"], *, with_pit: bool
) -> tuple[Int[np.ndarray, "o c"], Int[np.ndarray, "i c"]]:
    """The flesh's boundary, parted into the skin (the piece that reaches farthest) and the pit's face.

    Raises DISCONNECTED_FLESH where there are more or fewer pieces than a fruit with or without a pit has.
    """
    piece = pieces(faces, len(nodes_mm))
    if piece.max() + 1 != 1 + with_pit:
        raise FemFailure(
            FemProblem.DISCONNECTED_FLESH,
            f"the flesh has {piece.max() + 1} separate boundaries where {1 + with_pit} are expected; "
            "the pit may touch the skin, or the scan has holes inside",
        )
    reach = np.linalg.norm(nodes_mm[faces].mean(axis=1) - nodes_mm.mean(axis=0), axis=1)
    skin = piece == piece[reach.argmax()]
    return faces[skin], faces[~skin]
