"""Texture of the fruit's skin from its photos: longitude to the right, from the stem down.

Photos have weights by how squarely they face the skin. Skin that no photo shows is grey.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import cKDTree

from reports.photo import jpeg
from reports.skin_layer import middle, vertex_normals

WIDTH_PX, HEIGHT_PX = 384, 192
"""Size of the texture: a pixel is about 0.5 mm on a fruit of 60 mm, and a file has 10 to 20 kB."""
LEAST_FACING = 0.35
"""Cosine of view and normal below which a photo is not used: near its outline it shows the background."""
SHARPNESS = 8
"""Power of that cosine in the weights: the squarest photo dominates, and no seam shows (by eye)."""
UNSEEN = 128.0
"""Grey of skin that no photo shows."""
LIFT_MM = 0.3
"""Height of the lines of sight above the skin, which lies up to this far under a face between vertices."""
NEAREST = 4
"""Nearest vertices that interpolate the skin."""


@dataclass(frozen=True, eq=False)
class SkinPhoto:
    """An undistorted BGR photo, the matrix from the mesh's points to its pixels, the camera's place (mm)."""

    image: UInt8[np.ndarray, "_h _w 3"]
    pixels_from_mesh: Float[np.ndarray, "3 4"]
    place_mm: Float[np.ndarray, " 3"]


def skin_texture(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    photos: Iterable[SkinPhoto],
    hidden: Callable[[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]], Bool[np.ndarray, " k"]],
) -> bytes:
    """A JPEG of the skin by direction from the middle of the mesh; empty if no photo shows the skin. Pixel
    (u, v), both from 0 to 1, has the longitude 2 π u from +x towards +y and the angle π v from +z.

    `hidden`: whether the mesh lies between pairs of points (mm).
    """
    longitude = 2 * np.pi * (np.arange(WIDTH_PX) + 0.5) / WIDTH_PX
    polar = np.pi * (np.arange(HEIGHT_PX) + 0.5)[:, None] / HEIGHT_PX
    flat = np.cos(longitude) * np.sin(polar), np.sin(longitude) * np.sin(polar)
    towards = np.stack([*flat, np.broadcast_to(np.cos(polar), flat[0].shape)], axis=-1).reshape(-1, 3)
    points, normals = _skin(vertices, faces, towards)
    total, weights = np.zeros((len(points), 3)), np.zeros((len(points), 1))
    for photo in photos:
        to_camera = photo.place_mm - points
        facing = np.sum(normals * to_camera, axis=1) / np.linalg.norm(to_camera, axis=1)
        u, v, depth = photo.pixels_from_mesh @ np.column_stack([points, np.ones(len(points))]).T
        u, v = u / depth, v / depth
        height, width = photo.image.shape[:2]
        used = (facing > LEAST_FACING) & (depth > 0) & (u > 0) & (u < width - 1) & (v > 0) & (v < height - 1)
        start = points[used] + LIFT_MM * normals[used]
        used[used] = ~hidden(start, np.broadcast_to(photo.place_mm, start.shape))
        if not used.any():
            continue
        weight = facing[used, None] ** SHARPNESS
        seen = cv2.remap(photo.image, u[used].astype("f4"), v[used].astype("f4"), cv2.INTER_LINEAR)
        total[used] += weight * seen.reshape(-1, 3)
        weights[used] += weight
    shown = weights[:, 0] > 0
    if not shown.any():
        return b""
    colour = np.full_like(total, UNSEEN)
    colour[shown] = total[shown] / weights[shown]
    return jpeg(np.round(colour).reshape(HEIGHT_PX, WIDTH_PX, 3).astype(np.uint8))


def _skin(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], towards: Float[np.ndarray, "k 3"]
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Points of the skin in these directions from its middle, and its unit normals there."""
    normal = vertex_normals(vertices, faces)
    out = vertices - middle(vertices)
    radius = np.linalg.norm(out, axis=1)
    distance, nearest = cKDTree(out / radius[:, None]).query(towards, k=NEAREST)
    near = 1.0 / (np.asarray(distance) + 1e-6)
    near /= near.sum(axis=1, keepdims=True)
    radii = np.einsum("kn,kn->k", near, radius[nearest])
    there = np.einsum("kn,kni->ki", near, normal[nearest])
    return middle(vertices) + radii[:, None] * towards, there / np.linalg.norm(there, axis=1, keepdims=True)
