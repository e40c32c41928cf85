"""A smooth surface through points, and its repair to one closed, outward manifold with few faces."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from recon.recon_failure import ReconProblem
from recon.surface import meshlab
from recon.surface.ray_mesh import RayMesh, open3d
from recon.triangle_mesh import Faces, Mesh, Vertices, open_edges, unique_edges, volume_mm3

DEPTH = 6
"""Depth of the octree: 64 cells over 1.1 fruit, 0.004 to 0.011 mm off (7: 0.003 to 0.008, 3 to 4 s more)."""


def poisson_surface(points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]) -> Mesh:
    """The surface whose indicator's gradient fits the normals at the points (Kazhdan, Hoppe 2013).

    Points (mm) cover the whole fruit, normals point outward. One thread: the same points give the same mesh.
    Raises ReconFailure (no-surface).
    """
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(points)))
    cloud.normals = o3d.utility.Vector3dVector(np.ascontiguousarray(normals))
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=DEPTH, n_threads=1)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles, dtype=int)
    if len(faces) == 0:
        raise ReconProblem.NO_SURFACE.failure(
            f"drupe found no surface through the {len(points)} points on the fruit; take more photos "
            "from all sides."
        )
    return vertices, faces


LARGEST_HOLE = 0.25
"""Half the diagonal of the largest closed hole's box, over the diagonal of the surface's box. Under a
rendered fruit it is 0.16; a lid over 0.25 takes 3 % of a ball's volume. Set by hand."""
LARGER = 10.0
"""Factor on lengths while Open3D decimates. It places a vertex at the optimum only if the determinant of its
quadric exceeds 1e-4, which depends on the unit. In mm a cherry of 6000 faces is 10.4 um off, with this factor
4.6 um; tests/recon/test_repair.py compares balls of 4 and 40 mm."""


@dataclass(frozen=True)
class RepairedMesh:
    """A closed manifold, and the root mean square distance by which decimation moved the surface."""

    vertices: Vertices
    faces: Faces
    deviation_rms_mm: float


def repaired(vertices: Vertices, faces: Faces, *, max_faces: int) -> RepairedMesh:
    """The largest part of a surface as a manifold, holes closed, of at most `max_faces` faces.

    By PyMeshLab if it is installed, else by Open3D. Raises ReconFailure: not-watertight if it stays open,
    missing-library if Open3D does not load.
    """
    tool = _closed_and_decimated if meshlab.library() is None else meshlab.closed_and_decimated
    whole, corners, triangles = tool(vertices, faces, max_faces=max_faces)
    if len(triangles) and volume_mm3(corners, triangles) < 0:
        triangles = triangles[:, ::-1].copy()
    if open_edges(triangles):
        raise ReconProblem.NOT_WATERTIGHT.failure(
            f"The fruit's surface still has {open_edges(triangles)} open edges after repair; take "
            "more photos from all sides."
        )
    away = RayMesh(corners, triangles).distances_mm(whole)
    return RepairedMesh(corners, triangles, float(np.sqrt(np.mean(away**2))))


def _closed_and_decimated(
    vertices: Vertices, faces: Faces, *, max_faces: int
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """`closed_and_decimated` of recon.surface.meshlab by Open3D; raises ReconFailure (missing-library)."""
    o3d = open3d()
    mesh = _clean(
        o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(np.ascontiguousarray(vertices, float)),
            o3d.utility.Vector3iVector(np.ascontiguousarray(faces, np.int32)),
        )
    )
    whole = np.array(mesh.vertices)
    if len(mesh.triangles) > max_faces:
        larger = mesh.scale(LARGER, np.zeros(3)).simplify_quadric_decimation(max_faces)
        mesh = _clean(larger).scale(1 / LARGER, np.zeros(3))
    return whole, np.array(mesh.vertices), np.array(mesh.triangles, int)


def _clean(mesh: Any) -> Any:
    """The largest part of an Open3D mesh, its holes closed and its faces oriented consistently.

    Duplicate faces are dropped, and all faces at an edge that more than two faces share.
    """
    o3d = open3d()
    mesh.remove_duplicated_vertices()
    mesh.remove_duplicated_triangles()
    mesh.remove_degenerate_triangles()
    side = unique_edges(np.asarray(mesh.triangles))[1].reshape(3, -1)
    mesh.remove_triangles_by_mask((np.bincount(side.ravel())[side] > 2).any(axis=0))
    part, count, _ = mesh.cluster_connected_triangles()
    mesh.remove_triangles_by_mask(np.asarray(part) != np.argmax(count))
    mesh.remove_unreferenced_vertices()
    if not mesh.is_edge_manifold(allow_boundary_edges=False):
        size = float(np.linalg.norm(mesh.get_max_bound() - mesh.get_min_bound()))
        tensors = o3d.t.geometry.TriangleMesh.from_legacy(mesh, vertex_dtype=o3d.core.float64)
        mesh = tensors.fill_holes(LARGEST_HOLE * size).to_legacy()
    mesh.orient_triangles()
    return mesh
