"""Where the jaws of the four grasps are: along, across, oblique, and along with the fruit turned round."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from samples.cubed_sphere import even_sphere
from samples.fruit import Skin
from samples.grasp_plan import Hold
from samples.mismatch.protocol import Motion, four_manners, motion_of

TILT_SD_DEG, UNEVEN_SD_MM = 4.0, 0.02
"""How unlike their plan grasps are done, tilt in degrees and depth in mm (set by hand)."""
OBLIQUE_TURN_DEG, OBLIQUE_TILT_DEG = 45.9, -28.8
"""Degrees round the stem and towards it of the third grasp, set by hand: off the fruit's planes of
symmetry."""


@dataclass(frozen=True, kw_only=True)
class CaseGrasp:
    """One grasp: its name, the spots, the motion, and which of the meshes (0, 1, 2) it is solved on.

    `hold` gives the spots in the mesh's order, left pad first; `turned`: the pads have changed places.
    """

    name: str
    hold: Hold
    motion: Motion
    mesh: int
    turned: bool


def four_grasps(
    skin: Skin, *, depth_mm: float, rng: np.random.Generator
) -> tuple[CaseGrasp, CaseGrasp, CaseGrasp, CaseGrasp]:
    """Grasp 1 in a direction drawn at random near the equator, the others relative to it."""
    azimuth = float(rng.uniform(0.0, 360.0))
    tilts = np.clip(rng.normal(0.0, TILT_SD_DEG, 2), -8.0, 8.0)
    uneven = rng.normal(0.0, UNEVEN_SD_MM, 3)
    first = through_centre(skin, azimuth_deg=azimuth, tilt_deg=float(tilts[0]), uneven_mm=float(uneven[0]))
    second = through_centre(
        skin, azimuth_deg=azimuth + 90, tilt_deg=float(tilts[1]), uneven_mm=float(uneven[1])
    )
    third = through_centre(
        skin, azimuth_deg=azimuth + OBLIQUE_TURN_DEG, tilt_deg=OBLIQUE_TILT_DEG, uneven_mm=float(uneven[2])
    )
    holds, meshes = (first, second, third, first), (0, 1, 2, 0)
    manners = four_manners(depth_mm)
    a, b, c, d = (
        CaseGrasp(
            name=f"grasp-{k + 1}", hold=holds[k], motion=motion_of(manners[k]), mesh=meshes[k], turned=k == 3
        )
        for k in range(4)
    )
    return a, b, c, d


def through_centre(skin: Skin, *, azimuth_deg: float, tilt_deg: float, uneven_mm: float) -> Hold:
    """Jaws on a line through the skin's centre; both touch at travel 0, the left `uneven_mm` later."""
    azimuth, tilt = np.radians(azimuth_deg), np.radians(tilt_deg)
    axis = np.array([np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)])
    across = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(axis, across)
    centre = np.asarray(skin.centre_mm)
    heights = (skin.points_mm(_directions()) - centre) @ axis
    return Hold(
        turns=(np.stack([across, up, axis], axis=1), np.stack([-across, up, -axis], axis=1)),
        touch_mm=np.stack([centre + axis * (heights.min() - uneven_mm), centre + axis * heights.max()]),
    )


@cache
def _directions() -> Float[np.ndarray, "n 3"]:
    """Directions in which a skin's height is looked for."""
    return even_sphere(160).directions
