"""Images of a camera behind a gel: dark dots on a face that is lit, displaced and seen through a lens.

Each pixel shows the material point of the face whose displaced position projects there. Iteration finds it on
a coarse grid of pixels; cubic splines interpolate, because displacement is smooth. Shading is Lambert's: the
gel's colour times ambient light plus each light's strength times the cosine to the face's inner normal. Dots
have an edge of one pixel; the lens blurs; the sensor adds Gaussian noise and rounds to eight bits.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.interpolate import RectBivariateSpline, make_interp_spline
from scipy.spatial import cKDTree

from tactile.gel_camera import mm_per_px
from tactile.sensors import GelCamera

COARSE_PX = 4
"""Pixels between two exact rays; splines interpolate, because displacement is smooth over a dot's width."""
ROUNDS = 30
"""Most steps of the search for a pixel's material point. It ends at 1e-3 px; each step multiplies the error
by about the slope of the displacement."""

Field = Callable[[Float[np.ndarray, "m 2"]], Float[np.ndarray, "m 3"]]
"""Displacement (mm) of points of the undeformed face."""


@dataclass(frozen=True, kw_only=True)
class GelLight:
    """A distant light: the unit vector from the gel to it (gel frame) and its strength in R, G and B."""

    direction: Float[np.ndarray, "3"]
    colour: Float[np.ndarray, "3"]


@dataclass(frozen=True, kw_only=True)
class GelLook:
    """Dots (places, diameter), brightness of gel and dots (0 to 1), the camera's noise (grey levels)."""

    rest_mm: Float[np.ndarray, "n 3"]
    dot_mm: float = 0.42
    gel: tuple[float, float, float] = (0.62, 0.58, 0.6)
    dot: float = 0.1
    ambient: float = 0.35
    vignette: float = 0.2
    blur_px: float = 0.7
    noise: float = 1.5


def smooth_field(
    x_mm: Float[np.ndarray, " a"], y_mm: Float[np.ndarray, " b"], displacement_mm: Float[np.ndarray, "n 3"]
) -> Field:
    """A twice differentiable displacement through nodal values on a grid, x slowest."""
    grid = displacement_mm.reshape(len(x_mm), len(y_mm), 3)
    splines = [RectBivariateSpline(x_mm, y_mm, grid[..., i], kx=3, ky=3) for i in range(3)]

    def field(at: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 3"]:
        x, y = np.clip(at[:, 0], x_mm[0], x_mm[-1]), np.clip(at[:, 1], y_mm[0], y_mm[-1])
        return np.stack([s.ev(x, y) for s in splines], axis=1)

    return field


def gel_image(
    camera: GelCamera, lights: tuple[GelLight, ...], look: GelLook, field: Field, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """One RGB frame of the gel displaced by `field`."""
    width, height = camera.image_px
    columns, rows = np.arange(0, width + COARSE_PX, COARSE_PX), np.arange(0, height + COARSE_PX, COARSE_PX)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(float)
    material = seen_material(camera, pixels, field)
    shade = _shade(lights, look.ambient, _normals(material, field))
    coarse = np.column_stack([material, shade]).reshape(len(rows), len(columns), 5)
    down = make_interp_spline(rows, np.eye(len(rows)))(np.arange(height))
    across = make_interp_spline(columns, np.eye(len(columns)))(np.arange(width))
    fine = np.einsum("hr,rcx,wc->hwx", down, coarse, across, optimize=True)
    covered = _dots(fine[..., :2], look, pitch_mm=mm_per_px(camera))
    colour = np.asarray(look.gel) * (1.0 - covered[..., None]) + look.dot * covered[..., None]
    image = 255.0 * colour * fine[..., 2:] * _vignette(camera, look.vignette)[..., None]
    image = cv2.GaussianBlur(image, (0, 0), look.blur_px)
    image += rng.normal(scale=look.noise, size=image.shape)
    rounded: UInt8[np.ndarray, "h w 3"] = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return rounded


def seen_material(
    camera: GelCamera, pixels: Float[np.ndarray, "m 2"], field: Field
) -> Float[np.ndarray, "m 2"]:
    """The point of the undeformed face that each pixel shows (beyond the image's edge, too)."""
    scale = mm_per_px(camera)
    turn = camera.gel_from_camera[:2, :2]
    centre = np.array([(camera.image_px[0] - 1) / 2, (camera.image_px[1] - 1) / 2])
    at = camera.gel_from_camera[:2, 3] + scale * (pixels - centre) @ turn.T
    for _ in range(ROUNDS):
        place = np.column_stack([at, np.zeros(len(at))]) + field(at)
        miss = seen_at(camera, place) - pixels
        at = at - scale * miss @ turn.T
        if np.abs(miss).max() < 1e-3:
            break
    return np.asarray(at)


def seen_at(camera: GelCamera, points_mm: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 2"]:
    """Pixels by pinhole and Brown-Conrady distortion (k1, k2, p1, p2, k3); first pixel's centre: (0, 0)."""
    inverse = np.linalg.inv(camera.gel_from_camera)
    local = points_mm @ inverse[:3, :3].T + inverse[:3, 3]
    x, y = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
    k1, k2, p1, p2, k3 = camera.distortion
    r = x**2 + y**2
    radial = 1.0 + r * (k1 + r * (k2 + r * k3))
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x**2)
    bent_y = y * radial + p1 * (r + 2 * y**2) + 2 * p2 * x * y
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    return np.stack([fx * bent_x + cx, fy * bent_y + cy], axis=1)


def _normals(material: Float[np.ndarray, "m 2"], field: Field) -> Float[np.ndarray, "m 3"]:
    """Unit normals of the displaced face, pointing into the gel (towards the camera)."""
    tiny = 0.01
    edges = []
    for axis in np.eye(2):
        slope = (field(material + tiny * axis) - field(material - tiny * axis)) / (2 * tiny)
        edges.append(np.append(axis, 0.0) + slope)
    normal = -np.cross(edges[0], edges[1])
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _shade(
    lights: tuple[GelLight, ...], ambient: float, normals: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m 3"]:
    """Brightness of a white face in R, G and B; 1 everywhere without lights."""
    if not lights:
        return np.ones_like(normals)
    total = np.full_like(normals, ambient)
    for light in lights:
        total += np.maximum(normals @ light.direction, 0.0)[:, None] * light.colour
    return total


def _dots(at: Float[np.ndarray, "h w 2"], look: GelLook, *, pitch_mm: float) -> Float[np.ndarray, "h w"]:
    """How much of each pixel a dot covers."""
    distance, _ = cKDTree(look.rest_mm[:, :2]).query(at.reshape(-1, 2), distance_upper_bound=look.dot_mm)
    inside = np.minimum(distance, look.dot_mm) - look.dot_mm / 2
    return np.clip(0.5 - inside / pitch_mm, 0.0, 1.0).reshape(at.shape[:2])


def _vignette(camera: GelCamera, darkening: float) -> Float[np.ndarray, "h w"]:
    width, height = camera.image_px
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    return np.asarray(1.0 - darkening * (x**2 + y**2) / 2)
