"""What the photos say beside the mesh's rim: is the ground there seen to be ground, the skin to be skin?

The outlines that a mesh was settled on agree with it by construction. This looks again, with no outline:
a point of the support plane that the mesh leaves free in several photos must keep its colour in them all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import ndimage

from recon.camera import Camera
from recon.closed import vertex_normals
from recon.hull import drawn
from recon.mask import DARKEST_SHADOW, Window, cells_of, colour_density, density_at

DIAMETER_PX = 260.0
"""Photos are shrunk until the fruit is at most this wide (px): finer pixels cost time and tell no more."""
RIM_SAMPLES = 96
REACH_PX = 10
"""How far to either side of the rim a profile reaches, px."""
REACH_SHARE = 0.05
"""The same as a share of the fruit's diameter; the larger counts."""
FREE_PX = 4.0
"""A sighting tells the ground's colour where it is at least this far outside the mesh's rim (px)."""
FEWEST_SIGHTINGS = 3
FURTHEST = 6.0
"""Ground further from the fruit than this many diameters is not looked up: a wall may stand there."""
MOST_EVIDENCE = 3.0
"""Most that one pixel counts for or against skin (natural log of a ratio of densities)."""
MOST_OF_SHADOW = 0.5
"""The same for darkened ground: skin that mirrors the ground at its rim looks like that too."""
CORRELATED = 0.6
"""Share by which a pixel's evidence counts, as neighbours on a profile are alike: blur, texture."""
EDGE_EVIDENCE, EDGE_LAB = 8.0, 25.0
"""Most that a step of colour across the edge counts for, and the step (Lab units) that counts so much."""
SHADOW_SHARE = 0.15
UNUSUAL = 2e-7
"""Density (per Lab unit cubed) of colours that neither model expects."""


@dataclass(frozen=True, kw_only=True)
class RimEvidence:
    """Where each rim sample's photo puts the skin's edge, measured from the mesh's rim.

    Sample i is the point (1 - t) a + t b of the mesh's edge between vertices `a` and `b`, as photo `view`
    sees it. `offset_mm` is the posterior mean of the edge's place (positive: the fruit reaches further than
    the mesh), `sd_mm` its standard deviation, `pixel_mm` a pixel's size there. `odd` is the share of the
    profile's pixels outside the rim that show no ground, `dim` that show it darkened, `through` the share
    inside the rim that shows ground as it is. `known`: three other photos tell the ground's colour there.
    """

    view: Int[np.ndarray, " k"]
    a: Int[np.ndarray, " k"]
    b: Int[np.ndarray, " k"]
    t: Float[np.ndarray, " k"]
    offset_mm: Float[np.ndarray, " k"]
    sd_mm: Float[np.ndarray, " k"]
    pixel_mm: Float[np.ndarray, " k"]
    odd: Float[np.ndarray, " k"]
    dim: Float[np.ndarray, " k"]
    through: Float[np.ndarray, " k"]
    known: Bool[np.ndarray, " k"]


@dataclass(frozen=True)
class _Sight:
    """A photo shrunk, as 8-bit Lab with its range over eight neighbours, and the mesh's distance in it."""

    camera: Camera
    colours: UInt8[np.ndarray, "h w 3"]
    lowest: UInt8[np.ndarray, "h w 3"]
    highest: UInt8[np.ndarray, "h w 3"]
    outside_px: Float[np.ndarray, "h w"]


@dataclass(frozen=True)
class _Rim:
    """Rim samples of one photo: edges' ends, share, pixel, outward normal in the picture, pixel size."""

    a: Int[np.ndarray, " k"]
    b: Int[np.ndarray, " k"]
    t: Float[np.ndarray, " k"]
    pixel: Float[np.ndarray, "k 2"]
    normal: Float[np.ndarray, "k 2"]
    pixel_mm: Float[np.ndarray, " k"]


