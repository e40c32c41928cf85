"""Random fruit of three categories, each with a true pit near the category's prior."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from samples.fruit import (
    MESH_ERROR_MM,
    PIT_OFFSET_SD_MM,
    PIT_SIZE_SD,
    POISSON_RATIO,
    SampleFruit,
    SamplePit,
    Skin,
    triple,
)
from samples.mismatch.marker_sensor import DEFAULT_SENSOR, MarkerSensor, drawn_sensor, with_drawn_noise

Category = Literal["nectarine", "plum", "pdms_ball"]
CATEGORIES: tuple[Category, ...] = ("nectarine", "plum", "pdms_ball")
SOFTEST_MPA, FIRMEST_MPA = 0.15, 1.4
"""Moduli are log-uniform between these, MPa: from ripe to unripe, as in the sample batch (0.2 to 1.4 MPa) and
a little softer."""


MESH_ERRORS_MM = (0.05, 0.12)
"""Range of the RMS error of scans, mm: that of meshes from photos (docs/validation.md, Shape)."""
LARGEST_SHARE = 0.9
"""Largest share of the travel that becomes height of the contact; the gel must be wide enough for it."""


@dataclass(frozen=True, kw_only=True)
class DrawnFruit:
    """The truth of one fruit, the category's pit as its prior, and the depth of its first grasp.

    `sensor`: gel, markers and noise of both pads; `mesh_error_mm`: RMS of its scanned mesh;
    `stated_poisson_ratio`: value in its case file.
    """

    category: Category
    fruit: SampleFruit
    prior: SamplePit
    depth_mm: float
    sensor: MarkerSensor = DEFAULT_SENSOR
    mesh_error_mm: float = MESH_ERROR_MM
    stated_poisson_ratio: float = POISSON_RATIO


@dataclass(frozen=True, kw_only=True)
class _Kind:
    half_axes_mm: tuple[float, float, float]
    spread: float
    stem_mm: tuple[float, float]
    groove_mm: tuple[float, float]
    pit_share: tuple[float, float, float]


_KINDS = {
    "nectarine": _Kind(
        half_axes_mm=(30.6, 30.4, 29.0), spread=0.06, stem_mm=(2.0, 4.0), groove_mm=(0.4, 0.9),
        pit_share=(0.445, 0.327, 0.568),
    ),
    "plum": _Kind(
        half_axes_mm=(21.4, 20.6, 23.0), spread=0.06, stem_mm=(0.6, 1.4), groove_mm=(0.1, 0.4),
        pit_share=(0.389, 0.262, 0.493),
    ),
    "pdms_ball": _Kind(
        half_axes_mm=(25.0, 25.0, 25.0), spread=0.06, stem_mm=(0.0, 0.0), groove_mm=(0.0, 0.0),
        pit_share=(0.4, 0.4, 0.4),
    ),
}  # fmt: skip
"""Half axes, stem cavity and suture in mm, relative spread, the pit's half axes over the fruit's (assumed;
the pdms_ball is the phantom's)."""


def drawn_fruit(
    fruit_id: str,
    *,
    category: Category,
    rng: np.random.Generator,
    pit_shift_mm: Float[np.ndarray, " 3"] | None = None,
    pit_scale: float = 1.0,
    poisson_ratio: float = POISSON_RATIO,
) -> DrawnFruit:
    """A fruit about the origin; its pit is 0.3 mm (per axis) and 2 % off the prior, or moved or scaled.

    E is log-uniform in 0.15 to 1.4 MPa; the deepest travel is 6 to 7.6 % of the radius.
    """
    kind = _KINDS[category]
    half = np.array(kind.half_axes_mm) * np.clip(rng.normal(1.0, kind.spread), 0.88, 1.12)
    half = half * np.clip(rng.normal(1.0, 0.012, 3), 0.975, 1.025)
    skin = Skin(
        half_axes_mm=triple(half),
        stem_depth_mm=float(rng.uniform(*kind.stem_mm)),
        stem_width=float(rng.uniform(0.27, 0.33)),
        blossom_depth_mm=float(rng.uniform(0.0, 0.5)) if kind.stem_mm[1] else 0.0,
        groove_depth_mm=float(rng.uniform(*kind.groove_mm)),
        groove_width=float(rng.uniform(0.12, 0.18)),
        cubic=rng.normal(0.0, 0.005, (3, 3, 3)),
    )
    prior = SamplePit(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=triple(np.array(kind.pit_share) * half))
    centre, sizes = pit_error(rng, pit_shift_mm, pit_scale)
    pit = SamplePit(centre_mm=triple(centre), semi_axes_mm=triple(np.array(prior.semi_axes_mm) * sizes))
    modulus = float(np.exp(rng.uniform(np.log(SOFTEST_MPA), np.log(FIRMEST_MPA))))
    fruit = SampleFruit(fruit_id=fruit_id, skin=skin, pit=pit, E_MPa=modulus, poisson_ratio=poisson_ratio)
    depth = float(half.mean() * rng.uniform(0.06, 0.076))
    return DrawnFruit(category=category, fruit=fruit, prior=prior, depth_mm=depth)


def pit_error(
    rng: np.random.Generator, shift_mm: Float[np.ndarray, " 3"] | None = None, scale: float = 1.0
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Shift (mm) and size ratios of the true pit relative to its prior.

    Both have the category's spread; an injected shift or scale replaces that spread.
    """
    centre, sizes = rng.normal(0.0, PIT_OFFSET_SD_MM, 3), rng.normal(1.0, PIT_SIZE_SD, 3)
    if shift_mm is not None:
        centre = np.asarray(shift_mm, dtype=float)
    return centre, sizes if scale == 1.0 else np.full(3, scale)


def seen_by_drawn_sensor(drawn: DrawnFruit, rng: np.random.Generator) -> DrawnFruit:
    """The same fruit with random sensors of a wide range, and a mesh error of 0.05 to 0.12 mm."""
    radius = float(np.mean(drawn.fruit.skin.half_axes_mm))
    contact = float(np.sqrt(2 * radius * LARGEST_SHARE * drawn.depth_mm))
    return _with_error(replace(drawn, sensor=drawn_sensor(rng, contact_mm=contact)), rng)


def seen_anew(
    drawn: DrawnFruit,
    rng: np.random.Generator,
    *,
    pit_shift_mm: Float[np.ndarray, " 3"] | None = None,
    pit_scale: float = 1.0,
) -> DrawnFruit:
    """Another record of the same grasps: other noise, another scan, another prior.

    The truth stays. The pit deviates from the new prior by the category's spread, or as stated.
    """
    centre, sizes = pit_error(rng, pit_shift_mm, pit_scale)
    prior = SamplePit(
        centre_mm=triple(np.array(drawn.fruit.pit.centre_mm) - centre),
        semi_axes_mm=triple(np.array(drawn.fruit.pit.semi_axes_mm) / sizes),
    )
    return _with_error(replace(drawn, prior=prior, sensor=with_drawn_noise(drawn.sensor, rng)), rng)


def _with_error(drawn: DrawnFruit, rng: np.random.Generator) -> DrawnFruit:
    return replace(drawn, mesh_error_mm=float(rng.uniform(*MESH_ERRORS_MM)))
