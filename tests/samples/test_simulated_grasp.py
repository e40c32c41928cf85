"""Grasps of sample fruit on coarse bricks, against an independent simulator, and as they are shipped.

tests/data/verified-ball.npz: frames 29 to 33 of grasp 2 of the body `ball` (an ellipsoid of 0.23 MPa round
a rigid pit, Neo-Hookean; pads as beds of springs), loaded to 1.6 N. The other bodies and grasps:
benchmarks/truth_verification.py.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ball_fruit import ball
from mismatch_ball import total_N

from samples.fruit import SampleFruit, SamplePit, Skin, fruit_of_seed, fruits_of_seed
from samples.gel_contact import DEFAULT_GEL, Gel
from samples.graded_bricks import BrickGrading
from samples.grasp_plan import CLEARANCE_MM, Hold, PlannedGrasp, hold_along, planned_grasps, straight
from samples.hexahedra import COARSE, Fineness
from samples.mismatch.marker_sensor import MarkerSensor, SensorNoise, measured
from samples.mismatch.meshed_fruit import meshed_fruit
from samples.mismatch.nonlinear_body import sound_body
from samples.mismatch.true_recording import TrueRecording, grasped, grip_of
from samples.sample_batch import true_grasp
from samples.sample_failure import NotInEquilibrium, SampleFailure
from samples.shipped import shipped_batches, write_shipped
from tactile.readers.recording import GelPad, read_recording

FRUIT = fruit_of_seed("a", seed=1, E_MPa=0.5)
UNDER_THE_PAD = Fineness(degrees=(0, 3, 6, 10, 17, 45), along=1, depths=(0, 0.15, 1))
STIFF = Gel(kn_MPa_per_mm=20.0, kt_MPa_per_mm=8.0)


def grasp(*travel_mm: float) -> PlannedGrasp:
    hold = hold_along(FRUIT, azimuth_deg=40.0, tilt_deg=2.0)
    return PlannedGrasp(
        name="a", hold=hold, motion=straight(np.arange(len(travel_mm)) * 0.1, np.array(travel_mm))
    )


def ball_grasp(travel_mm: float) -> PlannedGrasp:
    hold = hold_along(ball(30.0, 6.0, 0.5, 0.3), azimuth_deg=0.0, tilt_deg=0.0, uneven_mm=0.0)
    return replace(grasp(-0.1, travel_mm), hold=hold)


@pytest.fixture(scope="module")
def truth() -> TrueRecording:
    return true_grasp(FRUIT, grasp(-0.3, -0.3, 0.2, 0.9, 0.9, -0.2), fineness=COARSE)


def test_markers_are_pressed_in_and_push_the_fruit_where_they_touch(truth: TrueRecording) -> None:
    for pad in truth.pads:
        assert not pad.force_N[[0, 1, 5]].any()
        assert not pad.displacement_mm[[0, 1, 5]].any()
        assert pad.displacement_mm[3, :, 2].min() < -0.2
        assert pad.displacement_mm[..., 2].max() <= 0
        assert pad.force_N == pytest.approx(-pad.displacement_mm * np.array([0.055, 0.055, 0.22]))
        assert pad.force_N[3, :, 2].sum() > 2.0


def test_force_grows_with_the_modulus_and_hardly_with_the_law(truth: TrueRecording) -> None:
    linear, firm = (
        true_grasp(replace(FRUIT, E_MPa=E_MPa), grasp(-0.3, 0.9), fineness=COARSE) for E_MPa in (0.5, 1.5)
    )
    assert 1.3 < total_N(firm)[1] / total_N(linear)[1] < 3.0
    assert total_N(linear)[1] == pytest.approx(total_N(truth)[3], rel=0.05)


def test_a_jaw_without_gel_pushes_back_as_hard_and_gives_way_less() -> None:
    unlike = true_grasp(FRUIT, grasp(-0.3, 0.5), gel=(DEFAULT_GEL, STIFF), fineness=COARSE)
    assert total_N(unlike, 1)[1] == pytest.approx(total_N(unlike, 0)[1], rel=0.1)
    soft, stiff = (-pad.displacement_mm[1, :, 2].min() for pad in unlike.pads)
    assert stiff < 0.1 * soft


def test_a_patch_that_grows_past_the_pad_is_refused() -> None:
    rigid = ball(30.0, 12.0, 100.0, 0.3)
    with pytest.raises(NotInEquilibrium, match="grew past the pad"):
        true_grasp(rigid, ball_grasp(2.2), fineness=COARSE)


def test_patch_under_a_hard_smooth_face_is_as_wide_as_hertz_says() -> None:
    # a^3 = 3 F R (1 - nu^2) / (4 E), whatever lies behind (Johnson 1985, eq. 4.22); there <r^2> = 2 a^2 / 5
    hard = Gel(kn_MPa_per_mm=10.0, kt_MPa_per_mm=1e-6, friction=0.0)
    recording = true_grasp(ball(30.0, 6.0, 0.5, 0.3), ball_grasp(0.3), fineness=UNDER_THE_PAD, gel=hard)
    share = recording.pads[0].force_N[1, :, 2]
    width = np.sqrt(2.5 * (share @ (recording.rest_mm**2).sum(axis=1)) / share.sum())
    assert width == pytest.approx((3 * share.sum() * 30.0 * 0.91 / (4 * 0.5)) ** (1 / 3), rel=0.03)


def test_sensor_noise_is_what_it_says_and_is_rounded() -> None:
    rng = np.random.default_rng(2)
    still = np.zeros((400, 50, 3))
    noise = SensorNoise()
    felt, pushed = measured(still, still, noise, rng)
    about_mean = felt - felt.mean(axis=0)
    assert about_mean.std() == pytest.approx(noise.displacement_mm, rel=0.03)
    assert felt.mean(axis=0).std() == pytest.approx(noise.reference_mm, rel=0.2)
    lag = (about_mean[1:] * about_mean[:-1]).mean() / about_mean.var()
    assert lag == pytest.approx(noise.correlation, abs=0.03)
    assert np.array_equal(pushed, np.rint(pushed * 2**13) / 2**13)


def test_planned_grasps_cross_and_keep_off_the_groove() -> None:
    for seed in range(3):
        first, second = planned_grasps(fruit_of_seed("a", seed=seed, E_MPa=1.0), count=2)
        a, b = first.hold.turns[0][:, 2], second.hold.turns[0][:, 2]
        assert abs(a @ b) < 0.3
        assert min(abs(a[1]), abs(b[1])) > 0.35


STORED = Path(__file__).parents[1] / "data" / "verified-ball.npz"
COARSE_BRICKS = BrickGrading(cells=2, layers=2)


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
    stands = meshed_fruit(stored_ball(truth), grasp, sensor=MarkerSensor(gel=gel), fineness=COARSE_BRICKS)
    recording = grasped(grasp, grip_of(stands, gel=gel), sound_body(stands))
    np.testing.assert_allclose(recording.rest_mm, rest_mm, atol=1e-9)
    for side, pad in enumerate(recording.pads):
        touched = moved_mm[side, :, 2] < 0.1 * moved_mm[side, :, 2].min()
        assert np.sqrt(((pad.displacement_mm[-1] - moved_mm[side])[touched] ** 2).mean()) < 2e-3
        assert pad.force_N[-1, :, 2].sum() == pytest.approx(total_N[side, -1, 2], rel=0.015)


DATA = Path("samples/data")


def test_the_main_batch_and_the_tiny_one_are_shipped() -> None:
    assert shipped_batches() == ("nectarines", "two-fruits")


@pytest.mark.parametrize("name", ["nectarines", "two-fruits"])
def test_a_shipped_batch_is_copied_whole(name: str, tmp_path: Path) -> None:
    write_shipped(name, tmp_path / "copy")
    listed = [sorted(p.relative_to(f) for p in f.rglob("*")) for f in (DATA / name, tmp_path / "copy")]
    assert listed[0] == listed[1]
    with pytest.raises(SampleFailure, match="not an empty folder"):
        write_shipped(name, tmp_path / "copy")


def test_an_unknown_batch_is_refused_with_the_known_names(tmp_path: Path) -> None:
    with pytest.raises(SampleFailure, match="there are: nectarines, two-fruits"):
        write_shipped("cherries", tmp_path / "copy")


@pytest.mark.parametrize("name", ["nectarines", "two-fruits"])
def test_every_shipped_recording_reads_and_is_loaded(name: str) -> None:
    for path in sorted((DATA / name).glob("fruits/*/grasps/*.h5")):
        recording = read_recording(path)
        assert recording.fruit_id == path.parent.parent.name
        for pad in recording.pads:
            assert isinstance(pad, GelPad)
            assert pad.force_N[27, :, 2].sum() > 2.0


@pytest.mark.slow
def test_a_shipped_recording_is_what_the_simulator_gives() -> None:
    # it was made by another contact solver, on the nodes of the same bricks
    answers = json.loads((DATA / "nectarines/answers.json").read_text())
    fruit = fruits_of_seed(4, seed=answers["seed"])[0]
    assert fruit.E_MPa == answers["fruits"]["N01"]["E_MPa"]
    plan = planned_grasps(fruit, count=1)[0]
    first_press = slice(9, 16)
    way = straight(plan.motion.time_s[first_press], plan.motion.travel_mm[first_press])
    simulated = true_grasp(fruit, replace(plan, motion=way))
    shipped = read_recording(DATA / "nectarines/fruits/N01/grasps/grasp-1.h5")
    for true, pad in zip(simulated.pads, shipped.pads, strict=True):
        assert isinstance(pad, GelPad)
        assert true.force_N[-1, :, 2].sum() == pytest.approx(pad.force_N[15, :, 2].sum(), rel=0.02)
        miss_mm = true.displacement_mm[-1] - pad.displacement_mm[15]
        assert np.sqrt((miss_mm**2).mean()) < 0.006  # the sensor's noise is 0.0045
