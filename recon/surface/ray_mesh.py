"""A mesh asked for its nearest points and for what rays meet (Open3D, one thread, single precision)."""

import numpy as np
from jaxtyping import Bool, Float, Int

from recon.native import open3d


class RayMesh:
    """Vertices (mm) and faces; raises ReconFailure (missing-library) where Open3D does not load."""

    def __init__(self, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> None:
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
        """The triangle's corners next to each point, and the shares of each in the nearest point."""
        asked = self._tensor(points.astype(np.float32))
        answer = self._scene.compute_closest_points(asked, nthreads=1)
        return self._place(answer["primitive_ids"].numpy().astype(int), answer["primitive_uvs"].numpy())

    def met(
        self, start: Float[np.ndarray, "k 3"], ahead: Float[np.ndarray, "k 3"]
    ) -> tuple[Float[np.ndarray, " k"], Int[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
        """How often the way `ahead` goes into a ray from `start` to its first face (inf without one, and then
        any face's), the face's corners, and the shares of each in the place.
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
        """Corners of faces, and the shares of each at barycentric coordinates."""
        second = uv.astype(float)
        return self._faces[face], np.column_stack([1 - second.sum(axis=1), second])

    def hidden(
        self, start: Float[np.ndarray, "k 3"], end: Float[np.ndarray, "k 3"]
    ) -> Bool[np.ndarray, " k"]:
        """Whether a face lies between two points."""
        rays = self._tensor(np.hstack([start, end - start]).astype(np.float32))
        return np.asarray(self._scene.test_occlusions(rays, tnear=0.0, tfar=1.0, nthreads=1).numpy())
