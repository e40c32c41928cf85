"""The mesh's rim in downscaled photos of one brightness, their colours beside it, and the ground that other
photos show there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from recon.cameras.camera import Camera
from recon.picture_values import Picture, Pictures, sampled
from recon.silhouettes.hull import drawn
from recon.silhouettes.mask import Window
from recon.triangle_mesh import Faces, Vertices, rim_crossings, sides_of, vertex_normals

FARTHEST_DIAMETERS = 6.0
"""Largest distance, in diameters, of ground that is used: a wall may be beyond."""


DIAMETER_PX = 260.0
"""Photos are downscaled until the fruit is about this wide (px): finer pixels cost time without benefit."""
RIM_SAMPLES = 96
"""Most samples of a rim in a photo: every four degrees, which bounds the time."""
CLEARANCE_PX = 4.0
"""Least distance of a ground sighting outside the mesh's rim (px)."""
FEWEST_SIGHTINGS = 3
"""Least number of photos that show a ground point: of three, one that errs is detectable."""


@dataclass(frozen=True)
class RimView:
    """A downscaled photo (8-bit Lab), its range over eight neighbours, distance outside the mesh (px)."""

    camera: Camera
    colours: Picture
    lowest: Picture
    highest: Picture
    outside_px: Float[np.ndarray, "h w"]


@dataclass(frozen=True)
class Rim:
    """Rim samples of one photo: edges' ends, share, pixel, outward normal in the picture, pixel size."""

    a: Int[np.ndarray, " k"]
    b: Int[np.ndarray, " k"]
    t: Float[np.ndarray, " k"]
    pixel: Float[np.ndarray, "k 2"]
    normal: Float[np.ndarray, "k 2"]
    pixel_mm: Float[np.ndarray, " k"]


def rims_of(
    images: Pictures, cameras: Sequence[Camera], vertices: Vertices, faces: Faces
) -> tuple[list[RimView], list[Rim]]:
    """Every photo downscaled, at the brightness of the median photo, and its rim samples."""
    normals = vertex_normals(vertices, faces)
    pairs = [_downscaled(i, c, vertices) for i, c in zip(images, cameras, strict=True)]
    outside = [_outside_px(c, vertices, faces) for _, c in pairs]
    gains = _gains(pairs, outside, vertices)
    rim_views = []
    for far, gain in zip(outside, gains, strict=True):
        image, camera = pairs.pop(0)  # frees it: all have hundreds of MB
        rim_views.append(_visible(image, camera, far, gain))
    return rim_views, [_rim(s, vertices, normals, faces) for s in rim_views]


def _downscaled(image: Picture, camera: Camera, vertices: Vertices) -> tuple[Picture, Camera]:
    """The photo shrunk until the fruit is DIAMETER_PX wide, lightly blurred, and its camera.

    Columns are a multiple of 12, so that pictures of 4:3, 3:2 and 16:9 about keep their shape.
    """
    scale = DIAMETER_PX / float(np.ptp(camera.project(vertices), axis=0).max())
    if scale < 1:
        columns = max(12, 12 * round(image.shape[1] * scale / 12))
        rows = round(image.shape[0] * columns / image.shape[1])
        focal_px = camera.focal_px * columns / image.shape[1]
        image = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
        camera = replace(camera, width_px=columns, height_px=rows, focal_px=focal_px)
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0.6), np.uint8), camera


