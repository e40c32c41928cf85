"""The jaws' motion: the line along which they close, and their travel from frame to frame."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from samples.cubed_sphere import even_sphere
from samples.fruit import SampleFruit

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
