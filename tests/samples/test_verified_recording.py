"""The simulator of truth, coarsely meshed, against a recording of an independent simulator without noise.

tests/data/verified-ball.npz: frames 29 to 33 of grasp 2 of the body `ball` (an ellipsoid of 0.23 MPa round
a rigid pit, Neo-Hookean; pads as beds of springs), loaded to 1.6 N. The other bodies and grasps:
benchmarks/truth_verification.py.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from samples.fruit import SampleFruit, SamplePit, Skin
from samples.gel_contact import Gel
from samples.graded_bricks import BrickGrading
from samples.grasp_plan import CLEARANCE_MM, Hold, PlannedGrasp, straight
from samples.mismatch.marker_sensor import MarkerSensor
from samples.mismatch.meshed_fruit import meshed_fruit
from samples.mismatch.nonlinear_body import sound_body
from samples.mismatch.true_recording import grasped, grip_of

STORED = Path(__file__).parents[1] / "data" / "verified-ball.npz"
COARSE = BrickGrading(cells=2, layers=2)


def stored_ball(truth: dict[str, Any]) -> SampleFruit:
    axes, pit, centre = (tuple(truth[k]) for k in ("axes", "pit", "pit_centre"))
    core = SamplePit(centre_mm=centre, semi_axes_mm=pit)
    skin = Skin(half_axes_mm=axes)
    return SampleFruit(fruit_id="ball", skin=skin, pit=core, E_MPa=truth["E"], poisson_ratio=truth["nu"])


@pytest.mark.slow
def test_an_independent_simulator_records_the_same() -> None:
    with np.load(STORED) as file:
        truth, pose, time_s = json.loads(str(file["truth"])), file["pose"], file["time_s"]
        moved_mm, total_N, rest_mm = 1e-5 * file["displacement_10nm"], file["total_N"], file["rest_mm"]
    gel = Gel(kn_MPa_per_mm=truth["kn"], kt_MPa_per_mm=truth["kt"], friction=truth["friction"])
    travel = (pose[0, :, :3, 3] - pose[0, 0, :3, 3]) @ pose[0, 0, :3, 2] - CLEARANCE_MM
    touch = pose[:, 0, :3, 3] + CLEARANCE_MM * pose[:, 0, :3, 2]
    hold = Hold(turns=(pose[0, 0, :3, :3], pose[1, 0, :3, :3]), touch_mm=touch)
    grasp = PlannedGrasp(name="grasp-2", hold=hold, motion=straight(time_s, travel))
    stands = meshed_fruit(stored_ball(truth), grasp, sensor=MarkerSensor(gel=gel), fineness=COARSE)
    recording = grasped(grasp, grip_of(stands, gel=gel), sound_body(stands))
    np.testing.assert_allclose(recording.rest_mm, rest_mm, atol=1e-9)
    for side, pad in enumerate(recording.pads):
        touched = moved_mm[side, :, 2] < 0.1 * moved_mm[side, :, 2].min()
        away = (pad.displacement_mm[-1] - moved_mm[side])[touched]
        assert np.sqrt((away**2).mean()) < 2e-3
        assert pad.force_N[-1, :, 2].sum() == pytest.approx(total_N[side, -1, 2], rel=0.015)
