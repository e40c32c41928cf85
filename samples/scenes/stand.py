"""Camera positions: hand-held in rings, or on a tripod before a turntable that carries mat and fruit."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from samples.scenes.ground import SceneGround, draw_ground, ground_shape
from samples.viewpoints import Viewpoint, direction, look_at

WIDTH_PX, HEIGHT_PX = 960, 720
"""Size of the photos, px: a quarter of a phone's each way, because rendering time grows with pixels."""
LIKELY_ODD = 0.3  # share of sets with a few photos from a higher or lower place


@dataclass(frozen=True, kw_only=True)
class Ring:
    """Number of photos at one elevation."""

    elevation_deg: float
    photos: int


@dataclass(frozen=True, kw_only=True)
class ScenePhoto:
    """Mean focal length and distance, field width at the fruit, rings, photos off the rings, exposure."""

    focal_px: float
    distance_mm: float
    field_mm: float
    rings: tuple[Ring, ...]
    odd_photos: tuple[int, ...]
    exposure_ev: float
    hand_seed: int


def draw_camera(
    rng: np.random.Generator, *, photos: int, field_mm: tuple[float, float], fewest_rings: int = 2
) -> ScenePhoto:
    """A random camera: field width in the range `field_mm` at the fruit, focal length 0.8 to 1.55 widths."""
    focal = 0.8 * (1.55 / 0.8) ** float(rng.uniform())
    field = float(rng.uniform(*field_mm))
    heights = [float(rng.uniform(*span)) for span in ((14, 25), (36, 50), (58, 72))]
    count = int(rng.integers(fewest_rings, fewest_rings + 2))
    if count == 3:
        sizes = [round(photos * 0.45), round(photos * 0.33)]
        sizes.append(photos - sum(sizes))
    elif count == 2:
        heights = [heights[0], heights[1] + 6.0]
        sizes = [photos - round(photos * 0.42), round(photos * 0.42)]
    else:
        heights, sizes = [float(rng.uniform(25, 42))], [photos]
    several = rng.uniform() < LIKELY_ODD and photos >= 6
    odd = (
        tuple(sorted(rng.choice(photos, int(rng.integers(2, 5)), replace=False).tolist())) if several else ()
    )
    return ScenePhoto(
        focal_px=focal * WIDTH_PX,
        distance_mm=focal * field,
        field_mm=field,
        rings=tuple(Ring(elevation_deg=h, photos=n) for h, n in zip(heights, sizes, strict=True)),
        odd_photos=odd,
        exposure_ev=float(rng.uniform(-0.5, 0.35)),
        hand_seed=int(rng.integers(1 << 30)),
    )


def hand_held(
    camera: ScenePhoto,
    *,
    aim_mm: tuple[float, float, float],
    focal_scales: Float[np.ndarray, " n"],
) -> tuple[Viewpoint, ...]:
    """One hand-held view per photo; photo k has the focal length focal_px times focal_scales[k]."""
    rng = np.random.default_rng([camera.hand_seed, 0])
    views: list[Viewpoint] = []
    for ring in camera.rings:
        start = rng.uniform(0, 360.0)
        for k in range(ring.photos):
            azimuth = np.radians(start + 360.0 * k / ring.photos + rng.normal(0, 5.0))
            elevation_deg = ring.elevation_deg + rng.normal(0, 2.0)
            reach = camera.distance_mm * float(np.clip(rng.normal(1.0, 0.04), 0.9, 1.1))
            if len(views) in camera.odd_photos:
                low, high = (6.0, 10.0) if rng.uniform() < 0.4 else (76.0, 85.0)
                elevation_deg = rng.uniform(low, high)
            elevation = np.radians(elevation_deg)
            where = reach * direction(azimuth, elevation)
            aim = np.asarray(aim_mm) + 0.02 * camera.field_mm * rng.normal(0, 1, 3)
            pose = look_at(where + np.asarray(aim_mm), aim, roll=np.radians(rng.normal(0, 3.0)))
            views.append(
                Viewpoint(
                    cam_from_world=pose,
                    focal_px=camera.focal_px * float(focal_scales[len(views)]),
                    width_px=WIDTH_PX,
                    height_px=HEIGHT_PX,
                )
            )
    return tuple(views)


