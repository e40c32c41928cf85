"""What each pixel of an orthographic view sees of a mesh: rays on the CPU, no window, no OpenGL.

Open3D is imported when the first surface is traced: a process that draws nothing goes without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt

_SKY_RAYS = 96
"""Directions in which the sky is looked for: shares come in steps of a hundredth (by eye)."""
_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
"""Radians between two directions of Vogel's spiral, which covers a disc evenly (Vogel 1979, "A better way to
construct the sunflower head", Mathematical Biosciences 44)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Viewing:
    """An orthographic camera that looks at ``centre_mm``; azimuth from +x towards +y, elevation above xy."""

    centre_mm: Float[np.ndarray, " 3"]
    azimuth_deg: float
    elevation_deg: float
    half_width_mm: float
    half_height_mm: float

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Rows: right, up and towards the viewer, unit vectors."""
        azimuth, elevation = np.deg2rad(self.azimuth_deg), np.deg2rad(self.elevation_deg)
        towards = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        return np.stack([right, np.cross(towards, right), towards])


@dataclass(frozen=True, kw_only=True, eq=False)
class VisibleSurface:
    """First hit of each pixel's ray: whether, how far off, where, and the smooth unit normal there.

    `corners` and `weights`, of the pixels that hit, interpolate what is known at the mesh's vertices.
    """

    hit: Bool[np.ndarray, "h w"]
    depth_mm: Float[np.ndarray, "h w"]
    points_mm: Float[np.ndarray, "h w 3"]
    normals: Float[np.ndarray, "h w 3"]
    corners: Int[np.ndarray, "k 3"]
    weights: Float[np.ndarray, "k 3"]

    def of_vertices(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, "h w"]:
        """A quantity of the vertices as each pixel sees it; NaN where there is nothing."""
        seen = np.full(self.hit.shape, np.nan)
        seen[self.hit] = _interpolated(values[:, None], self.corners, self.weights)[:, 0]
        return seen


@dataclass(frozen=True, kw_only=True, eq=False)
class TracedSurface:
    """A mesh made ready for rays, with one outward normal per vertex (area-weighted mean of its faces')."""

    scene: Any
    faces: Int[np.ndarray, "m 3"]
    vertex_normals: Float[np.ndarray, "n 3"]

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]) -> TracedSurface:
        """The surface of a mesh, mm."""
        corners = vertices[faces]
        areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.stack(
            [
                np.bincount(faces.ravel(), np.repeat(areas[:, axis], 3), minlength=len(vertices))
                for axis in range(3)
            ],
            axis=1,
        )
        import open3d as o3d

        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(
            _tensor(np.ascontiguousarray(vertices, np.float32)),
            _tensor(np.ascontiguousarray(faces, np.uint32)),
        )
        return cls(scene=scene, faces=faces, vertex_normals=_unit(normals))

    def seen_from(self, view: Viewing, *, width_px: int, height_px: int) -> VisibleSurface:
        """What each pixel of the view sees of the surface; row 0 is the top."""
        right, up, towards = view.axes
        across = view.half_width_mm * ((np.arange(width_px) + 0.5) / width_px * 2 - 1)
        along = view.half_height_mm * (1 - (np.arange(height_px) + 0.5) / height_px * 2)
        far_mm = 4.0 * (view.half_width_mm + view.half_height_mm)
        points = (view.centre_mm + far_mm * towards + along[:, None] * up)[:, None] + across[:, None] * right
        rays = np.empty((height_px, width_px, 6), np.float32)
        rays[..., :3], rays[..., 3:] = points, -towards
        answer = self.scene.cast_rays(_tensor(rays), nthreads=1)
        depth = answer["t_hit"].numpy().astype(float)
        hit = np.isfinite(depth)
        uv = answer["primitive_uvs"].numpy()[hit].astype(float)
        corners = self.faces[answer["primitive_ids"].numpy()[hit]]
        weights = np.column_stack([1 - uv[:, 0] - uv[:, 1], uv])
        normals = np.zeros((height_px, width_px, 3))
        normals[hit] = _unit(_interpolated(self.vertex_normals, corners, weights))
        depth[~hit] = far_mm
        points -= depth[..., None] * towards
        return VisibleSurface(
            hit=hit,
            depth_mm=depth,
            points_mm=points,
            normals=normals,
            corners=corners,
            weights=weights,
        )

    def nearest(self, points_mm: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q 3"]:
        """The surface's point nearest to each point."""
        query = _tensor(np.ascontiguousarray(points_mm, np.float32))
        nearest_mm: Float[np.ndarray, "q 3"] = (
            self.scene.compute_closest_points(query, nthreads=1)["points"].numpy().astype(float)
        )
        return nearest_mm

    def shaded(self, points_mm: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, " q"]:
        """Share of the sky about +z, cosine-weighted, that the surface hides from each point."""
        k = np.arange(_SKY_RAYS) + 0.5
        radius, turn = np.sqrt(k / _SKY_RAYS), k * _GOLDEN_ANGLE
        directions = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - radius**2)], axis=1)
        rays = np.concatenate(
            [
                np.broadcast_to(points_mm[:, None], (len(points_mm), len(directions), 3)),
                np.broadcast_to(directions, (len(points_mm), len(directions), 3)),
            ],
            axis=2,
        ).astype(np.float32)
        hidden = self.scene.test_occlusions(_tensor(rays), nthreads=1).numpy()
        share: Float[np.ndarray, " q"] = hidden.astype(float).mean(axis=1)
        return share


def _tensor(values: Float[np.ndarray, "*n"] | UInt[np.ndarray, "*n"]) -> Any:
    import open3d as o3d

    return o3d.core.Tensor.from_numpy(values)


def _interpolated(
    values: Float[np.ndarray, "n c"], corners: Int[np.ndarray, "k 3"], weights: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k c"]:
    """Values of the vertices at places inside triangles, by their barycentric weights."""
    interpolated = weights[:, :1] * values[corners[:, 0]]
    for corner in (1, 2):
        interpolated += weights[:, corner, None] * values[corners[:, corner]]
    return np.asarray(interpolated)


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    lengths = np.sqrt(np.einsum("nx,nx->n", vectors, vectors))
    return np.asarray(vectors / np.maximum(lengths, 1e-12)[:, None])
