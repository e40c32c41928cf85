"""Closed triangle surfaces as they are handed in: what they must fulfil, and which boundary is whose."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.closest_point import closest_on_triangles, enclosed_volume_mm3
from fem.mesh.creases import Creases, creases_of
from fem.mesh.tetrahedra import pair_keys, pieces

#: least volume of a body, as a share of its longest side cubed
SMALLEST_FILL = 1e-5


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
    skin: tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]],
    pit_vertices_mm: Float[np.ndarray, "w 3"],
    *,
    thinnest_mm: float,
) -> None:
    """Raise PIT_OUTSIDE_FRUIT where a pit's vertex lies outside the closed, outward-oriented skin.

    Or so little inside, less than thinnest_mm, that the mesher would join the two.
    """
    vertices_mm, faces = skin
    near = closest_on_triangles(pit_vertices_mm, vertices_mm, faces)
    outside = winding_number(pit_vertices_mm, vertices_mm, faces) < 0.5
    if outside.any():
        out_mm = np.where(outside, near.distance_mm, -1.0)
        worst = int(out_mm.argmax())
        raise FemFailure(
            FemProblem.PIT_OUTSIDE_FRUIT,
            f"the pit protrudes {out_mm[worst]:.2f} mm from the fruit at "
            f"{_place(pit_vertices_mm[worst])} mm; check the pit prior and the scale of the scan",
        )
    thin = int(near.distance_mm.argmin())
    if near.distance_mm[thin] < thinnest_mm:
        raise FemFailure(
            FemProblem.PIT_OUTSIDE_FRUIT,
            f"the flesh between pit and skin is {near.distance_mm[thin]:.2f} mm thick at "
            f"{_place(pit_vertices_mm[thin])} mm, expected at least {thinnest_mm:.2f} mm for elements "
            "of this size. Check the pit's place and size, or use a finer mesh",
        )


def winding_number(
    points_mm: Float[np.ndarray, "p 3"],
    vertices_mm: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Float[np.ndarray, " p"]:
    """How often a closed surface winds round each point: 1 inside, 0 outside, but in the folds themselves.

    The sum of the triangles' solid angles over 4 pi (van Oosterom and Strackee 1983, "The solid angle of a
    plane triangle", IEEE Transactions on Biomedical Engineering 30). A simplified scan may hold a triangle
    turned inside out, whose normal alone would tell the wrong side.
    """
    turns = np.zeros(len(points_mm))
    for k, point in enumerate(points_mm):
        a, b, c = np.moveaxis(vertices_mm[faces] - point, 1, 0)
        x, y, z = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = np.einsum("fx,fx->f", a, np.cross(b, c))
        dots = (np.einsum("fx,fx->f", p, q) * r for p, q, r in ((a, b, z), (b, c, x), (c, a, y)))
        turns[k] = np.arctan2(volume, x * y * z + sum(dots)).sum() / (2 * np.pi)
    return turns


def must_lie_on(surface: Surface, points_mm: Float[np.ndarray, "p 3"], *, within_mm: float) -> None:
    """Raise OFF_SURFACE where a contact point is not finite, or farther than within_mm from the surface."""
    if not np.isfinite(points_mm).all():
        raise FemFailure(
            FemProblem.OFF_SURFACE, "a contact point has a non-finite coordinate; check pose and markers"
        )
    gap_mm = np.linalg.norm(surface.closest(points_mm) - points_mm, axis=1)
    worst = int(gap_mm.argmax())
    if gap_mm[worst] > within_mm:
        raise FemFailure(
            FemProblem.OFF_SURFACE,
            f"{(gap_mm > within_mm).sum()} of {len(points_mm)} contact points are more than "
            f"{within_mm:.1f} mm from the {surface.name}'s surface (the worst at "
            f"{_place(points_mm[worst])} mm, by {gap_mm[worst]:.1f} mm). Check the pad's pose in the "
            "fruit frame",
        )


def _place(point_mm: Float[np.ndarray, "3"]) -> str:
    return "(" + ", ".join(f"{x:.1f}" for x in point_mm) + ")"


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
            f"the {name} surface has {len(faces)} triangles on {len(vertices_mm)} vertices with "
            "missing or non-finite vertices; expected a closed surface in mm",
        )
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forward, backward = pair_keys(ends), pair_keys(ends[:, ::-1])
    open_edges = int((~np.isin(forward, backward)).sum() + len(forward) - len(np.unique(forward)))
    if open_edges:
        raise FemFailure(
            FemProblem.NOT_WATERTIGHT,
            f"the {name} surface has {open_edges} edges that do not join exactly two triangles of "
            "equal orientation; expected a closed surface. Repair the mesh",
        )
    volume_mm3 = enclosed_volume_mm3(vertices_mm, faces)
    if volume_mm3 < 0:
        faces, volume_mm3 = np.ascontiguousarray(faces[:, ::-1]), -volume_mm3
    size_mm = np.ptp(vertices_mm[np.unique(faces)], axis=0)
    if not volume_mm3 > SMALLEST_FILL * float(size_mm.max()) ** 3:
        raise FemFailure(
            FemProblem.BAD_SURFACE,
            f"the {name} surface encloses only {volume_mm3:.3g} mm3 in a box of "
            f"{' x '.join(f'{x:.3g}' for x in size_mm)} mm; expected a closed body in mm",
        )
    return Surface(name, vertices_mm, faces, volume_mm3)


def split_boundary(
    nodes_mm: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "k c"], *, with_pit: bool
) -> tuple[Int[np.ndarray, "o c"], Int[np.ndarray, "i c"]]:
    """The flesh's boundary, parted into the skin (the piece that reaches farthest) and the pit's face.

    Raises DISCONNECTED_FLESH where there are more or fewer pieces than a fruit with or without a pit has.
    """
    piece = pieces(faces, len(nodes_mm))
    reach = np.linalg.norm(nodes_mm[faces].mean(axis=1) - nodes_mm.mean(axis=0), axis=1)
    if piece.max() + 1 != 1 + with_pit:
        middle = [nodes_mm[np.unique(faces[piece == k])].mean(axis=0) for k in range(piece.max() + 1)]
        raise FemFailure(
            FemProblem.DISCONNECTED_FLESH,
            f"the flesh has {piece.max() + 1} separate boundaries, expected {1 + with_pit} (around "
            f"{', '.join(_place(m) for m in middle[:4])} mm). The pit may touch the skin, or the scan "
            "has holes inside",
        )
    skin = piece == piece[reach.argmax()]
    return faces[skin], faces[~skin]
