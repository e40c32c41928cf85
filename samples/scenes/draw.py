"""A random scene from a seed: every factor has a random stream, so that none depends on another's draws."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from samples.fruit import SampleFruit, SamplePit, Skin, box_mm, on_its_base, triple
from samples.scenes.euro_coin import SceneCoin, draw_coin
from samples.scenes.ground import GROUNDS, SceneGround, draw_ground
from samples.scenes.light import SceneLight, draw_light, softboxes
from samples.scenes.phone import PIPELINES, Pipeline, Shot, draw_pipeline
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

# half of the mat's blank centre (big mat: 37 mm) less a few mm
_LARGEST_HALF_MM = 34.5


@dataclass(frozen=True, kw_only=True)
class SceneKind:
    """A kind of fruit: mean half axes (x suture, y cheeks, z stem), depths of its hollows, its pit.

    Depths are shares of the mean half axis, widths are angles in radians. `pit_over_box`: the pit's semi-axes
    over the half box; `height_spread`: largest relative change of the height. All are assumed, by eye on shop
    fruit.
    """

    half_axes_mm: tuple[float, float, float]
    size_sd: float
    stem_depth: float
    stem_width: float
    blossom_depth: float
    groove_depth: float
    groove_width: float
    lopsided_sd: float
    pit_over_box: tuple[float, float, float]
    height_spread: float


KINDS = {
    "nectarine": SceneKind(
        half_axes_mm=(30.6, 29.6, 29.6), size_sd=0.05, height_spread=0.05, stem_depth=0.12, stem_width=0.30,
        blossom_depth=0.025, groove_depth=0.027, groove_width=0.12, lopsided_sd=0.007,
        pit_over_box=(0.446, 0.328, 0.567),
    ),
    "peach": SceneKind(
        half_axes_mm=(32.6, 32.0, 30.6), size_sd=0.04, height_spread=0.06, stem_depth=0.13, stem_width=0.34,
        blossom_depth=0.02, groove_depth=0.045, groove_width=0.12, lopsided_sd=0.010,
        pit_over_box=(0.43, 0.33, 0.54),
    ),
    "apricot": SceneKind(
        half_axes_mm=(21.8, 20.2, 21.6), size_sd=0.06, height_spread=0.07, stem_depth=0.08, stem_width=0.26,
        blossom_depth=0.01, groove_depth=0.040, groove_width=0.12, lopsided_sd=0.009,
        pit_over_box=(0.50, 0.30, 0.56),
    ),
    "plum": SceneKind(
        half_axes_mm=(21.8, 20.6, 23.0), size_sd=0.06, height_spread=0.12, stem_depth=0.08, stem_width=0.24,
        blossom_depth=0.01, groove_depth=0.018, groove_width=0.12, lopsided_sd=0.009,
        pit_over_box=(0.50, 0.30, 0.56),
    ),
    "cherry": SceneKind(
        half_axes_mm=(12.8, 12.0, 12.0), size_sd=0.05, height_spread=0.07, stem_depth=0.16, stem_width=0.40,
        blossom_depth=0.015, groove_depth=0.012, groove_width=0.16, lopsided_sd=0.010,
        pit_over_box=(0.44, 0.36, 0.46),
    ),
}  # fmt: skip
"""By name, in the units of SceneKind (assumed, by eye on shop fruit)."""


def draw_fruit(rng: np.random.Generator, *, fruit_id: str, seed: int) -> tuple[str, SampleFruit]:
    """Kind and fruit; the fruit's lowest point is at z = 0, its box is centred on the z axis.

    Its pit deviates from the kind's proportions by 1 % of the half box per axis and 4 % in size (standard
    deviations). The modulus is log-uniform over 0.15 to 1.6 MPa.
    """
    name = str(rng.choice(sorted(KINDS)))
    kind = KINDS[name]
    half = np.array(kind.half_axes_mm) * rng.normal(1.0, kind.size_sd) * rng.normal(1.0, 0.015, 3)
    half[2] *= 1 + kind.height_spread * rng.uniform(-1, 1)
    half *= min(1.0, _LARGEST_HALF_MM / half.max())
    mean = float(half.mean())
    skin = Skin(
        half_axes_mm=triple(half),
        stem_depth_mm=mean * kind.stem_depth * float(rng.uniform(0.5, 1.4)),
        stem_width=kind.stem_width * float(rng.uniform(0.85, 1.2)),
        blossom_depth_mm=mean * kind.blossom_depth * float(rng.uniform(0.0, 1.5)),
        groove_depth_mm=mean * kind.groove_depth * float(rng.uniform(0.2, 1.6)),
        groove_width=kind.groove_width * float(rng.uniform(0.8, 1.3)),
        cubic=rng.normal(0.0, kind.lopsided_sd * rng.uniform(0.2, 1.8), (3, 3, 3)),
    )
    low, high = box_mm(skin)
    half_box = (high - low) / 2
    skin = on_its_base(skin)
    pit = SamplePit(
        centre_mm=triple(np.array([0.0, 0.0, half_box[2]]) + rng.normal(0.0, 0.01, 3) * half_box),
        semi_axes_mm=triple(np.array(kind.pit_over_box) * half_box * rng.normal(1.0, 0.04, 3)),
    )
    return name, SampleFruit(
        fruit_id=fruit_id,
        seed=seed,
        skin=skin,
        pit=pit,
        E_MPa=float(0.15 * (1.6 / 0.15) ** rng.uniform()),
        ripeness=float(rng.uniform(0.1, 0.95)),
    )


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
