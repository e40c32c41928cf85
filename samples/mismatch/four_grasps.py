"""Where the jaws of the four grasps are: along, across, oblique, and along with the fruit turned round."""

import numpy as np

from samples.cubed_sphere import even_sphere
from samples.fruit import Skin
from samples.grasp_plan import Hold, PlannedGrasp, jaw_turns
from samples.mismatch.protocol import four_manners, motion_of

TILT_SD_DEG, UNEVEN_SD_MM = 4.0, 0.02
"""How unlike their plan grasps are done, tilt in degrees and depth in mm (set by hand)."""
OBLIQUE_TURN_DEG, OBLIQUE_TILT_DEG = 45.9, -28.8
"""Degrees round the stem and towards it of the third grasp, set by hand: off the fruit's planes of
symmetry."""


def four_grasps(skin: Skin, *, depth_mm: float, rng: np.random.Generator) -> tuple[PlannedGrasp, ...]:
    """Grasp 1 in a direction drawn at random near the equator, the others relative to it."""
    azimuth_deg = float(rng.uniform(0.0, 360.0))
    first_tilt_deg, second_tilt_deg = np.clip(rng.normal(0.0, TILT_SD_DEG, 2), -8.0, 8.0).tolist()
    directions = (
        (azimuth_deg, first_tilt_deg),
        (azimuth_deg + 90, second_tilt_deg),
        (azimuth_deg + OBLIQUE_TURN_DEG, OBLIQUE_TILT_DEG),
    )
    holds = [
        through_centre(skin, azimuth_deg=azimuth, tilt_deg=tilt, uneven_mm=uneven_mm)
        for (azimuth, tilt), uneven_mm in zip(
            directions, rng.normal(0.0, UNEVEN_SD_MM, 3).tolist(), strict=True
        )
    ]
    return tuple(
        PlannedGrasp(
            name=f"grasp-{k + 1}", hold=holds[mesh], motion=motion_of(manner), mesh=mesh, turned=k == 3
        )
        for k, (mesh, manner) in enumerate(zip((0, 1, 2, 0), four_manners(depth_mm), strict=True))
    )


def through_centre(skin: Skin, *, azimuth_deg: float, tilt_deg: float, uneven_mm: float) -> Hold:
    """Jaws on a line through the skin's centre; both touch at travel 0, the left `uneven_mm` later."""
    turns = jaw_turns(azimuth_deg=azimuth_deg, tilt_deg=tilt_deg)
    axis = turns[0][:, 2]
    centre = np.asarray(skin.centre_mm)
    heights = (skin.points_mm(even_sphere(160).directions) - centre) @ axis
    return Hold(
        turns=turns,
        touch_mm=np.stack([centre + axis * (heights.min() - uneven_mm), centre + axis * heights.max()]),
    )