def _outside_px(camera: Camera, vertices: Vertices, faces: Faces) -> Float[np.ndarray, "h w"]:
    """Signed distance to the mesh's silhouette, px, positive outside."""
    window = Window(np.empty((camera.height_px, camera.width_px, 0), np.uint8), (0, 0), 1)
    inside = drawn(vertices, faces, window, camera)
    out = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(out - cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def visible_ground(
    camera: Camera,
    outside_px: Float[np.ndarray, "h w"],
    points: Float[np.ndarray, "k 3"],
    clearance_px: float,
) -> tuple[Float[np.ndarray, "k 2"], Bool[np.ndarray, " k"]]:
    """Pixels of ground points, and the mask of those in the picture and outside of the mesh."""
    ahead = camera.into(points)[:, 2] > 0
    pixels = camera.project(points)
    return pixels, ahead & camera.shows(pixels, 2) & (sampled(outside_px, pixels) > clearance_px)


def _gains(
    pairs: Sequence[tuple[UInt8[np.ndarray, "_ _ 3"], Camera]],
    outside: Sequence[Float[np.ndarray, "_ _"]],
    vertices: Vertices,
) -> Float[np.ndarray, "v 3"]:
    """Factors of blue, green and red that match every photo to the median one, by visible ground."""
    middle, radius = ground_centre(vertices)
    turn, far = np.meshgrid(np.linspace(0, 2 * np.pi, 40, endpoint=False), np.linspace(1.2, 3.0, 12))
    ring = np.column_stack([(far * np.cos(turn)).ravel(), (far * np.sin(turn)).ravel(), 0 * turn.ravel()])
    points = ring * radius + middle
    colours = np.full((len(pairs), len(points), 3), np.nan)
    for k, ((image, camera), out) in enumerate(zip(pairs, outside, strict=True)):
        pixels, seen = visible_ground(camera, out, points, 2 * CLEARANCE_PX)
        colours[k, seen] = np.log(sampled(image, pixels[seen]).reshape(-1, 3) + 8.0)
    known = np.isfinite(colours[..., 0]).sum(0) >= FEWEST_SIGHTINGS
    if known.sum() < 30:
        return np.ones((len(pairs), 3))
    apart = np.nanmedian(colours[:, known], axis=0) - colours[:, known]
    enough = np.isfinite(apart[..., 0]).sum(1) >= 30
    gains = np.ones((len(pairs), 3))
    gains[enough] = np.exp(np.nanmedian(apart[enough], axis=1))
    return np.clip(gains, 0.4, 2.5)


def ground_centre(vertices: Vertices) -> tuple[Float[np.ndarray, "3"], float]:
    """The ground point under the mesh's middle, and half its width."""
    low, high = vertices.min(0), vertices.max(0)
    middle = (low + high) / 2
    return np.array([middle[0], middle[1], 0.0]), float((high - low).max() / 2)


def _visible(
    image: Picture, camera: Camera, outside_px: Float[np.ndarray, "h w"], gain: Float[np.ndarray, "3"]
) -> RimView:
    levels = np.clip((np.arange(256)[:, None] + 8.0) * gain - 8.0 + 0.5, 0, 255).astype(np.uint8)
    colours = np.asarray(cv2.cvtColor(cv2.LUT(image, levels[None]), cv2.COLOR_BGR2LAB), np.uint8)
    cell = np.ones((3, 3), np.uint8)
    return RimView(camera, colours, cv2.erode(colours, cell), cv2.dilate(colours, cell), outside_px)


def _rim(view: RimView, vertices: Vertices, normals: Float[np.ndarray, "n 3"], faces: Faces) -> Rim:
    """Samples on edges with just one end facing the camera, on the outer rim, evenly thinned out."""
    camera = view.camera
    edges = sides_of(faces)
    i, j = edges[edges[:, 0] < edges[:, 1]].T
    a, b, t = rim_crossings(vertices, normals, i, j, camera.place)
    points = (1 - t)[:, None] * vertices[a] + t[:, None] * vertices[b]
    pixel = camera.project(points)
    outer = np.abs(sampled(view.outside_px, pixel)) < 1.6
    keep = np.flatnonzero(outer & camera.shows(pixel, 2))
    turn = np.arctan2(*(pixel[keep] - pixel[keep].mean(0)).T) if len(keep) else np.zeros(0)
    keep = keep[np.argsort(turn, kind="stable")]
    if len(keep) > RIM_SAMPLES:
        keep = keep[np.linspace(0, len(keep) - 1, RIM_SAMPLES).round().astype(int)]
    a, b, t, points, pixel = a[keep], b[keep], t[keep], points[keep], pixel[keep]
    ahead = camera.project(points + 0.01 * ((1 - t)[:, None] * normals[a] + t[:, None] * normals[b])) - pixel
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
    return Rim(a, b, t, pixel, ahead, camera.into(points)[:, 2] / camera.focal_px)


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
    rim_views: Sequence[RimView], rims: Sequence[Rim], offsets: Float[np.ndarray, " o"], vertices: Vertices
) -> Profiles:
    """Colours along all rims' normals, and quantiles of what other photos show there of z = 0.

    A photo does not count for its own rims. `known`: FEWEST_SIGHTINGS photos or more show the ground.
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
