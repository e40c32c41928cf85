"""Repair and decimation by PyMeshLab. This file is the only user of pymeshlab (GPL-3)."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from recon.recon_failure import ReconProblem
from recon.triangle_mesh import Faces, Vertices

LONGEST_HOLE = 400
"""Edges around the largest hole that is closed. Set by hand."""


def library() -> Any:
    """pymeshlab, or None where it cannot be loaded."""
    try:
        import pymeshlab
    except (ImportError, OSError):
        return None
    return pymeshlab


def closed_and_decimated(
    vertices: Vertices, faces: Faces, *, max_faces: int
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """The repaired vertices, and the vertices and faces after decimation; needs the library.

    Decimated by quadric edge collapse (Garland, Heckbert 1997). Raises ReconFailure: not-watertight.
    """
    pymeshlab = library()
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
        raise ReconProblem.NOT_WATERTIGHT.failure(
            f"drupe cannot repair the fruit's surface ({error}); take more photos from all sides."
        ) from error
    mesh = work.current_mesh()
    return whole, np.array(mesh.vertex_matrix(), float), np.array(mesh.face_matrix(), int)


def _clean(work: Any) -> None:
    """Removes duplicate and loose parts, closes holes and orients the faces consistently, in place."""
    work.meshing_remove_duplicate_vertices()
    work.meshing_remove_duplicate_faces()
    work.meshing_remove_null_faces()
    work.meshing_repair_non_manifold_edges()
    work.meshing_repair_non_manifold_vertices()
    work.meshing_remove_connected_component_by_face_number(
        mincomponentsize=max(10, work.current_mesh().face_number() // 4)
    )
    work.meshing_remove_unreferenced_vertices()
    work.meshing_close_holes(maxholesize=LONGEST_HOLE)
    work.meshing_re_orient_faces_coherently()
