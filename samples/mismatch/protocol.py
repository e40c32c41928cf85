"""The four grasps of a mismatch case: how far the jaws close, how fast, and which instants are recorded.

Grasp 1 is fast and has two cycles, grasp 2 crosses it slowly, grasp 3 is oblique and shears during the hold,
grasp 4 takes the spots of grasp 1 with the fruit turned round between the jaws.
"""

from dataclasses import dataclass

import numpy as np

from samples.grasp_plan import Motion

CLEARANCE_MM = 0.4
"""Between pad and skin before and after, mm: more than the skin's own waves (0.1 mm), so that nothing
touches."""
AIR_BEFORE, AIR_AFTER, AIR_STEP_S = 30, 15, 0.1
"""Frames in the air before and after contact, s between them: what zero and drift are told from."""
HOLD_SHARES = (0.04, 0.1, 0.2, 0.35, 0.55, 0.8, 1.0)
"""Of the hold's length at which frames are recorded: denser at first, where creep is fastest."""
LOAD_FRAMES, UNLOAD_FRAMES, SHEAR_FRAMES = 8, 7, 6
"""Frames of closing, opening and shearing: enough that curves show their bend (set by hand)."""
SHEAR_MM, SHEAR_S, PAUSE_S = 1.2, 1.5, 0.4
"""Sideways way of a pad in the hold (mm), its time and the pause before it (s), set by hand."""
LET_GO_MM = -0.02
"""mm past first touch of the last frame of opening: just out of contact."""


@dataclass(frozen=True, kw_only=True)
class Manner:
    """How one grasp is done: depths of its cycles (mm), speed of each jaw (mm/s), hold (s), shear or none."""

    depths_mm: tuple[float, ...]
    speed_mm_per_s: float
    hold_s: float
    shears: bool


def four_manners(depth_mm: float) -> tuple[Manner, Manner, Manner, Manner]:
    """The manners of grasps 1 to 4 for the deepest travel of the first."""
    d = depth_mm
    return (
        Manner(depths_mm=(0.75 * d, d), speed_mm_per_s=4.0, hold_s=3.0, shears=False),
        Manner(depths_mm=(0.85 * d,), speed_mm_per_s=0.5, hold_s=3.0, shears=False),
        Manner(depths_mm=(0.95 * d,), speed_mm_per_s=1.5, hold_s=4.0, shears=True),
        Manner(depths_mm=(0.9 * d,), speed_mm_per_s=1.5, hold_s=3.0, shears=False),
    )


def motion_of(manner: Manner) -> Motion:
    """The corners of one grasp: air, each cycle's load and unload, a hold at the deepest, air again."""
    way = _Way()
    for k in range(AIR_BEFORE):
        way.add(0.0 if k == 0 else AIR_STEP_S, -CLEARANCE_MM)
    way.add(AIR_STEP_S, 0.0, recorded=False)
    last = len(manner.depths_mm) - 1
    for cycle, depth in enumerate(manner.depths_mm):
        step = depth / LOAD_FRAMES / manner.speed_mm_per_s
        for travel in np.linspace(0.0, depth, LOAD_FRAMES + 1)[1:]:
            way.add(step, travel)
        if cycle == last:
            for pause in np.diff([0.0, *HOLD_SHARES]) * manner.hold_s:
                way.add(pause, depth)
            for shear in np.linspace(0.0, SHEAR_MM, SHEAR_FRAMES + 1)[1:] if manner.shears else ():
                way.add(SHEAR_S / SHEAR_FRAMES, depth, shear)
        else:
            way.add(PAUSE_S, depth, recorded=False)
        step = depth / UNLOAD_FRAMES / manner.speed_mm_per_s
        for travel in np.linspace(depth, 0.0, UNLOAD_FRAMES + 1)[1:]:
            way.add(step, travel if travel > 0 else LET_GO_MM)
    for _ in range(AIR_AFTER):
        way.add(AIR_STEP_S, -CLEARANCE_MM)
    return way.motion()


class _Way:
    def __init__(self) -> None:
        self._rows: list[tuple[float, float, float, bool]] = []

    def add(
        self, pause_s: float, travel_mm: float, shear_mm: float | None = None, *, recorded: bool = True
    ) -> None:
        before = self._rows[-1] if self._rows else (0.0, 0.0, 0.0, True)
        shear = before[2] if shear_mm is None else shear_mm
        self._rows.append((before[0] + pause_s, float(travel_mm), float(shear), recorded))

    def motion(self) -> Motion:
        time, travel, shear, recorded = (np.array(c) for c in zip(*self._rows, strict=True))
        return Motion(time_s=time, travel_mm=travel, shear_mm=shear, recorded=recorded.astype(bool))
