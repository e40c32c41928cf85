"""A simulated tactile grasp of a sample fruit by two jaws, and its recording."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from samples.fruit import SampleFruit
from samples.gel_contact import DEFAULT_GEL, Gel
from samples.grasp_plan import PlannedGrasp
from samples.hexahedra import SHIPPED, Fineness
from samples.mismatch.grip import Instant
from samples.mismatch.marker_sensor import DEFAULT_SENSOR, SensorNoise
from samples.mismatch.meshed_fruit import meshed_fruit
from samples.mismatch.nonlinear_body import sound_body
from samples.mismatch.true_recording import (
    TrueRecording,
    as_measured,
    grasped,
    grip_of,
)
from samples.sample_failure import NotInEquilibrium
from tactile.readers.recording import Recording

WIDER_AT_UNLIKE_GELS = 1.0
"""`wider` (meshed_fruit) for two different gels: the softer pad may take the travel of both jaws."""


def simulate(
    fruit: SampleFruit,
    grasp: PlannedGrasp,
    *,
    rng: np.random.Generator,
    gel: Gel | tuple[Gel, Gel] = DEFAULT_GEL,
    fineness: Fineness = SHIPPED,
    progress: Callable[[str], None] | None = None,
) -> Recording:
    """The recording of one grasp at finite strain. Every frame is in equilibrium.

    `gel`: one for both jaws, or the left and the right one (a very stiff gel acts as a rigid jaw). Raises
    NotInEquilibrium if a step does not converge or the contact patch outgrows the pad.
    """
    truth = true_grasp(fruit, grasp, gel=gel, fineness=fineness, progress=progress)
    return as_measured(
        truth, gels=_of_each(gel), noise=SensorNoise(), rng=rng, fruit_id=fruit.fruit_id,
        category="nectarine", sensor=DEFAULT_SENSOR.name,
    )  # fmt: skip


def true_grasp(
    fruit: SampleFruit,
    grasp: PlannedGrasp,
    *,
    gel: Gel | tuple[Gel, Gel] = DEFAULT_GEL,
    fineness: Fineness = SHIPPED,
    progress: Callable[[str], None] | None = None,
) -> TrueRecording:
    """The recording of `simulate` before any noise. Raises NotInEquilibrium."""
    left, right = _of_each(gel)
    stands = meshed_fruit(
        fruit, grasp, sensor=replace(DEFAULT_SENSOR, gel=left), fineness=fineness,
        wider=0.0 if left == right else WIDER_AT_UNLIKE_GELS,
    )  # fmt: skip
    corners = len(grasp.motion.time_s)

    outermost = (
        np.abs(DEFAULT_SENSOR.rest_mm).max(axis=1) > DEFAULT_SENSOR.half_width_mm - DEFAULT_SENSOR.pitch_mm
    )

    def watch(corner: int, instant: Instant) -> None:
        if any(np.any(force_N[outermost]) for force_N in instant.marker_force_N):
            raise NotInEquilibrium("the contact patch grew past the pad: close less or move the pads")
        if progress is not None:
            progress(f"{fruit.fruit_id}: frame {corner + 1} of {corners}")

    return grasped(grasp, grip_of(stands, gel=(left, right)), sound_body(stands), watch=watch)


def _of_each(gel: Gel | tuple[Gel, Gel]) -> tuple[Gel, Gel]:
    return gel if isinstance(gel, tuple) else (gel, gel)
