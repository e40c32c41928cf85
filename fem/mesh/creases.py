"""Sharp edges of a surface as given, and the mesh edges that stand for them: a box stays a box."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fem.elements.shape_functions import TRI_EDGES
from fem.mesh.tetrahedra import unique_edges

#: two triangles whose normals differ by more than this meet in a crease; grooves of a scan turn less
SHARPEST_SMOOTH_DEG = 40.0
#: a mesh edge stands for a crease no farther from it than this share of its own length
REACH_SHARE = 0.15


@dataclass(frozen=True)
class Creases:
    """Straight pieces of sharp edges, and the corners where they end, meet or turn sharply."""

    start_mm: Float[np.ndarray, "s 3"]
    along_mm: Float[np.ndarray, "s 3"]
    corner_mm: Float[np.ndarray, "c 3"]

    def closest(self, points_mm: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "p 3"]:
        """The crease's point next to each point."""
        arm = points_mm[:, None] - self.start_mm
        share = np.einsum("psx,sx->ps", arm, self.along_mm) / np.einsum(
            "sx,sx->s", self.along_mm, self.along_mm
        )
        off = np.clip(share, 0, 1)[..., None] * self.along_mm - arm
        nearest = np.einsum("psx,psx->ps", off, off).argmin(axis=1)
        return np.asarray(points_mm + off[np.arange(len(points_mm)), nearest])

    def points_mm(self, *, apart_mm: float) -> Float[np.ndarray, "p 3"]:
        """Points along all creases, ends included, at most apart_mm from the next."""
        pieces = np.maximum(np.ceil(np.linalg.norm(self.along_mm, axis=1) / apart_mm), 1).astype(int)
        of = np.repeat(np.arange(len(pieces)), pieces + 1)
        step = np.arange(len(of)) - np.repeat(np.cumsum(pieces + 1) - pieces - 1, pieces + 1)
        return np.asarray(self.start_mm[of] + (step / pieces[of])[:, None] * self.along_mm[of])


def sharp_edges(
    vertices_mm: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Int[np.ndarray, "s 2"], Int[np.ndarray, "s 2"]]:
    """Edges of a closed surface where it turns sharply: their vertices, and (face, which of its edges)."""
    a, b, c = np.moveaxis(vertices_mm[faces], 1, 0)
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.maximum(size, np.finfo(float).tiny)
    edges, of_face = unique_edges(faces, TRI_EDGES)
    order = np.argsort(of_face.ravel(), kind="stable")
    paired = order[: 2 * len(edges)].reshape(-1, 2)  # closed: every edge has two faces
    left, right = paired.T // 3
    turn = np.degrees(np.arccos(np.clip(np.einsum("ex,ex->e", normal[left], normal[right]), -1, 1)))
    sharp = np.flatnonzero((turn > SHARPEST_SMOOTH_DEG) & (size[left, 0] > 0) & (size[right, 0] > 0))
    return edges[sharp], np.stack([left[sharp], paired[sharp, 0] % 3], axis=1)


def creases_of(vertices_mm: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Creases:
    """The creases of a closed surface."""
    edges, _ = sharp_edges(vertices_mm, faces)
    along = vertices_mm[edges[:, 1]] - vertices_mm[edges[:, 0]]
    meeting = np.bincount(edges.ravel(), minlength=len(vertices_mm))
    unit = along / np.linalg.norm(along, axis=1, keepdims=True)
    # where a crease runs straight on through a vertex, the unit vectors away from it sum to nothing
    away = np.zeros_like(vertices_mm)
    np.add.at(away, edges[:, 0], unit)
    np.add.at(away, edges[:, 1], -unit)
    bent = np.linalg.norm(away, axis=1) > 2 * np.sin(np.radians(SHARPEST_SMOOTH_DEG / 2))
    return Creases(vertices_mm[edges[:, 0]], along, vertices_mm[(meeting > 0) & ((meeting != 2) | bent)])


def corner_targets(
    nodes_mm: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    moving: Int[np.ndarray, " p"],
    creases: Creases,
) -> tuple[Int[np.ndarray, " q"], Float[np.ndarray, "q 3"]]:
    """Which corner nodes of a closed mesh boundary belong on creases, and where.

    Those among `moving` that end a sharp edge of the mesh and lie within reach of a crease. A corner of the
    creases takes the node next to it.
    """
    edges, _ = sharp_edges(nodes_mm, faces)
    if not len(edges) or not len(creases.start_mm):
        return np.empty(0, dtype=np.int64), np.empty((0, 3))
    reach = np.zeros(len(nodes_mm))
    length = np.linalg.norm(nodes_mm[edges[:, 1]] - nodes_mm[edges[:, 0]], axis=1)
    np.maximum.at(reach, edges.ravel(), np.repeat(REACH_SHARE * length, 2))
    ends = np.unique(edges)
    target = nodes_mm.copy()
    target[ends] = creases.closest(nodes_mm[ends])
    held = np.linalg.norm(target - nodes_mm, axis=1) <= reach
    if len(creases.corner_mm):
        gap = np.linalg.norm(nodes_mm[ends] - creases.corner_mm[:, None], axis=2)
        next_to = gap.argmin(axis=1)
        near = gap[np.arange(len(gap)), next_to] <= reach[ends[next_to]]
        target[ends[next_to[near]]] = creases.corner_mm[near]
    chosen = np.intersect1d(ends[held[ends]], moving)
    return chosen, target[chosen]


def middle_targets(
    nodes_mm: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "f 6"], creases: Creases
) -> tuple[Int[np.ndarray, " q"], Float[np.ndarray, "q 3"]]:
    """Which mid-edge nodes of a closed T6 boundary belong on creases, and where."""
    edges, of_face = sharp_edges(nodes_mm, faces[:, :3])
    if not len(edges) or not len(creases.start_mm):
        return np.empty(0, dtype=np.int64), np.empty((0, 3))
    middle = faces[of_face[:, 0], 3 + of_face[:, 1]]
    target = creases.closest(nodes_mm[middle])
    length = np.linalg.norm(nodes_mm[edges[:, 1]] - nodes_mm[edges[:, 0]], axis=1)
    held = np.linalg.norm(target - nodes_mm[middle], axis=1) <= REACH_SHARE * length
    return middle[held], target[held]