def rim_evidence(
    images: Sequence[UInt8[np.ndarray, "h w 3"]],
    cameras: Sequence[Camera],
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> RimEvidence:
    """The place of the skin's edge along the normals of the mesh's rim, in every photo anew.

    Along a normal, pixel by pixel, l = log p(colour | skin) - log p(colour | ground). Ground is what the
    other photos show at the same point of z = 0 (median, spread over the photos, range of the eight
    neighbours), as it is or darkened (L* + 16, a*, b* scaled by one k in DARKEST_SHADOW..1); skin is what
    this photo shows further inside; l shrinks to 0 where the two look alike. With an edge at d the profile's
    evidence is sum_{o < d} l - sum_{o > d} l, and a step of colour that the ground does not explain adds to
    it; the posterior over d (flat prior over the reach) gives `offset_mm` and `sd_mm`.
    Cameras have no distortion.
    """
    normals = vertex_normals(vertices, faces)
    pairs = [_shrunk(i, c, vertices) for i, c in zip(images, cameras, strict=True)]
    outside = [_outside_px(c, vertices, faces) for _, c in pairs]
    diameter_px = float(np.median([np.ptp(c.project(vertices), axis=0).max() for _, c in pairs]))
    gains = _gains(pairs, outside, vertices)
    sights = [
        _sight(image, camera, far, gain)
        for (image, camera), far, gain in zip(pairs, outside, gains, strict=True)
    ]
    rims = [_rim(s, vertices, normals, faces) for s in sights]
    reach = max(REACH_PX, round(REACH_SHARE * diameter_px))
    offsets = np.arange(-reach - 6, reach + 7, dtype=float)
    profiles = _profiles(sights, rims, offsets, vertices)
    return _evidence(rims, profiles, offsets, reach)


def _shrunk(
    image: UInt8[np.ndarray, "h w 3"], camera: Camera, vertices: Float[np.ndarray, "n 3"]
) -> tuple[UInt8[np.ndarray, "h w 3"], Camera]:
    """The photo shrunk by a whole factor, lightly blurred, and its camera."""
    factor = max(1, round(float(np.ptp(camera.project(vertices), axis=0).max()) / DIAMETER_PX))
    if factor > 1:
        rows, columns = (n // factor for n in image.shape[:2])
        image = cv2.resize(
            image[: rows * factor, : columns * factor], (columns, rows), interpolation=cv2.INTER_AREA
        )
        # a row or column cut off moves the picture's middle by less than half a small pixel
        camera = replace(camera, width_px=columns, height_px=rows, focal_px=camera.focal_px / factor)
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0.6), np.uint8), camera


