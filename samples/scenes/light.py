"""The light of a scene: fixed lamps, ambient light, and flash and shadows that move with the camera."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from recon.triangle_mesh import Mesh
from samples.cubed_sphere import even_sphere
from samples.fruit import triple
from samples.viewpoints import Viewpoint

Rgb = tuple[float, float, float]
LIGHTS = ("camera-flash", "hard-lamp", "overcast", "photographer-shadow", "ring-flash", "two-lamps", "window")
_KEY = 3.0  # irradiance of the main light on the table's centre, arbitrary units
_NEUTRAL: Rgb = (1.0, 0.97, 0.93)
"""Linear RGB of a lamp: a little warmer than white (by eye)."""
_SINGLE_LAMPS = {
    "window": ((0.15, 0.45), (18, 38), (1100, 1700), (330, 520)),
    "overcast": ((1.0, 1.5), (60, 85), (1300, 1700), (500, 800)),
    "hard-lamp": ((0.10, 0.30), (35, 65), (600, 1000), (8, 15)),
    "photographer-shadow": ((0.2, 0.4), (35, 50), (1300, 1700), (90, 220)),
}
"""Lights of one lamp: ranges of ambient share, elevation (degrees), distance and half side (mm)."""


@dataclass(frozen=True, kw_only=True)
class Lamp:
    """A rectangle with half sides `half_mm` that faces the mat's centre from a direction and a distance."""

    azimuth_deg: float
    elevation_deg: float
    distance_mm: float
    half_mm: tuple[float, float]
    rgb: Rgb
    share: float


@dataclass(frozen=True, kw_only=True)
class SceneLight:
    """`room`: ambient irradiance over the main light's. `lamps` are fixed; a flash (inner and outer radius,
    offset right and up from the lens, mm) and the photographer's body move with the camera.
    """

    kind: str
    room: float
    room_rgb: Rgb
    lamps: tuple[Lamp, ...]
    flash_radii_mm: tuple[float, float] | None
    flash_offset_mm: tuple[float, float]
    photographer: bool
    pattern_seed: int


def draw_light(rng: np.random.Generator) -> SceneLight:
    """A random light, with equal probability for each of `LIGHTS`."""
    kind = str(rng.choice(LIGHTS))
    azimuth, tint = float(rng.uniform(0, 360)), rng.normal(0, 0.04)
    colour = triple(np.array(_NEUTRAL) * (1 + tint, 1.0, 1 - tint))
    lamps: tuple[Lamp, ...] = ()
    radii, offset = None, (0.0, 0.0)
    if kind in _SINGLE_LAMPS:
        room_share, elevation_deg, distance_mm, half_mm = _SINGLE_LAMPS[kind]
        room = float(rng.uniform(*room_share))
        lamps = (_lamp(rng, azimuth, elevation_deg, distance_mm, half_mm, colour),)
    elif kind == "ring-flash":
        room, radii = float(rng.uniform(0.05, 0.3)), (22.0, float(rng.uniform(32, 45)))
    elif kind == "camera-flash":
        room, radii = float(rng.uniform(0.05, 0.3)), (0.0, float(rng.uniform(3, 6)))
        offset = (float(rng.uniform(-15, 15)), float(rng.uniform(12, 40)))
    else:
        room = float(rng.uniform(0.10, 0.30))
        apart = azimuth + float(rng.uniform(80, 180))
        share = float(rng.uniform(0.35, 0.65))
        lamps = (
            _lamp(rng, azimuth, (30, 60), (600, 1000), (50, 130), (1.0, 0.74, 0.48), share=share),
            _lamp(rng, apart, (30, 60), (600, 1000), (50, 130), (0.70, 0.84, 1.0), share=1 - share),
        )
    return SceneLight(
        kind=kind,
        room=room,
        room_rgb=triple(np.clip(rng.normal(1.0, 0.05, 3), 0.8, 1.2)),
        lamps=lamps,
        flash_radii_mm=radii,
        flash_offset_mm=offset,
        photographer=kind == "photographer-shadow",
        pattern_seed=int(rng.integers(1 << 30)),
    )


def softboxes(*, azimuth_deg: float, pattern_seed: int) -> SceneLight:
    """Two softboxes in bright ambient light, as in product photos."""
    lamps = tuple(
        Lamp(azimuth_deg=azimuth_deg + turn, elevation_deg=elevation, distance_mm=700.0,
             half_mm=(150.0, 110.0), rgb=_NEUTRAL, share=share)
        for turn, elevation, share in ((0.0, 52.0, 0.65), (150.0, 35.0, 0.35))
    )  # fmt: skip
    return SceneLight(
        kind="two-lamps", room=0.5, room_rgb=(0.95, 1.0, 1.07), lamps=lamps, flash_radii_mm=None,
        flash_offset_mm=(0.0, 0.0), photographer=False, pattern_seed=pattern_seed,
    )  # fmt: skip


def standing_lights(mi: Any, light: SceneLight) -> dict[str, Any]:
    """Ambient light and fixed lamps, for the renderer."""
    made: dict[str, Any] = {
        "room": {
            "type": "envmap", "bitmap": mi.Bitmap(room_picture(light)),
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90),
        },
    }  # fmt: skip
    for k, lamp in enumerate(light.lamps):
        made[f"lamp{k}"] = lamp_shape(mi, lamp, radiance=lamp_radiance(lamp))
    return made


