"""The four grasps of a mismatch case: poses of the jaws, their motion, and the recorded instants.

Grasp 1 is fast and has two cycles. Grasp 2 is slow and at a right angle to it. Grasp 3 is oblique and shears
during the hold. Grasp 4 repeats the spots of grasp 1 with the pads exchanged.
"""

from dataclasses import dataclass

import numpy as np

from samples.cubed_sphere import even_sphere
from samples.fruit import Skin
from samples.grasp_plan import Hold, Motion, PlannedGrasp, jaw_turns

TILT_SD_DEG, UNEVEN_SD_MM = 4.0, 0.02
"""Standard deviations of the grasps from their plan: tilt (degrees) and depth (mm), set by hand."""
OBLIQUE_TURN_DEG, OBLIQUE_TILT_DEG = 45.9, -28.8
"""Angles of the third grasp around the stem and towards it, degrees; set by hand, off the fruit's planes of
symmetry."""
CLEARANCE_MM = 0.4
"""Gap of pad and skin before and after, mm: larger than the skin's waves (0.1 mm), so that nothing
touches."""
AIR_BEFORE, AIR_AFTER, AIR_STEP_S = 30, 15, 0.1
"""Frames before and after contact, and seconds between them; they determine zero and drift."""
HOLD_SHARES = (0.04, 0.1, 0.2, 0.35, 0.55, 0.8, 1.0)
"""Times of frames over the hold's length: denser at first, when creep is fastest."""
LOAD_FRAMES, UNLOAD_FRAMES, SHEAR_FRAMES = 8, 7, 6
"""Frames of closing, opening and shearing: enough to resolve the curves' bends (set by hand)."""
SHEAR_MM, SHEAR_S, PAUSE_S = 1.2, 1.5, 0.4
"""Shear travel of a pad in the hold (mm), its duration, and the pause at the first peak (s), set by hand."""
LET_GO_MM = -0.02
"""Travel past first touch of the last frame of opening, mm: just out of contact."""


def four_grasps(skin: Skin, *, depth_mm: float, rng: np.random.Generator) -> tuple[PlannedGrasp, ...]:
    """Grasp 1 in a random direction near the equator, the others relative to it."""
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
    """Jaws on a line through the skin's centre; the right touches at travel 0, the left at `uneven_mm`."""
    turns = jaw_turns(azimuth_deg=azimuth_deg, tilt_deg=tilt_deg)
    axis = turns[0][:, 2]
    centre = np.asarray(skin.centre_mm)
    heights = (skin.points_mm(even_sphere(160).directions) - centre) @ axis
    return Hold(
        turns=turns,
        touch_mm=np.stack([centre + axis * (heights.min() - uneven_mm), centre + axis * heights.max()]),
    )


@dataclass(frozen=True, kw_only=True)
class Manner:
    """Protocol of one grasp: depths of its cycles (mm), speed of each jaw (mm/s), hold (s), shear or not."""

    depths_mm: tuple[float, ...]
    speed_mm_per_s: float
    hold_s: float
    shears: bool


def four_manners(depth_mm: float) -> tuple[Manner, Manner, Manner, Manner]:
    """Protocols of grasps 1 to 4 for the deepest travel of the first."""
    d = depth_mm
    return (
        Manner(depths_mm=(0.75 * d, d), speed_mm_per_s=4.0, hold_s=3.0, shears=False),
        Manner(depths_mm=(0.85 * d,), speed_mm_per_s=0.5, hold_s=3.0, shears=False),
        Manner(depths_mm=(0.95 * d,), speed_mm_per_s=1.5, hold_s=4.0, shears=True),
        Manner(depths_mm=(0.9 * d,), speed_mm_per_s=1.5, hold_s=3.0, shears=False),
    )


def motion_of(manner: Manner) -> Motion:
    """Motion of one grasp: air, load and unload of each cycle with a hold at the last depth, air again."""
    corners: list[tuple[float, float, float, bool]] = []  # time, travel, shear, whether it is a frame

    def go(pause_s: float, travel_mm: float, shear_mm: float | None = None, *, recorded: bool = True) -> None:
        time_s, _, so_far_mm, _ = corners[-1] if corners else (0.0, 0.0, 0.0, True)
        sideways_mm = so_far_mm if shear_mm is None else float(shear_mm)
        corners.append((time_s + pause_s, float(travel_mm), sideways_mm, recorded))

    for k in range(AIR_BEFORE):
        go(0.0 if k == 0 else AIR_STEP_S, -CLEARANCE_MM)
    go(AIR_STEP_S, 0.0, recorded=False)
    last = len(manner.depths_mm) - 1
    for cycle, depth in enumerate(manner.depths_mm):
        step = depth / LOAD_FRAMES / manner.speed_mm_per_s
        for travel in np.linspace(0.0, depth, LOAD_FRAMES + 1)[1:]:
            go(step, travel)
        if cycle == last:
            for pause in np.diff([0.0, *HOLD_SHARES]) * manner.hold_s:
                go(pause, depth)
            for shear in np.linspace(0.0, SHEAR_MM, SHEAR_FRAMES + 1)[1:] if manner.shears else ():
                go(SHEAR_S / SHEAR_FRAMES, depth, shear)
        else:
            go(PAUSE_S, depth, recorded=False)
        step = depth / UNLOAD_FRAMES / manner.speed_mm_per_s
        for travel in np.linspace(depth, 0.0, UNLOAD_FRAMES + 1)[1:]:
            go(step, travel if travel > 0 else LET_GO_MM)
    for _ in range(AIR_AFTER):
        go(AIR_STEP_S, -CLEARANCE_MM)
    time_s, travel_mm, shear_mm, recorded = map(np.array, zip(*corners, strict=True))
    return Motion(time_s=time_s, travel_mm=travel_mm, shear_mm=shear_mm, recorded=recorded)
