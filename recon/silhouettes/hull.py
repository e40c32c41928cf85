"""The visual hull as an implicit function that rays from inside intersect: finer than a voxel grid."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Bool, Float

from recon.cameras.camera import Camera
from recon.picture_values import sampled
from recon.silhouettes.mask import Window
from recon.triangle_mesh import Faces, Mesh, Vertices, unique_edges

STEPS = 40
"""Most steps along a ray; each advances by the whole distance found. Set by hand."""
NEAREST_MM = 1e-3
"""Distance from the surface at which a ray stops, mm: far below a pixel."""


@dataclass(frozen=True)
class Silhouette:
    """Signed distance to a fruit's outline (px of the photo, positive inside) over a shrunk window."""

    distance_px: Float[np.ndarray, "h w"]
    window: Window
    camera: Camera

    def depth_mm(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Depth of points inside the outline's cone, mm; off the window the greatest depth. No distortion."""
        cone = self._cone
        column, row, depth = cone[:, :3] @ points.T + cone[:, 3:]
        pixels = np.stack([column / depth, row / depth], axis=1, dtype=np.float32, casting="same_kind")
        inside_px = sampled(self.distance_px, pixels, outside=self.furthest_px)
        return np.asarray(inside_px * depth / self.camera.focal_px)

    @cached_property
    def _cone(self) -> Float[np.ndarray, "3 4"]:
        """Matrix from world points to homogeneous pixels of the shrunk window, scaled by their depth (mm)."""
        origin, step = self.window.into_small(np.array([[0.0, 0.0], [1.0, 1.0]]))
        small = np.diag([*(step - origin), 1.0])
        small[:2, 2] = origin
        return np.asarray(small @ self.camera.intrinsics @ self.camera.cam_from_world[:3])

    @cached_property
    def furthest_px(self) -> float:
        """Greatest distance of a pixel inside the outline."""
        return float(self.distance_px.max())

    def outline_px(self) -> Float[np.ndarray, "n 2"]:
        """Outline of the largest part as a closed curve, pixels of the photo; empty without a part."""
        inside = (self.distance_px > 0).astype(np.uint8)
        contours, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if not contours:
            return np.zeros((0, 2))
        return self.window.from_small(max(contours, key=cv2.contourArea)[:, 0].astype(float))


def silhouette_of_mask(mask: Bool[np.ndarray, "h w"], window: Window, camera: Camera) -> Silhouette:
    """Silhouette of a pixel mask, to about half a pixel of the mask."""
    padded = np.pad(mask.astype(np.uint8), 1, mode="edge")
    inside = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    outside = cv2.distanceTransform(1 - padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    signed = np.where(mask, inside - 0.5, 0.5 - outside) * window.shrink
    return Silhouette(signed.astype(np.float32), window, camera)


@cache
def ball(level: int) -> Mesh:
    """Unit sphere: an icosahedron's faces split in four `level` times; 10 * 4^level + 2 vertices."""
    g = (1 + 5**0.5) / 2
    flat = [(-1.0, g, 0.0), (1.0, g, 0.0), (-1.0, -g, 0.0), (1.0, -g, 0.0)]
    vertices = np.array([np.roll(p, turn) for turn in range(3) for p in flat])
    edge = np.linalg.norm(vertices[:, None] - vertices, axis=2) < 2.1
    sides = [t for t in combinations(range(12), 3) if all(edge[i, j] for i, j in combinations(t, 2))]
    faces = np.array(
        [(i, j, k) if np.linalg.det(vertices[[i, j, k]]) > 0 else (i, k, j) for i, j, k in sides]
    )
    for _ in range(level):
        unique, inverse = unique_edges(faces)
        ab, bc, ca = (inverse + len(vertices)).reshape(3, -1)
        vertices = np.concatenate([vertices, vertices[unique].mean(1)])
        a, b, c = faces.T
        faces = np.concatenate(
            [np.stack(f, 1) for f in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
        )
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def split(values: Float[np.ndarray, "n k"], level: int, finer: int) -> Float[np.ndarray, "m k"]:
    """Values at vertices of `ball(level)`, on `ball(finer)`: a new vertex gets the mean of its edge."""
    for step in range(level, finer):
        values = np.concatenate([values, values[unique_edges(ball(step)[1])[0]].mean(1)])
    return values


def visual_hull(
    silhouettes: Sequence[Silhouette],
    *,
    centre_mm: Float[np.ndarray, "3"],
    longest_mm: float,
    floor_mm: float = -np.inf,
    level: int,
    outlier_share: float = 0.0,
) -> Mesh:
    """Where rays from `centre_mm` leave the intersection of all silhouette cones and of z >= floor.

    phi(X) = min over views of the depth inside the cone, or with `outlier_share` the depth that this share of
    the views undercuts. A ball of radius r grows by about r δ² / 2 along a ray, δ its angle to the nearest
    rim that a view sees. A ray advances by phi until phi = 0 (sphere tracing, Hart 1996). The shape must be
    star-shaped about its centre; the mesh is closed and of genus 0.
    """
    directions, faces = ball(level)
    radius = np.zeros(len(directions))
    busy = np.arange(len(directions))
    rank, part = divmod(outlier_share * len(silhouettes), 1.0)
    ranks = [int(rank), min(int(rank) + 1, len(silhouettes) - 1)]
    for _ in range(STEPS):
        points = centre_mm + radius[busy, None] * directions[busy]
        depths = np.array([s.depth_mm(points) for s in silhouettes])
        low, high = np.partition(depths, ranks, axis=0)[ranks]
        phi = (1 - part) * low + part * high
        phi = np.minimum(phi, points[:, 2] - floor_mm)
        radius[busy] = np.clip(radius[busy] + phi, 0.02 * longest_mm, longest_mm)
        busy = busy[(np.abs(phi) > NEAREST_MM) & (radius[busy] < longest_mm)]
        if len(busy) == 0:
            break
    return centre_mm + radius[:, None] * directions, faces


def drawn(vertices: Vertices, faces: Faces, window: Window, camera: Camera) -> Bool[np.ndarray, "h w"]:
    """Mask of a closed mesh in a shrunk window, without holes: what its rim encloses.

    The rim consists of the edges that belong to just one face towards the camera.
    """
    columns, rows = window.small_size_px
    picture = np.zeros((rows, columns), np.uint8)
    pixels = np.rint(window.into_small(camera.project(vertices)) * 16).astype(np.int32)
    x, y = pixels.astype(np.int64).T
    a, b, c = faces.T
    facing = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a]) < 0
    seen = faces[facing]
    ends = np.concatenate([seen[:, [0, 1]], seen[:, [1, 2]], seen[:, [2, 0]]])
    edges = np.sort(ends.min(1) * len(vertices) + ends.max(1))
    apart = np.concatenate([[True], edges[1:] != edges[:-1], [True]])
    rim = edges[apart[1:] & apart[:-1]]
    cv2.polylines(picture, pixels[np.stack(np.divmod(rim, len(vertices)), axis=1)], False, 1, shift=4)
    contours, _ = cv2.findContours(picture, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, contours, -1, 1, cv2.FILLED)
    return picture > 0
