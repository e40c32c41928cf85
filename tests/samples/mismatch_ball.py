"""A ball between two pads along x, meshed coarsely: the fruit of the tests on mismatch cases."""

import numpy as np
from ball_fruit import ball

from samples.fruit import SampleFruit, SamplePit
from samples.gel_contact import Gel
from samples.grasp_plan import Motion, PlannedGrasp
from samples.hexahedra import Fineness
from samples.mismatch.bodies import GrippedBody
from samples.mismatch.drawn_fruit import DrawnFruit
from samples.mismatch.four_grasps import through_centre
from samples.mismatch.grip import InnerContact
from samples.mismatch.meshed_fruit import MeshedFruit, meshed_fruit
from samples.mismatch.true_recording import TrueRecording, grasped, grip_of

ROUGH = Fineness(degrees=(0, 7, 14, 45), along=1, depths=(0, 0.3, 1))


def drawn_ball(
    *, E_MPa: float = 0.5, nu: float = 0.45, radius_mm: float = 25.0, core_mm: float = 10.0
) -> DrawnFruit:
    fruit: SampleFruit = ball(radius_mm, core_mm, E_MPa, nu)
    prior = SamplePit(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(core_mm,) * 3)
    return DrawnFruit(category="pdms_ball", fruit=fruit, prior=prior, depth_mm=1.5)


def motion(travel_mm: list[float], *, pause_s: float = 0.1, shear_mm: list[float] | None = None) -> Motion:
    count = len(travel_mm)
    return Motion(
        time_s=np.arange(count) * pause_s,
        travel_mm=np.array(travel_mm),
        shear_mm=np.array(shear_mm or [0.0] * count, dtype=float),
        recorded=np.ones(count, dtype=bool),
    )


def grasp_along_x(drawn: DrawnFruit, way: Motion, *, turned: bool = False) -> PlannedGrasp:
    hold = through_centre(drawn.fruit.skin, azimuth_deg=0.0, tilt_deg=0.0, uneven_mm=0.0)
    return PlannedGrasp(name="grasp-1", hold=hold, motion=way, turned=turned)


def rough(drawn: DrawnFruit, way: Motion, fineness: Fineness = ROUGH) -> tuple[PlannedGrasp, MeshedFruit]:
    grasp = grasp_along_x(drawn, way)
    return grasp, meshed_fruit(drawn.fruit, grasp, sensor=drawn.sensor, fineness=fineness)


def grasped_ball(
    grasp: PlannedGrasp,
    stands: MeshedFruit,
    body: GrippedBody,
    *,
    gel: Gel | None = None,
    inner: InnerContact | None = None,
) -> TrueRecording:
    return grasped(grasp, grip_of(stands, gel=gel or Gel(), inner=inner), body)


def total_N(truth: TrueRecording, pad: int = 0) -> np.ndarray:
    """Normal force of one pad over the frames."""
    return np.asarray(truth.pads[pad].force_N.sum(axis=1)[:, 2])
