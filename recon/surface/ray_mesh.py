"""Nearest points of a mesh, intersections with rays, the number of cameras that see each vertex, and the
faces' orientation (Open3D, one thread, single precision).
"""

from types import ModuleType

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.recon_failure import ReconProblem
from recon.triangle_mesh import Faces, Vertices, face_areas, facing, vertex_normals

SEEN_BY = 2
"""Least number of cameras for a place to count as seen: one alone gives no depth."""
CLEAR = 1e-3
"""Height of a ray's start above the skin, over the fruit's size, so that its own facets do not hide it."""


def seeing_views(vertices: Vertices, faces: Faces, places: Float[np.ndarray, "v 3"]) -> Int[np.ndarray, " n"]:
    """Number of cameras at `places` (mm) that see each vertex of a closed mesh: it faces them, unhidden."""
    skin = RayMesh(vertices, faces)
    normals = vertex_normals(vertices, faces)
    start = vertices + CLEAR * float(np.ptp(vertices, axis=0).max()) * normals
    views = np.zeros(len(vertices), dtype=np.int64)
    for place in places:
        hidden = skin.hidden(start, np.broadcast_to(place, start.shape))
        views += (facing(vertices, normals, place) > 0) & ~hidden
    return views


def seen_and_unseen(vertices: Vertices, faces: Faces, views: Int[np.ndarray, " n"]) -> tuple[float, float]:
    """The share of the skin that SEEN_BY cameras or more saw, and the area of the rest, mm^2.

    The method closed the rest. A triangle counts by its corners.
    """
    area = face_areas(vertices, faces)
    hole = float(area @ (views[faces] < SEEN_BY).mean(axis=1))
    return 1 - hole / float(area.sum()), hole


DEBIAN_PACKAGES = "libegl1 libgl1 libusb-1.0-0"


def open3d() -> ModuleType:
    """Open3D; raises ReconFailure (missing-library) that names the packages to install.

    Raises KeyboardInterrupt for an interrupt while the library loads. Native libraries turn it into an
    ImportError ("initialization failed").
    """
    try:
        import open3d as module
    except (ImportError, OSError) as error:
        for reason in (error.__cause__, error.__context__):
            if isinstance(reason, KeyboardInterrupt):
                raise reason from error
        raise ReconProblem.MISSING_LIBRARY.failure(
            f"open3d does not load ({error}); install it with pip, and install its system libraries: "
            f"apt-get install {DEBIAN_PACKAGES}"
        ) from error
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    loaded: ModuleType = module
    return loaded


def consistently_oriented(faces: Faces) -> Faces:
    """The faces, reoriented so that neighbours traverse their shared edge in opposite directions.

    Unchanged if the surface has one side (a Moebius strip).
    """
    o3d = open3d()
    corners = o3d.utility.Vector3dVector(np.zeros((int(faces.max(initial=-1)) + 1, 3)))
    mesh = o3d.geometry.TriangleMesh(corners, o3d.utility.Vector3iVector(faces.astype(np.int32)))
    return np.array(mesh.triangles, dtype=np.int64) if mesh.orient_triangles() else faces


class RayMesh:
    """Queries on a mesh (mm); raises ReconFailure (missing-library) if Open3D does not load."""

    def __init__(self, vertices: Vertices, faces: Faces) -> None:
        o3d = open3d()
        self._tensor = o3d.core.Tensor
        self._faces = faces
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._tensor(vertices.astype(np.float32)), self._tensor(faces.astype(np.uint32))
        )

    def distances_mm(self, points: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Distance of points to the nearest point of the mesh."""
        asked = self._tensor(points.astype(np.float32))
        return np.asarray(self._scene.compute_distance(asked, nthreads=1).numpy(), float)

    def nearest(
        self, points: Float[np.ndarray, "k 3"]
    ) -> tuple[Int[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        """Corners of the triangle nearest to each point, and the nearest point's barycentric coordinates."""
        asked = self._tensor(points.astype(np.float32))
        answer = self._scene.compute_closest_points(asked, nthreads=1)
        return self._place(answer["primitive_ids"].numpy().astype(int), answer["primitive_uvs"].numpy())

    def met(
        self, start: Float[np.ndarray, "k 3"], ahead: Float[np.ndarray, "k 3"]
    ) -> tuple[Float[np.ndarray, " k"], Int[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        """t of the first face that start + t `ahead` meets (inf without one), its corners, and the
        barycentric coordinates there. Without a face, the corners are any face's.
        """
        rays = self._tensor(np.hstack([start, ahead]).astype(np.float32))
        answer = self._scene.cast_rays(rays, nthreads=1)
        far = np.asarray(answer["t_hit"].numpy(), float)
        faces = np.where(np.isfinite(far), answer["primitive_ids"].numpy(), 0).astype(int)
        corners, shares = self._place(faces, answer["primitive_uvs"].numpy())
        return far, corners, shares

    def _place(
        self, face: Int[np.ndarray, " k"], uv: Float[np.ndarray, "k 2"]
    ) -> tuple[Int[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        """Corners of faces, and all three barycentric coordinates from the last two."""
        second = uv.astype(float)
        return self._faces[face], np.column_stack([1 - second.sum(axis=1), second])

    def hidden(
        self, start: Float[np.ndarray, "k 3"], end: Float[np.ndarray, "k 3"]
    ) -> Bool[np.ndarray, " k"]:
        """Whether a face lies between two points."""
        rays = self._tensor(np.hstack([start, end - start]).astype(np.float32))
        return np.asarray(self._scene.test_occlusions(rays, tnear=0.0, tfar=1.0, nthreads=1).numpy())
