"""The pit in the fruit: placed by the category's prior, cut out by an exact Boolean (manifold3d)."""

import hashlib
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import manifold3d
import numpy as np
from jaxtyping import Bool, Float, Int

from recon.pit.priors import MeasuredPit, PitPrior, load_prior
from recon.recon_failure import ReconFailure, ReconProblem
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import SUFFIXES, read_mesh
from recon.surface.ray_mesh import RayMesh
from recon.triangle_mesh import Faces, Mesh, Vertices, bodies, open_edges, used_part, volume_mm3


def load_pit(named: str | Path, *, category: str) -> PitPrior:
    """The pit prior of a category or a TOML file, or a category's prior with the mesh of a measured pit.

    The mesh is in mm with z to the stem end and x to the suture. It keeps its size. Its box's centre moves to
    the category's pit centre, or to the fruit's middle if the category leaves the pit to the batch. Spreads
    and Poisson's ratio stay the category's. Raises ReconFailure: no-prior, bad-prior (a faulty file, or not
    of a pit's size), unreadable-mesh, not-watertight.
    """
    path = Path(named)
    if path.suffix.lower() not in SUFFIXES:
        return load_prior(named)
    prior = load_prior(category)
    if not path.is_file():
        raise ReconProblem.NO_PRIOR.failure(
            f"{path} is not a file; give the mesh of a measured pit ({', '.join(SUFFIXES)}), in mm."
        )
    vertices, faces = read_mesh(path)
    require_closed(vertices, faces, what=path.name)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    longest, (least, most) = float((high - low).max()), prior.body.pit_mm
    if not least <= longest <= most:
        raise ReconProblem.BAD_PRIOR.failure(
            f"{path}: the pit is {longest:.3g} long, expected {least:g} to {most:g} mm; export it in mm."
        )
    digest = hashlib.sha256(np.ascontiguousarray(vertices).tobytes())
    digest.update(faces.astype(np.int64).tobytes())
    return replace(
        prior,
        measured=MeasuredPit(vertices=vertices - (low + high) / 2, faces=faces, digest=digest.hexdigest()),
        sources=prior.sources | {"measured": f"mesh of a measured pit, {path.name}"},
    )


LEVEL = 3
"""Subdivisions of an icosahedron: 1280 triangles, 1.3 mm wide on a pit of 10 mm radius."""
LEAST_FLESH_MM = 0.5
"""Least flesh over the pit, mm: thinner than an element, and than any fruit's. Set by hand."""


@dataclass(frozen=True)
class EmbeddedPit:
    """The flesh as one solid with outward faces: skin and pit wall; `on_pit` marks those of the wall."""

    vertices: Vertices
    faces: Faces
    on_pit: Bool[np.ndarray, " m"]
    flesh_volume_mm3: float
    pit_volume_mm3: float
    thinnest_flesh_mm: float

    @property
    def skin(self) -> Mesh:
        """The flesh's outer surface, faces outward."""
        return used_part(self.vertices, self.faces[~self.on_pit])

    @property
    def pit(self) -> Mesh:
        """The pit's surface after the Boolean, faces out of the pit."""
        return used_part(self.vertices, self.faces[self.on_pit][:, ::-1])


def place_pit(fruit_vertices: Vertices, fruit_faces: Faces, prior: PitPrior) -> Mesh:
    """The prior's pit in a closed fruit mesh (fruit frame): a closed mesh of the superellipsoid's volume.

    The surface is |x/a|^p + |y/b|^p + |z/c|^p = 1 about the pit's centre. The mesh is enlarged by the
    fraction of a percent that flat faces lose. A measured pit keeps its size. Raises ReconFailure:
    not-watertight for an open fruit mesh, no-prior if the category leaves its pits to the batch.
    """
    require_closed(fruit_vertices, fruit_faces, what="fruit")
    low, high = fruit_vertices.min(axis=0), fruit_vertices.max(axis=0)
    half = (high - low) / 2
    centre = (low + high) / 2 + np.array(prior.raised) * half
    if prior.measured is not None:
        return centre + prior.measured.vertices, prior.measured.faces
    if prior.axis_ratios is None:
        raise ReconProblem.NO_PRIOR.failure(
            f'The category "{prior.category}" has no default pit; add pit.ply beside fruit.ply, or '
            "name a pit prior in batch.toml."
        )
    semi = np.array(prior.axis_ratios) * half
    (shape, faces), (smooth, fine_faces) = (
        (d / np.linalg.norm(d, prior.exponent, axis=1, keepdims=True), triangles)
        for d, triangles in (ball(LEVEL), ball(LEVEL + 3))
    )
    grow = np.cbrt(volume_mm3(smooth, fine_faces) / volume_mm3(shape, faces))
    return centre + grow * semi * shape, faces


