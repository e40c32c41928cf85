"""Where the photographer stood: two or three rings of hand-held views, some photos from elsewhere."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from samples.viewpoints import Viewpoint, direction, look_at

WIDTH_PX, HEIGHT_PX = 960, 720
"""Of the photos, px: a quarter of a phone's each way; rendering takes as long as there are pixels."""
LIKELY_ODD = 0.3  # share of the sets in which a few photos come from a higher or lower place


@dataclass(frozen=True, kw_only=True)
class Ring:
    """So many photos at one height."""

    elevation_deg: float
    photos: int


@dataclass(frozen=True, kw_only=True)
class ScenePhoto:
    """Mean focal length, mean distance from the fruit, rings, photos from an odd height, exposure (EV)."""

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
    """A camera whose picture is `field_mm` wide at the fruit, its focal length 0.8 to 1.55 picture widths."""
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
    """One view per photo; photo k has the focal length focal_px times focal_scales[k]."""
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
