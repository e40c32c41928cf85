"""A ball between two pads along x, meshed coarsely: the fruit of the tests on mismatch cases."""

import numpy as np
from ball_fruit import ball

from samples.fruit import SampleFruit, SamplePit
from samples.gel_contact import Gel
from samples.grasp_plan import Motion, PlannedGrasp, through_centre
from samples.hexahedra import Fineness
from samples.mismatch.drawn_fruit import DrawnFruit
from samples.mismatch.grip import InnerContact
from samples.mismatch.marker_sensor import DEFAULT_SENSOR
from samples.mismatch.meshed_fruit import MeshedFruit, meshed_fruit
from samples.mismatch.skin_compliance import skin_compliance
from samples.mismatch.true_recording import (
    ElasticBody,
    GrippedBody,
    PadTruth,
    TrueRecording,
    grasped,
    grip_of,
)

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


def linear_body(stands: MeshedFruit) -> ElasticBody:
    return ElasticBody(skin_compliance(stands.flesh.stiffness, stands.dofs))


def force_on_fruit(truth: TrueRecording) -> np.ndarray:
    """Sum of both pads' marker forces in the fruit frame, by frame."""
    return np.sum([np.einsum("tij,tnj->ti", p.pose[:, :3, :3], p.force_N) for p in truth.pads], axis=0)


def still_recording(frames: int, *, name: str = "grasp-1", late_N: float = 0.0) -> TrueRecording:
    """Nothing moves, and each marker bears `late_N` in the second half."""
    force = np.zeros((frames, 400, 3))
    force[frames // 2 :, :, 2] = late_N
    pose = np.broadcast_to(np.eye(4), (frames, 4, 4)).copy()
    pad = PadTruth(pose=pose, displacement_mm=np.zeros((frames, 400, 3)), force_N=force)
    return TrueRecording(
        name=name, time_s=0.1 * np.arange(frames), aperture_mm=np.full(frames, 50.0),
        rest_mm=DEFAULT_SENSOR.rest_mm, gel=Gel(), pads=(pad, pad),
    )  # fmt: skip