def embed_pit(
    fruit_vertices: Vertices,
    fruit_faces: Faces,
    pit_vertices: Float[np.ndarray, "k 3"],
    pit_faces: Int[np.ndarray, "l 3"],
) -> EmbeddedPit:
    """Fruit minus pit, both closed meshes in one frame (mm).

    Raises ReconFailure: not-watertight (either mesh); pit-outside-fruit (the pit exceeds the fruit's volume,
    protrudes, or leaves less than 0.5 mm of flesh).
    """
    fruit = _solid(fruit_vertices, fruit_faces, "fruit")
    pit = _solid(pit_vertices, pit_faces, "pit")
    pit_volume, fruit_volume = float(pit.volume()), float(fruit.volume())
    if pit_volume >= fruit_volume:
        raise _outside(f"The pit ({pit_volume:.0f} mm³) is larger than the fruit ({fruit_volume:.0f} mm³)")
    outside = float((pit - fruit).volume())
    if outside > 1e-6 * pit_volume:
        raise _outside(f"{100 * outside / pit_volume:.1f} % of the pit lies outside the fruit")
    thinnest = least_gap_mm((fruit_vertices, fruit_faces), (pit_vertices, pit_faces))
    if thinnest < LEAST_FLESH_MM:
        raise _outside(
            f"The flesh between pit and skin is only {thinnest:.2f} mm thick at its thinnest point"
        )
    flesh = (fruit.as_original() - pit.as_original()).to_mesh64()
    faces = np.asarray(flesh.tri_verts, int)
    runs = np.asarray(flesh.run_index) // 3
    vertices = np.asarray(flesh.vert_properties, float)[:, :3]
    sizes = [abs(volume_mm3(vertices, faces[a:b])) if b > a else np.inf for a, b in pairwise(runs)]
    on_pit = np.zeros(len(faces), bool)
    smallest = int(np.argmin(sizes))
    on_pit[runs[smallest] : runs[smallest + 1]] = True
    return EmbeddedPit(
        vertices=vertices,
        faces=faces,
        on_pit=on_pit,
        flesh_volume_mm3=fruit_volume - pit_volume,
        pit_volume_mm3=pit_volume,
        thinnest_flesh_mm=thinnest,
    )


def least_gap_mm(first: Mesh, second: Mesh) -> float:
    """Shortest distance from the vertices of each surface to the faces of the other; they do not cross.

    It is too long only where two edges face each other midway, by at most h^2 / 8 (1/r + 1/R). Edges have
    length h, surfaces radii of curvature r and R: 0.02 mm for h = 1 mm on a pit of 10 mm.
    """
    ways = [
        RayMesh(*mesh).distances_mm(v[np.unique(f)]).min()
        for (v, f), mesh in ((first, second), (second, first))
    ]
    return float(min(ways))


def require_closed(vertices: Vertices, faces: Faces, *, what: str) -> None:
    """Raise ReconFailure (not-watertight) for a mesh that is open, in pieces, or inside out."""
    if gaps := open_edges(faces):
        raise _unsound(
            what,
            f"is not watertight: {gaps} edges do not join exactly two faces; expected one closed surface. "
            "Repair the mesh.",
        )
    if (pieces := bodies(faces)) > 1:
        raise _unsound(
            what,
            f"has {pieces} separate surfaces; expected one closed surface. Keep only the outer skin (put the "
            "pit into pit.ply).",
        )
    if volume_mm3(vertices, faces) <= 0:
        raise _unsound(what, "is inside out; expected faces that point outward. Flip the faces.")


def _solid(vertices: Vertices, faces: Faces, what: str) -> manifold3d.Manifold:
    """The closed mesh as a solid for Boolean operations; raises ReconFailure (not-watertight)."""
    require_closed(vertices, faces, what=what)
    mesh = manifold3d.Mesh64(
        np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.uint64)
    )
    solid = manifold3d.Manifold(mesh)
    if solid.status() != manifold3d.Error.NoError or solid.is_empty():
        fault = f"is not a valid solid ({solid.status().name})"
        raise _unsound(what, f"{fault}; expected one closed surface. Repair the mesh.")
    return solid


def _unsound(what: str, fault: str) -> ReconFailure:
    return ReconProblem.NOT_WATERTIGHT.failure(f"The {what}'s mesh {fault}")


def _outside(fault: str) -> ReconFailure:
    return ReconProblem.PIT_OUTSIDE_FRUIT.failure(
        f"{fault}; expected the pit well inside. Check pit.ply (or the category's pit and the "
        "height), and the meshes' unit (mm)."
    )
