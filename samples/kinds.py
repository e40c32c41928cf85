"""Other stone fruit than nectarines, as shapes and skins: plums and cherries, dull and glossy."""

from dataclasses import dataclass, replace

import numpy as np

from samples.fruit import POISSON_RATIO, SampleFruit, SamplePit, Skin, box_mm, triple
from samples.looks import BLACK_CHERRY, BLOOMED_PLUM, RED_CHERRY, WAXY_PLUM, Look


@dataclass(frozen=True, kw_only=True)
class Proportions:
    """A kind of fruit: middle half axes (x suture, y cheeks, z stem), how deep its hollows are, its pit.

    Depths are shares of the mean half axis, widths are angles in radians. `pit_over_box` are the pit's
    semi-axes over the half box. All are assumed, by eye on shop fruit.
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


@dataclass(frozen=True, kw_only=True)
class FruitKind(Proportions):
    """With its skin, and the spread of each half axis."""

    axis_sd: float
    look: Look


_CHERRY = FruitKind(
    half_axes_mm=(12.7, 11.9, 12.2),
    size_sd=0.03,
    axis_sd=0.02,
    stem_depth=0.16,
    stem_width=0.40,
    blossom_depth=0.015,
    groove_depth=0.012,
    groove_width=0.16,
    lopsided_sd=0.012,
    pit_over_box=(0.44, 0.36, 0.46),
    look=RED_CHERRY,
)
"""mm, radians and shares as FruitKind says, by eye on shop fruit."""
_PLUM = FruitKind(
    half_axes_mm=(21.5, 20.0, 24.0),
    size_sd=0.06,
    axis_sd=0.03,
    stem_depth=0.07,
    stem_width=0.22,
    blossom_depth=0.01,
    groove_depth=0.018,
    groove_width=0.12,
    lopsided_sd=0.010,
    pit_over_box=(0.50, 0.30, 0.56),
    look=BLOOMED_PLUM,
)
"""mm, radians and shares likewise."""
KINDS = {
    "cherry": _CHERRY,
    "black-cherry": replace(_CHERRY, half_axes_mm=(13.4, 12.0, 11.4), look=BLACK_CHERRY),
    "plum": _PLUM,
    "waxy-plum": replace(_PLUM, half_axes_mm=(24.0, 23.5, 22.5), stem_depth=0.11, look=WAXY_PLUM),
}
"""By name; half axes in mm, stem cavities as shares of the mean one, by eye on shop fruit."""


def fruit_of_kind(name: str, *, seed: int) -> SampleFruit:
    """A fruit of one of `KINDS`, the same for the same seed; its modulus is 0.5 MPa and plays no part.

    Raises KeyError for another name.
    """
    kind = KINDS[name]
    rng = np.random.default_rng([seed, 6])
    half = np.array(kind.half_axes_mm) * rng.normal(1.0, kind.size_sd) * rng.normal(1.0, kind.axis_sd, 3)
    mean = float(half.mean())
    skin = Skin(
        centre_mm=(0.0, 0.0, 0.0),
        half_axes_mm=triple(half),
        stem_depth_mm=mean * kind.stem_depth * float(rng.uniform(0.85, 1.15)),
        stem_width=kind.stem_width * float(rng.uniform(0.9, 1.1)),
        blossom_depth_mm=mean * kind.blossom_depth,
        groove_depth_mm=mean * kind.groove_depth * float(rng.uniform(0.7, 1.3)),
        groove_width=kind.groove_width,
        cubic=rng.normal(0.0, kind.lopsided_sd, (3, 3, 3)),
    )
    low, high = box_mm(skin)
    middle, half_box = (low + high) / 2, (high - low) / 2
    skin = replace(skin, centre_mm=(float(-middle[0]), float(-middle[1]), float(-low[2])))
    pit = SamplePit(
        centre_mm=(0.0, 0.0, float(half_box[2])),
        semi_axes_mm=triple(np.array(kind.pit_over_box) * half_box),
    )
    return SampleFruit(
        fruit_id=f"{name}-{seed}",
        seed=seed,
        skin=skin,
        pit=pit,
        E_MPa=0.5,
        poisson_ratio=POISSON_RATIO,
        ripeness=0.8,
    )