def _outside_px(
    camera: Camera, vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "h w"]:
    """Signed distance to the mesh's drawing, px, positive outside."""
    window = Window(np.empty((camera.height_px, camera.width_px, 0), np.uint8), (0, 0), 1)
    inside = drawn(vertices, faces, window, camera)
    out = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(out - cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def _looked_up(
    picture: np.ndarray, pixels: Float[np.ndarray, "k 2"], flags: int = cv2.INTER_LINEAR
) -> np.ndarray:
    """Values at pixels; what misses the picture gets its border."""
    width = 512
    maps = np.zeros((-(-len(pixels) // width) * width, 2), np.float32)
    maps[: len(pixels)] = np.clip(pixels, -9, 3e4)
    found = cv2.remap(picture, maps.reshape(-1, width, 2), None, flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found.reshape(len(maps), *picture.shape[2:])[: len(pixels)])


def _seen(
    camera: Camera, outside_px: Float[np.ndarray, "h w"], points: Float[np.ndarray, "k 3"], free_px: float
) -> tuple[Float[np.ndarray, "k 2"], Bool[np.ndarray, " k"]]:
    """Pixels of ground points, and which of them are in the picture and free of the mesh."""
    ahead = camera.into(points)[:, 2] > 0
    pixels = camera.project(points)
    inside = ((pixels > 2) & (pixels < [camera.width_px - 3, camera.height_px - 3])).all(1)
    return pixels, ahead & inside & (_looked_up(outside_px, pixels) > free_px)


def _gains(
    pairs: Sequence[tuple[UInt8[np.ndarray, "h w 3"], Camera]],
    outside: Sequence[Float[np.ndarray, "h w"]],
    vertices: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "v 3"]:
    """Factors of blue, green and red that bring every photo to the median one, from ground in free sight."""
    middle, radius = _foot(vertices)
    turn, far = np.meshgrid(np.linspace(0, 2 * np.pi, 40, endpoint=False), np.linspace(1.2, 3.0, 12))
    ring = np.column_stack([(far * np.cos(turn)).ravel(), (far * np.sin(turn)).ravel(), 0 * turn.ravel()])
    points = ring * radius + middle
    colours = np.full((len(pairs), len(points), 3), np.nan)
    for k, ((image, camera), out) in enumerate(zip(pairs, outside, strict=True)):
        pixels, seen = _seen(camera, out, points, 2 * FREE_PX)
        colours[k, seen] = np.log(_looked_up(image, pixels[seen]).reshape(-1, 3) + 8.0)
    known = np.isfinite(colours[..., 0]).sum(0) >= FEWEST_SIGHTINGS
    if known.sum() < 30:
        return np.ones((len(pairs), 3))
    apart = np.nanmedian(colours[:, known], axis=0) - colours[:, known]
    enough = np.isfinite(apart[..., 0]).sum(1) >= 30
    gains = np.ones((len(pairs), 3))
    gains[enough] = np.exp(np.nanmedian(apart[enough], axis=1))
    return np.clip(gains, 0.4, 2.5)


def _foot(vertices: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "3"], float]:
    """The ground point under the mesh's middle, and half its width."""
    low, high = vertices.min(0), vertices.max(0)
    middle = (low + high) / 2
    return np.array([middle[0], middle[1], 0.0]), float((high - low).max() / 2)


def _sight(
    image: UInt8[np.ndarray, "h w 3"],
    camera: Camera,
    outside_px: Float[np.ndarray, "h w"],
    gain: Float[np.ndarray, "3"],
) -> _Sight:
    levels = np.clip((np.arange(256)[:, None] + 8.0) * gain - 8.0 + 0.5, 0, 255).astype(np.uint8)
    colours = np.asarray(cv2.cvtColor(cv2.LUT(image, levels[None]), cv2.COLOR_BGR2LAB), np.uint8)
    cell = np.ones((3, 3), np.uint8)
    return _Sight(camera, colours, cv2.erode(colours, cell), cv2.dilate(colours, cell), outside_px)


def _rim(
    sight: _Sight,
    vertices: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
) -> _Rim:
    """Edges whose one end faces the camera and whose other does not, on the outer rim, evenly thinned out."""
    camera = sight.camera
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    a, b = edges[edges[:, 0] < edges[:, 1]].T
    towards = np.einsum("ij,ij->i", camera.place - vertices, normals)
    crossing = (towards[a] > 0) != (towards[b] > 0)
    a, b = a[crossing], b[crossing]
    t = towards[a] / (towards[a] - towards[b])
    points = (1 - t)[:, None] * vertices[a] + t[:, None] * vertices[b]
    pixel = camera.project(points)
    outer = np.abs(_looked_up(sight.outside_px, pixel)) < 1.6
    inside = ((pixel > 2) & (pixel < [camera.width_px - 3, camera.height_px - 3])).all(1)
    keep = np.flatnonzero(outer & inside)
    turn = np.arctan2(*(pixel[keep] - pixel[keep].mean(0)).T) if len(keep) else np.zeros(0)
    keep = keep[np.argsort(turn, kind="stable")]
    if len(keep) > RIM_SAMPLES:
        keep = keep[np.linspace(0, len(keep) - 1, RIM_SAMPLES).round().astype(int)]
    a, b, t, points, pixel = a[keep], b[keep], t[keep], points[keep], pixel[keep]
    ahead = camera.project(points + 0.01 * ((1 - t)[:, None] * normals[a] + t[:, None] * normals[b])) - pixel
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
    return _Rim(a, b, t, pixel, ahead, camera.into(points)[:, 2] / camera.focal_px)


@dataclass(frozen=True)
class _Profiles:
    """Over all samples and offsets: colour seen, ground expected (median, lowest, highest, spread), known."""

    colours: Float[np.ndarray, "k o 3"]
    ground: Float[np.ndarray, "k o 3"]
    lowest: Float[np.ndarray, "k o 3"]
    highest: Float[np.ndarray, "k o 3"]
    spread: Float[np.ndarray, "k o 3"]
    known: Bool[np.ndarray, "k o"]


def _lab(colours: np.ndarray) -> Float[np.ndarray, "*n 3"]:
    """8-bit Lab to Lab units."""
    return np.asarray(colours * np.array([100 / 255, 1, 1], np.float32) - np.array([0, 128, 128], np.float32))


def _profiles(
    sights: Sequence[_Sight],
    rims: Sequence[_Rim],
    offsets: Float[np.ndarray, " o"],
    vertices: Float[np.ndarray, "n 3"],
) -> _Profiles:
    middle, radius = _foot(vertices)
    points, colours, reached = [], [], []
    for s, rim in zip(sights, rims, strict=True):
        pixels = (rim.pixel[:, None] + offsets[:, None] * rim.normal[:, None]).reshape(-1, 2)
        rays = (
            np.column_stack([(pixels - s.camera.middle_px) / s.camera.focal_px, np.ones(len(pixels))])
            @ s.camera.cam_from_world[:3, :3]
        )
        down = rays[:, 2] < -1e-3 * np.linalg.norm(rays, axis=1)
        along = np.where(down, -s.camera.place[2] / np.where(down, rays[:, 2], -1.0), 0.0)
        spot = s.camera.place + along[:, None] * rays
        inside = ((pixels > 0) & (pixels < [s.camera.width_px - 1, s.camera.height_px - 1])).all(1)
        points.append(spot)
        reached.append(down & inside & (np.linalg.norm(spot - middle, axis=1) < 2 * FURTHEST * radius))
        colours.append(_looked_up(s.colours, pixels))
    spots, reach = np.concatenate(points), np.concatenate(reached)
    own = np.repeat(np.arange(len(sights)), [len(p) for p in points])
    count = len(spots)
    stack = np.full((3, len(sights), count, 3), 255, np.uint8)
    seen = np.zeros((len(sights), count), bool)
    for k, s in enumerate(sights):
        pixels, free = _seen(s.camera, s.outside_px, spots, FREE_PX)
        free &= reach & (own != k)
        seen[k] = free
        stack[0, k, free] = _looked_up(s.colours, pixels[free])
        stack[1, k, free] = _looked_up(s.lowest, pixels[free], cv2.INTER_NEAREST)
        stack[2, k, free] = _looked_up(s.highest, pixels[free], cv2.INTER_NEAREST)
    sightings = seen.sum(0)
    shape = (-1, len(offsets), 3)

    def quantile(layer: int, share: float) -> Float[np.ndarray, "k o 3"]:
        rank = np.clip(np.rint(share * (sightings - 1)), 0, len(sights) - 1).astype(int)
        picked = np.take_along_axis(ordered[layer], rank[:, None, None], axis=2)[..., 0]
        return _lab(picked.reshape(shape))

    ordered = [np.sort(np.ascontiguousarray(layer.transpose(1, 2, 0)), axis=2) for layer in stack]
    spread = (quantile(0, 0.8) - quantile(0, 0.2)) / 1.68
    return _Profiles(
        _lab(np.concatenate(colours).reshape(shape)),
        quantile(0, 0.5),
        quantile(1, 0.5),
        quantile(2, 0.5),
        spread,
        (sightings >= FEWEST_SIGHTINGS).reshape(shape[:2]),
    )


def _student(off: Float[np.ndarray, "*n 3"], scale: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, " *n"]:
    """Student's t density in three dimensions, five degrees of freedom."""
    square = np.sum((off / scale) ** 2, axis=-1)
    return np.asarray(0.1206 / np.prod(scale, axis=-1) * (1 + square / 5) ** -4.0)


def _evidence(
    rims: Sequence[_Rim], profiles: _Profiles, offsets: Float[np.ndarray, " o"], reach: int
) -> RimEvidence:
    view = np.repeat(np.arange(len(rims)), [len(r.t) for r in rims])
    out = {k: np.zeros(len(view)) for k in ("offset", "sd", "odd", "dim", "through")}
    known = np.zeros(len(view), bool)
    for k in range(len(rims)):
        mine = view == k
        if mine.sum() < 8:
            continue
        lit, dim, skin, apart = _densities(profiles, mine, offsets)
        ok = profiles.known[mine]
        ground = (1 - SHADOW_SHARE) * lit + SHADOW_SHARE * dim
        odds = np.log(skin + UNUSUAL) - np.log(ground + UNUSUAL)
        least = np.where(dim > lit, -MOST_OF_SHADOW, -MOST_EVIDENCE)
        odds = np.where(ok, apart * np.clip(odds, least, MOST_EVIDENCE), 0.0)
        step = _steps(profiles, mine)
        mean, sd = _edge_of(odds, step, offsets, reach)
        out["offset"][mine], out["sd"][mine] = mean, sd
        beside = (offsets >= 2) & (offsets <= 6)
        within = (offsets <= -2) & (offsets >= -6)
        odd = (odds > 1.5) & ok
        out["odd"][mine] = (odd & (odds > 0))[:, beside].mean(1)
        out["dim"][mine] = ((dim > lit) & (odds < 0) & ok)[:, beside].mean(1)
        out["through"][mine] = ((odds < -1.5) & (lit > dim))[:, within].mean(1)
        known[mine] = ok[:, np.abs(offsets) <= reach].mean(1) > 0.7
    joined = {f: np.concatenate([getattr(r, f) for r in rims]) for f in ("a", "b", "t", "pixel_mm")}
    return RimEvidence(
        view=view,
        a=joined["a"],
        b=joined["b"],
        t=joined["t"],
        offset_mm=out["offset"] * joined["pixel_mm"],
        sd_mm=out["sd"] * joined["pixel_mm"],
        pixel_mm=joined["pixel_mm"],
        odd=out["odd"],
        dim=out["dim"],
        through=out["through"],
        known=known,
    )


def _densities(
    profiles: _Profiles, mine: Bool[np.ndarray, " k"], offsets: Float[np.ndarray, " o"]
) -> tuple[
    Float[np.ndarray, "k o"], Float[np.ndarray, "k o"], Float[np.ndarray, "k o"], Float[np.ndarray, "k o"]
]:
    """Densities of one photo's profile colours as lit ground, darkened ground, and skin; and in 0..1 how far
    skin and ground can be told apart at all there.
    """
    colours, known = profiles.colours[mine], profiles.known[mine]
    ground = profiles.ground[mine]
    off = colours - np.clip(colours, profiles.lowest[mine], profiles.highest[mine])
    sure = known & (offsets >= 6)
    noise = np.array([2.0, 1.5, 1.5])
    if sure.sum() > 50:
        noise = np.clip(1.48 * np.median(np.abs(off[sure]), axis=0), [1.5, 1.0, 1.0], [6.0, 5.0, 5.0])
    scale = np.hypot(noise, profiles.spread[mine])
    lit = _student(off, scale)
    k = (colours[..., 0] + 16) / (ground[..., 0] + 16)
    tint = colours[..., 1:] - k[..., None] * ground[..., 1:]
    square = np.sum((tint / (1.5 * scale[..., 1:])) ** 2, axis=-1)
    plane = 1 / (2 * np.pi * 2.25 * np.prod(scale[..., 1:], axis=-1)) * (1 + square / 5) ** -3.5
    dim = np.where(
        (k > DARKEST_SHADOW) & (k <= 1), plane / ((1 - DARKEST_SHADOW) * (ground[..., 0] + 16)), 0.0
    )
    deep = colours[:, offsets <= -5]
    middle = ndimage.median_filter(np.median(deep, axis=1), size=(9, 1), mode="wrap")
    wide = 1.48 * ndimage.median_filter(
        np.median(np.abs(deep - middle[:, None]), axis=1), size=(9, 1), mode="wrap"
    )
    palette = colour_density(cells_of(deep.reshape(-1, 3)))

    def skin(of: Float[np.ndarray, "k o 3"]) -> Float[np.ndarray, "k o"]:
        near = _student(of - middle[:, None], np.maximum(wide, [4.0, 2.5, 2.5])[:, None])
        return np.asarray(0.5 * near + 0.5 * density_at(palette, cells_of(of)))

    apart = np.log(_student(0 * off, scale) + UNUSUAL) - np.log(skin(ground) + UNUSUAL)
    return lit, dim, skin(colours), np.clip(apart / MOST_EVIDENCE, 0, 1)


def _steps(profiles: _Profiles, mine: Bool[np.ndarray, " k"]) -> Float[np.ndarray, "k o"]:
    """Evidence of an edge at each offset: how far what the ground leaves unexplained jumps there."""
    rest = profiles.colours[mine] - profiles.ground[mine]
    rest = np.where(profiles.known[mine][..., None], rest, profiles.colours[mine])
    rest = np.pad(rest, ((0, 0), (2, 2), (0, 0)), mode="edge")
    jump = (rest[:, 3:-1] + rest[:, 4:] - rest[:, :-4] - rest[:, 1:-3]) / 2
    return np.asarray(EDGE_EVIDENCE * np.minimum(np.linalg.norm(jump, axis=2) / EDGE_LAB, 1.0))


def _edge_of(
    odds: Float[np.ndarray, "k o"],
    step: Float[np.ndarray, "k o"],
    offsets: Float[np.ndarray, " o"],
    reach: int,
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Posterior mean and standard deviation of the edge's offset (px), pooled over the next samples."""
    pooled = ndimage.convolve1d(odds, [0.5, 1.0, 0.5], axis=0, mode="wrap") * CORRELATED
    total = np.cumsum(pooled, axis=1)
    score = (
        2 * total - pooled - total[:, -1:] + ndimage.convolve1d(step, [0.5, 1.0, 0.5], axis=0, mode="wrap")
    )
    inner = np.abs(offsets) <= reach
    score, at = score[:, inner], offsets[inner]
    weight = np.exp(score - score.max(1, keepdims=True))
    weight /= weight.sum(1, keepdims=True)
    mean = weight @ at
    sd = np.sqrt(np.maximum(weight @ at**2 - mean**2, 0.0) + 1 / 12)
    return mean, sd