def lamp_shape(mi: Any, lamp: Lamp, *, radiance: Rgb) -> dict[str, Any]:
    """A lamp for the renderer."""
    to = mi.ScalarTransform4f
    frame = to().rotate([0, 0, 1], lamp.azimuth_deg).rotate([0, 1, 0], 90 - lamp.elevation_deg)
    frame = frame @ to().translate([0, 0, lamp.distance_mm]).scale([*lamp.half_mm, 1])
    return {
        "type": "rectangle", "to_world": frame @ to().rotate([1, 0, 0], 180),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}},
    }  # fmt: skip


def lamp_radiance(lamp: Lamp) -> Rgb:
    """Radiance that gives the lamp its share of the main irradiance: E = L A sin(elevation) / distance^2."""
    area = 4 * lamp.half_mm[0] * lamp.half_mm[1]
    level = lamp.share * _KEY * lamp.distance_mm**2 / (area * np.sin(np.radians(lamp.elevation_deg)))
    return triple(level * np.array(lamp.rgb))


def flash_radiance(light: SceneLight, *, distance_mm: float) -> Rgb:
    """Radiance of the flash that gives the main irradiance straight ahead: E = L A / distance^2."""
    inner, outer = light.flash_radii_mm or (0.0, 1.0)
    return triple(_KEY * distance_mm**2 / (np.pi * (outer**2 - inner**2)) * np.array(_NEUTRAL))


def flash_mesh(light: SceneLight, view: Viewpoint) -> Mesh:
    """The flash as a flat ring (or disc) around the lens, in the world frame; it faces along the view."""
    parts, (inner, outer) = 24, light.flash_radii_mm or (0.0, 1.0)
    turn = 2 * np.pi * np.arange(parts) / parts
    circle = np.stack([np.cos(turn), np.sin(turn), np.zeros(parts)], axis=1)
    right, up = light.flash_offset_mm
    ring = np.concatenate([max(inner, 0.01) * circle, outer * circle])
    ring += np.array([right, -up, -3.0])
    k, following = np.arange(parts), (np.arange(parts) + 1) % parts
    # outward normals along the camera's +z
    triangles = np.concatenate(
        [np.stack([k, k + parts, following + parts], 1), np.stack([k, following + parts, following], 1)]
    )
    return _in_world(ring, view), triangles


def photographer_mesh(view: Viewpoint) -> Mesh:
    """The photographer's body behind the camera and the phone in front of it, which cast shadows."""
    sphere = even_sphere(12)
    eye = -view.cam_from_world[:3, :3].T @ view.cam_from_world[:3, 3]
    out = eye[:2] / max(float(np.linalg.norm(eye[:2])), 1e-6)
    body = sphere.directions * [110.0, 210.0, 430.0]
    turned = np.stack(
        [out[0] * body[:, 0] - out[1] * body[:, 1], out[1] * body[:, 0] + out[0] * body[:, 1]], 1
    )
    centre = np.array([*(eye[:2] + 240.0 * out), eye[2] + 120.0])
    body = np.column_stack([turned, body[:, 2]]) + centre
    phone = np.array([(-75, -38, -6), (75, -38, -6), (75, 38, -6), (-75, 38, -6)], float)
    sheet = len(body) + np.array([(0, 1, 2), (0, 2, 3)])
    return (
        np.concatenate([body, _in_world(phone, view)]),
        np.concatenate([sphere.triangles(), sheet]),
    )


def room_picture(light: SceneLight) -> Float[np.ndarray, "h w 3"]:
    """Environment map of blurred surroundings; its mean irradiance is `room` times the main light's."""
    rng = np.random.default_rng([light.pattern_seed, 0])
    spread = 0.12 if light.kind == "overcast" else 0.5
    blobs = rng.normal(0, spread, (5, 9, 1)) + rng.normal(0, 0.12 * spread, (5, 9, 3))
    blobs[:, -1] = blobs[:, 0]
    smooth = cv2.resize(blobs, (96, 48), interpolation=cv2.INTER_CUBIC)
    edges = cv2.resize(rng.normal(0, 0.4 * spread, (10, 18, 1)), (96, 48), interpolation=cv2.INTER_NEAREST)
    picture = np.exp(smooth + cv2.GaussianBlur(edges, (0, 0), 0.8)[..., None])
    up = np.linspace(1, -1, 48)[:, None, None]
    picture *= np.where(up > 0, 0.8 + 0.4 * up, 0.55)
    picture *= light.room * _KEY / (np.pi * picture[:24].mean()) * np.array(light.room_rgb)
    return np.asarray(picture, dtype=np.float32)


def _lamp(
    rng: np.random.Generator,
    azimuth_deg: float,
    elevation_deg: tuple[float, float],
    distance_mm: tuple[float, float],
    half_mm: tuple[float, float],
    rgb: Rgb,
    *,
    share: float = 1.0,
) -> Lamp:
    return Lamp(
        azimuth_deg=azimuth_deg % 360.0,
        elevation_deg=float(rng.uniform(*elevation_deg)),
        distance_mm=float(rng.uniform(*distance_mm)),
        half_mm=(float(rng.uniform(*half_mm)), float(rng.uniform(*half_mm))),
        rgb=rgb,
        share=share,
    )


def _in_world(points: Float[np.ndarray, "n 3"], view: Viewpoint) -> Float[np.ndarray, "n 3"]:
    pose = view.cam_from_world
    return np.asarray((points - pose[:3, 3]) @ pose[:3, :3])
