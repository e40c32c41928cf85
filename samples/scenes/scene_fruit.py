"""The fruit of a scene: random kind, size, asymmetry, stem cavity, suture, pit and modulus."""

from dataclasses import dataclass

import numpy as np

from samples.fruit import SampleFruit, SamplePit, Skin, box_mm, on_its_base, triple

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
