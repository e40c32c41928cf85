"""What each photo shows along the normals of the mesh's rim, and what ground the other photos show there."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from recon.checks.rim_samples import (
    CLEARANCE_PX,
    FEWEST_SIGHTINGS,
    Rim,
    RimView,
    ground_centre,
    visible_ground,
)
from recon.picture_values import sampled

FARTHEST_DIAMETERS = 6.0
"""Ground further from the fruit than this many diameters is not looked up: a wall may stand there."""


@dataclass(frozen=True)
class Profiles:
    """Over all samples and offsets: colour seen, ground expected (median, lowest, highest, spread), known."""

    colours: Float[np.ndarray, "k o 3"]
    ground: Float[np.ndarray, "k o 3"]
    lowest: Float[np.ndarray, "k o 3"]
    highest: Float[np.ndarray, "k o 3"]
    spread: Float[np.ndarray, "k o 3"]
    known: Bool[np.ndarray, "k o"]


def profiles_of(
    rim_views: Sequence[RimView],
    rims: Sequence[Rim],
    offsets: Float[np.ndarray, " o"],
    vertices: Float[np.ndarray, "n 3"],
) -> Profiles:
    """Colours along all rims' normals, and quantiles of what other photos show there of z = 0.

    A photo tells nothing of its own rims' ground. `known` where FEWEST_SIGHTINGS photos or more tell.
    """
    middle, radius = ground_centre(vertices)
    points, colours, reached = [], [], []
    for s, rim in zip(rim_views, rims, strict=True):
        pixels = (rim.pixel[:, None] + offsets[:, None] * rim.normal[:, None]).reshape(-1, 2)
        rays = (
            np.column_stack([(pixels - s.camera.middle_px) / s.camera.focal_px, np.ones(len(pixels))])
            @ s.camera.cam_from_world[:3, :3]
        )
        down = rays[:, 2] < -1e-3 * np.linalg.norm(rays, axis=1)
        along = np.where(down, -s.camera.place[2] / np.where(down, rays[:, 2], -1.0), 0.0)
        spot = s.camera.place + along[:, None] * rays
        points.append(spot)
        reached.append(
            down
            & s.camera.shows(pixels, 0)
            & (np.linalg.norm(spot - middle, axis=1) < 2 * FARTHEST_DIAMETERS * radius)
        )
        colours.append(sampled(s.colours, pixels))
    spots, reach = np.concatenate(points), np.concatenate(reached)
    view_numbers = np.repeat(np.arange(len(rim_views)), [len(p) for p in points])
    count = len(spots)
    stack = np.full((3, len(rim_views), count, 3), 255, np.uint8)
    seen = np.zeros((len(rim_views), count), bool)
    for k, s in enumerate(rim_views):
        pixels, free = visible_ground(s.camera, s.outside_px, spots, CLEARANCE_PX)
        free &= reach & (view_numbers != k)
        seen[k] = free
        stack[0, k, free] = sampled(s.colours, pixels[free])
        stack[1, k, free] = sampled(s.lowest, pixels[free], how=cv2.INTER_NEAREST)
        stack[2, k, free] = sampled(s.highest, pixels[free], how=cv2.INTER_NEAREST)
    sightings = seen.sum(0)
    shape = (-1, len(offsets), 3)

    def quantile(layer: int, share: float) -> Float[np.ndarray, "k o 3"]:
        rank = np.clip(np.rint(share * (sightings - 1)), 0, len(rim_views) - 1).astype(int)
        picked = np.take_along_axis(ordered[layer], rank[:, None, None], axis=2)[..., 0]
        return lab_units(picked.reshape(shape))

    ordered = [np.sort(np.ascontiguousarray(layer.transpose(1, 2, 0)), axis=2) for layer in stack]
    spread = (quantile(0, 0.8) - quantile(0, 0.2)) / 1.68
    return Profiles(
        lab_units(np.concatenate(colours).reshape(shape)),
        quantile(0, 0.5),
        quantile(1, 0.5),
        quantile(2, 0.5),
        spread,
        (sightings >= FEWEST_SIGHTINGS).reshape(shape[:2]),
    )


def lab_units(colours: np.ndarray) -> Float[np.ndarray, "*n 3"]:
    """8-bit Lab to Lab units."""
    return np.asarray(colours * np.array([100 / 255, 1, 1], np.float32) - np.array([0, 128, 128], np.float32))