_STEP_SD_DEG = 1.5
"""Standard deviation of a photo's turn from even steps, degrees: a hand turns the disc by marks (assumed)."""


@dataclass(frozen=True, kw_only=True)
class Turntable:
    """The disc, and a card with a half width and half height `card_half_mm`. The card is upright on the
    table, `card_mm` behind the axis for the camera.
    """

    radius_mm: float
    height_mm: float
    srgb: tuple[float, float, float]
    card: SceneGround
    card_mm: float
    card_half_mm: tuple[float, float]


def draw_turntable(rng: np.random.Generator) -> Turntable:
    """A random turntable: a pale or dark disc, larger than the mat, and a card with a pattern."""
    grey = float(rng.choice((0.15, 0.85)))
    radius = float(rng.uniform(150, 170))
    return Turntable(
        radius_mm=radius,
        height_mm=float(rng.uniform(8, 30)),
        srgb=(grey, grey, grey),
        card=draw_ground(rng, kinds=("cloth", "wood")),
        card_mm=radius + float(rng.uniform(20, 60)),
        card_half_mm=(float(rng.uniform(120, 200)), float(rng.uniform(50, 90))),
    )


def on_tripod(camera: ScenePhoto) -> ScenePhoto:
    """The camera at the mean elevation of its rings for all photos."""
    height = float(np.mean([ring.elevation_deg for ring in camera.rings]))
    photos = sum(ring.photos for ring in camera.rings)
    return replace(camera, rings=(Ring(elevation_deg=height, photos=photos),), odd_photos=())


def before_turntable(
    camera: ScenePhoto, *, aim_mm: tuple[float, float, float], focal_scales: Float[np.ndarray, " n"]
) -> tuple[Viewpoint, ...]:
    """One view per photo in the mat's frame: the camera is fixed, and the disc turns by about an even step.

    The camera takes the first photo from the suture's side (+x).
    """
    rng = np.random.default_rng([camera.hand_seed, 0])
    (ring,) = camera.rings
    off_mm, roll = rng.normal(0, 0.02 * camera.field_mm, 3), np.radians(rng.normal(0, 2.0))
    elevation = np.radians(ring.elevation_deg)
    views = []
    for k in range(ring.photos):
        turn = np.radians(360.0 * k / ring.photos + (rng.normal(0, _STEP_SD_DEG) if k else 0.0))
        c, s = np.cos(turn), np.sin(turn)
        about = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        eye = camera.distance_mm * np.array([np.cos(elevation), 0.0, np.sin(elevation)]) + aim_mm
        pose = look_at(about @ eye, about @ (off_mm + aim_mm), roll=roll)
        focal = camera.focal_px * float(focal_scales[k])
        views.append(Viewpoint(cam_from_world=pose, focal_px=focal, width_px=WIDTH_PX, height_px=HEIGHT_PX))
    return tuple(views)


def turntable_shapes(mi: Any, turntable: Turntable, *, z_mm: float) -> dict[str, Any]:
    """Disc (its top at z_mm), its rim, and the card for a camera in the direction +x."""
    to, foot = mi.ScalarTransform4f, z_mm - turntable.height_mm
    plastic = {"type": "diffuse", "reflectance": {"type": "srgb", "color": list(turntable.srgb)}}
    half_wide, half_high = turntable.card_half_mm
    upright = to().translate([-turntable.card_mm, 0, foot + half_high]).rotate([0, 1, 0], 90)
    return {
        "disc": {
            "type": "disk", "bsdf": plastic,
            "to_world": to().translate([0, 0, z_mm]).scale([turntable.radius_mm, turntable.radius_mm, 1]),
        },
        "rim": {
            "type": "cylinder", "bsdf": plastic, "p0": [0, 0, foot], "p1": [0, 0, z_mm],
            "radius": turntable.radius_mm,
        },
        "card": {
            **ground_shape(mi, turntable.card, z_mm=0.0),
            "to_world": upright @ to().scale([half_high, half_wide, 1]),
        },
    }  # fmt: skip
