"""A random scene from a seed: every factor has a random stream, so that none depends on another's draws."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from samples.fruit import SampleFruit, box_mm
from samples.scenes.euro_coin import SceneCoin, draw_coin
from samples.scenes.ground import GROUNDS, SceneGround, draw_ground
from samples.scenes.light import SceneLight, draw_light, softboxes
from samples.scenes.phone import PIPELINES, Pipeline, Shot, draw_pipeline
from samples.scenes.scene_fruit import draw_fruit
from samples.scenes.sheet import CLEAN_SHEET, Sheet, draw_sheet
from samples.scenes.skin_optics import SkinLook, draw_skin, ripe_skin
from samples.scenes.stand import (
    HEIGHT_PX,
    WIDTH_PX,
    Ring,
    ScenePhoto,
    Turntable,
    before_turntable,
    draw_camera,
    draw_turntable,
    hand_held,
    on_tripod,
)
from samples.viewpoints import Viewpoint

FAMILIES = ("mat", "phone", "turntable")
FIRST_SEED = {"mat": 4000, "phone": 7000, "turntable": 10000}
"""First seed of each family; the families' seeds do not overlap."""
SAMPLE_QUALITY = 72
"""JPEG quality (0 to 100) of a sample's photos, which the package ships."""
_SHAPE, _SKIN, _GROUND, _SHEET, _LIGHT, _CAMERA, _PIPELINE, _COIN, _TURNTABLE = range(9)
"""Numbers of the streams; a new factor comes last, so that the others keep their draws."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """The truth of one set of photos. `half` is work (even index) or scored (odd: held-out, nobody tunes on
    it). The family phone has no mat (`sheet` is None) and at most a coin. In the family turntable the mat
    lies on a disc that turns before a fixed camera.
    """

    family: str
    index: int
    seed: int
    half: str
    fruit_kind: str
    fruit: SampleFruit
    skin: SkinLook
    ground: SceneGround
    sheet: Sheet | None
    coin: SceneCoin | None = None
    light: SceneLight
    camera: ScenePhoto
    pipeline: Pipeline
    shots: tuple[Shot, ...]
    views: tuple[Viewpoint, ...]
    turntable: Turntable | None = None

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{'set' if self.family == 'mat' else self.family}-{self.index:03d}"


def draw_scene(
    index: int, *, photos: int, family: str = "mat", fruit: tuple[str, SampleFruit] | None = None
) -> Scene:
    """Scene number `index` of a family with seed FIRST_SEED + index; the same arguments give the same scene.

    `fruit`: kind and fruit that replace the random one; all other factors keep their random draws. Raises
    KeyError for a family that is not one of FAMILIES.
    """
    seed = FIRST_SEED[family] + index
    phone, turns = family == "phone", family == "turntable"

    def stream(factor: int) -> np.random.Generator:
        return np.random.default_rng([seed, factor])

    kind, stands = fruit or draw_fruit(stream(_SHAPE), fruit_id=f"{family}-{index:03d}", seed=seed)
    low, high = box_mm(stands.skin)
    size = float((high - low).max())
    sheet = None if phone else draw_sheet(stream(_SHEET), fruit_kind=kind)
    coin = draw_coin(stream(_COIN), fruit_radius_mm=float(high[:2].max())) if phone else None
    if phone:
        field = (2.8 * size + (40 if coin else 0), 3.6 * size + (60 if coin else 0))
    else:
        field = (105.0, 150.0) if sheet is not None and sheet.size == "small" else (205.0, 270.0)
    pipeline, shots = draw_pipeline(
        stream(_PIPELINE), photos=photos, kinds=("phone",) if phone else PIPELINES
    )
    camera = draw_camera(stream(_CAMERA), photos=photos, field_mm=field, fewest_rings=1 if phone else 2)
    if turns:
        camera = on_tripod(camera)
    views = (before_turntable if turns else hand_held)(
        camera,
        aim_mm=(0.0, 0.0, 0.42 * float(high[2])),
        focal_scales=np.array([shot.focal_scale for shot in shots]),
    )
    return Scene(
        family=family,
        index=index,
        seed=seed,
        half="scored" if index % 2 else "work",
        fruit_kind=kind,
        fruit=stands,
        skin=draw_skin(stream(_SKIN)),
        ground=draw_ground(stream(_GROUND), kinds=("cloth", "wood") if phone else GROUNDS),
        sheet=sheet,
        coin=coin,
        light=draw_light(stream(_LIGHT)),
        camera=camera,
        pipeline=pipeline,
        shots=shots,
        views=views,
        turntable=draw_turntable(stream(_TURNTABLE)) if turns else None,
    )


def sample_scene(fruit: SampleFruit, *, photos: int) -> Scene:
    """A fruit of the sample batch on a clean mat and wood, between two softboxes, in three rings of photos.

    The same fruit gives the same scene. Its ripeness sets its colour.
    """
    rng = np.random.default_rng([fruit.seed, 3])
    high = float(box_mm(fruit.skin)[1][2])
    focal_px, low, middle = float(rng.uniform(1.45, 1.52)) * WIDTH_PX, round(0.5 * photos), round(photos / 3)
    sizes = (low, middle, photos - low - middle)
    camera = ScenePhoto(
        focal_px=focal_px,
        distance_mm=315.0,
        field_mm=210.0,
        rings=tuple(Ring(elevation_deg=e, photos=n) for e, n in zip((18.0, 42.0, 66.0), sizes, strict=True)),
        odd_photos=(),
        exposure_ev=0.0,
        hand_seed=fruit.seed,
    )
    return Scene(
        family="sample",
        index=0,
        seed=fruit.seed,
        half="work",
        fruit_kind="nectarine",
        fruit=fruit,
        skin=ripe_skin(fruit.ripeness, pattern_seed=fruit.seed),
        ground=draw_ground(rng, kinds=("wood",)),
        sheet=CLEAN_SHEET,
        light=softboxes(azimuth_deg=float(rng.uniform(0, 360)), pattern_seed=fruit.seed),
        camera=camera,
        pipeline=Pipeline(kind="none", jpeg_quality=SAMPLE_QUALITY),
        shots=(Shot(),) * photos,
        views=hand_held(camera, aim_mm=(0.0, 0.0, 0.42 * high), focal_scales=np.ones(photos)),
    )


def scene_mapping(scene: Scene) -> dict[str, Any]:
    """Content of scene.json: every factor by its plain name, and what differs between photos."""
    fruit = scene.fruit
    low, high = box_mm(fruit.skin)
    return {
        "format": "drupe-photo-scene",
        "version": 1,
        "name": scene.name,
        "family": scene.family,
        "index": scene.index,
        "seed": scene.seed,
        "half": scene.half,
        "height_mm": float(high[2] - low[2]),
        "fruit": {
            "kind": scene.fruit_kind,
            "size_mm": (high - low).tolist(),
            "E_MPa": fruit.E_MPa,
            "poisson_ratio": fruit.poisson_ratio,
            "ripeness": fruit.ripeness,
            "shape": fruit.skin.as_mapping(),
            "pit": asdict(fruit.pit),
        },
        "skin": asdict(scene.skin),
        "ground": asdict(scene.ground),
        "mat": scene.sheet and asdict(scene.sheet),
        "coin": scene.coin and asdict(scene.coin),
        "turntable": scene.turntable and asdict(scene.turntable),
        "light": asdict(scene.light),
        "camera": {**asdict(scene.camera), "width_px": WIDTH_PX, "height_px": HEIGHT_PX},
        "pipeline": asdict(scene.pipeline),
        "photos": [
            {"name": f"{k:03d}.jpg", **asdict(shot), "focal_px": view.focal_px}
            for k, (shot, view) in enumerate(zip(scene.shots, scene.views, strict=True))
        ],
    }
