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
        u, v = answer["primitive_uvs"].numpy().T.astype(float)
        corners = self._faces[answer["primitive_ids"].numpy().astype(int)]
        return corners, np.stack([1 - u - v, u, v], axis=1)

    def reached(
        self, start: Float[np.ndarray, "k 3"], ahead: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, " k"]:
        """How often the way `ahead` goes into a ray from `start` to its first face; inf without one."""
        rays = self._tensor(np.hstack([start, ahead]).astype(np.float32))
        return np.asarray(self._scene.cast_rays(rays, nthreads=1)["t_hit"].numpy(), float)

    def hidden(
        self, start: Float[np.ndarray, "k 3"], end: Float[np.ndarray, "k 3"]
    ) -> Bool[np.ndarray, " k"]:
        """Whether a face lies between two points."""
        rays = self._tensor(np.hstack([start, end - start]).astype(np.float32))
        return np.asarray(self._scene.test_occlusions(rays, tnear=0.0, tfar=1.0, nthreads=1).numpy())
