"""Makes a surface one closed manifold that looks outward, with few faces. The only user of pymeshlab
(GPL-3).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from recon.native import missing_library
from recon.recon_failure import ReconFailure, ReconProblem
from recon.surface.poisson import distances_mm
from recon.triangle_mesh import open_edges, volume_mm3


@dataclass(frozen=True)
class RepairedMesh:
    """A closed manifold and how far decimation moved the surface (mm)."""

    vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    deviation_rms_mm: float
    deviation_max_mm: float


def repaired(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], *, max_faces: int
) -> RepairedMesh:
    """The largest part of a surface, without double or non-manifold pieces, holes closed, at most `max_faces`
    faces.

    Decimated by quadric edge collapse (Garland, Heckbert 1997). Raises ReconFailure: not-watertight where it
    stays open, missing-library where pymeshlab cannot be loaded.
    """
    try:
        import pymeshlab
    except (ImportError, OSError) as error:
        raise missing_library("pymeshlab", error) from error
    work = pymeshlab.MeshSet(verbose=False)
    work.add_mesh(
        pymeshlab.Mesh(np.ascontiguousarray(vertices, float), np.ascontiguousarray(faces, np.int32))
    )
    try:
        _clean(work)
        whole = work.current_mesh().vertex_matrix()
        if work.current_mesh().face_number() > max_faces:
            work.meshing_decimation_quadric_edge_collapse(
                targetfacenum=max_faces,
                preservenormal=True,
                preservetopology=True,
                optimalplacement=True,
                qualitythr=0.5,
            )
            _clean(work)
    except pymeshlab.PyMeshLabException as error:
        raise ReconFailure(
            ReconProblem.NOT_WATERTIGHT,
            f"drupe cannot repair the fruit's surface ({error}); take more photos from all sides.",
        ) from error
    mesh = work.current_mesh()
    found, triangles = np.array(mesh.vertex_matrix(), float), np.array(mesh.face_matrix(), int)
    if len(triangles) and volume_mm3(found, triangles) < 0:
        triangles = triangles[:, ::-1].copy()
    if open_edges(triangles):
        raise ReconFailure(
            ReconProblem.NOT_WATERTIGHT,
            f"The fruit's surface still has {open_edges(triangles)} open edges after repair; take "
            "more photos from all sides.",
        )
    away = distances_mm(whole, found, triangles)
    return RepairedMesh(found, triangles, float(np.sqrt(np.mean(away**2))), float(away.max()))


def _clean(work: Any) -> None:
    """Removes doubled and loose parts, closes holes and turns the faces one way, in place."""
    work.meshing_remove_duplicate_vertices()
    work.meshing_remove_duplicate_faces()
    work.meshing_remove_null_faces()
    work.meshing_repair_non_manifold_edges()
    work.meshing_repair_non_manifold_vertices()
    work.meshing_remove_connected_component_by_face_number(
        mincomponentsize=max(10, work.current_mesh().face_number() // 4)
    )
    work.meshing_remove_unreferenced_vertices()
    work.meshing_close_holes(maxholesize=400)
    work.meshing_re_orient_faces_coherently()
