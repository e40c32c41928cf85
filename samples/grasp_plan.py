"""The jaws' motion: the line along which they close, and their travel from frame to frame.

A mismatch case has four grasps. Grasp 1 is fast and has two cycles. Grasp 2 is slow and at a right angle to
it. Grasp 3 is oblique and shears during the hold. Grasp 4 repeats the spots of grasp 1 with the pads
exchanged.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from samples.cubed_sphere import even_sphere
from samples.fruit import SampleFruit, Skin

DEEPEST_MM = 1.5
"""Largest travel of each jaw past first touch, mm: a soft fruit's contact patch still fits on the gel."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Piecewise linear motion by its corners: travel of each jaw past first touch, shear of the left pad.

    `recorded` marks the corners that are frames of the recording; the others are instants between frames.
    """

    time_s: Float[np.ndarray, " t"]
    travel_mm: Float[np.ndarray, " t"]
    shear_mm: Float[np.ndarray, " t"]
    recorded: Bool[np.ndarray, " t"]


def straight(time_s: Float[np.ndarray, " t"], travel_mm: Float[np.ndarray, " t"]) -> Motion:
    """A motion without shear, every corner recorded."""
    return Motion(
        time_s=time_s,
        travel_mm=travel_mm,
        shear_mm=np.zeros(len(time_s)),
        recorded=np.ones(len(time_s), dtype=bool),
    )


@dataclass(frozen=True, kw_only=True)
class Hold:
    """Pose of the jaws, left then right: rotations (pad to fruit), and face origins at first touch."""

    turns: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]
    touch_mm: Float[np.ndarray, "2 3"]

    def origins(self, travel_mm: float) -> Float[np.ndarray, "2 3"]:
        """Face origins after a travel of each jaw."""
        return self.touch_mm + travel_mm * np.stack([turn[:, 2] for turn in self.turns])


def two_cycles(*, deepest_mm: float, speed_mm_per_s: float, clearance_mm: float = 0.35) -> Motion:
    """Ten frames in air, load to 0.66 of the deepest, unload, load to the deepest, hold for three frames,
    unload, five frames in air.
    """
    air, away = np.full(10, -clearance_mm), -0.12
    first = np.linspace(0, 0.66 * deepest_mm, 7)[1:]
    off = np.linspace(0.66 * deepest_mm, away, 5)[1:]
    second = np.linspace(0, deepest_mm, 9)[1:]
    hold = np.full(3, deepest_mm)
    last = np.linspace(deepest_mm, away, 7)[1:]
    travel = np.concatenate([air, first, off, second, hold, last, air[:5]])
    still = np.abs(np.diff(travel)) < 1e-9
    pause = np.where(still, 0.1, np.abs(np.diff(travel)) / speed_mm_per_s)
    at_hold = np.abs(travel[1:] - deepest_mm) < 1e-9
    pause[still & at_hold] = 0.5
    return straight(np.concatenate([[0.0], np.cumsum(pause)]), travel)


def hold_along(fruit: SampleFruit, *, azimuth_deg: float, tilt_deg: float, uneven_mm: float = 0.02) -> Hold:
    """Jaws along a direction, centred between their first touches; the left touches `uneven_mm` later."""
    turns = jaw_turns(azimuth_deg=azimuth_deg, tilt_deg=tilt_deg)
    axis = turns[0][:, 2]
    skin = fruit.skin.points_mm(even_sphere(200).directions)
    near, far = skin[np.argmin(skin @ axis)], skin[np.argmax(skin @ axis)]
    middle = (near + far) / 2
    aside = middle - axis * (middle @ axis)
    return Hold(
        turns=turns,
        touch_mm=np.stack([aside + axis * (near @ axis - uneven_mm), aside + axis * (far @ axis)]),
    )


def jaw_turns(
    *, azimuth_deg: float, tilt_deg: float
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """Rotations (pad to fruit) of the left and the right jaw, which close along one direction."""
    azimuth, tilt = np.radians(azimuth_deg), np.radians(tilt_deg)
    axis = np.array([np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)])
    across = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(axis, across)
    return np.stack([across, up, axis], axis=1), np.stack([-across, up, -axis], axis=1)


@dataclass(frozen=True, kw_only=True)
class PlannedGrasp:
    """One grasp to simulate: the recording's name, pose and motion of the jaws.

    `mesh`: number of the case's mesh (0, 1, 2) that the solver uses. `hold` has the spots in the mesh's
    order, left pad first; `turned`: the pads exchange places.
    """

    name: str
    hold: Hold
    motion: Motion
    mesh: int = 0
    turned: bool = False


def planned_grasps(fruit: SampleFruit, *, count: int) -> tuple[PlannedGrasp, ...]:
    """Grasps alternate between two directions, 90 degrees apart, off the suture; each has a random speed."""
    rng = np.random.default_rng([fruit.seed, 6])
    first = rng.uniform(32.0, 58.0)
    plans = []
    for k in range(count):
        azimuth = first + 90.0 * (k % 2) + rng.normal(0.0, 3.0)
        hold = hold_along(fruit, azimuth_deg=azimuth, tilt_deg=rng.normal(0.0, 3.0))
        motion = two_cycles(deepest_mm=DEEPEST_MM, speed_mm_per_s=float(rng.uniform(0.8, 2.5)))
        plans.append(PlannedGrasp(name=f"grasp-{k + 1}", hold=hold, motion=motion))
    return tuple(plans)


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
