"""Faulty machines: each fault does to a recording what its definition says and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from mismatch_ball import drawn_ball, grasp_along_x, motion

from samples.gel_contact import Gel
from samples.mismatch.machine_effects import (
    recorded_late,
    with_bent_reading,
    with_drift,
    with_gain,
    with_gel_creep,
    with_gripper_compliance,
    with_hysteresis,
    with_instants,
    with_pose_error,
    with_thermal_drift,
)
from samples.mismatch.marker_sensor import DEFAULT_SENSOR
from samples.mismatch.true_recording import PadTruth, TrueRecording


@pytest.fixture
def truth() -> TrueRecording:
    """Two pads that close along x, forces rising with time."""
    time_s = np.linspace(0.0, 2.0, 9)
    rest = DEFAULT_SENSOR.rest_mm
    shape = np.exp(-(rest[:, 0] ** 2 + rest[:, 1] ** 2) / 20)
    pads = []
    for side in (1.0, -1.0):
        pose = np.broadcast_to(np.eye(4), (9, 4, 4)).copy()
        pose[:, :3, :3] = np.stack([[0, 1, 0], [0, 0, side], [side, 0, 0]], axis=1)
        pose[:, 0, 3] = side * (-30 + time_s)
        shift = np.zeros((9, 400, 3))
        shift[..., 2] = -time_s[:, None] * shape
        pads.append(
            PadTruth(pose=pose, displacement_mm=shift, force_N=-np.array([0.055, 0.055, 0.22]) * shift)
        )
    return TrueRecording(
        name="grasp-1", time_s=time_s, aperture_mm=60 - 2 * time_s, rest_mm=rest, gel=Gel(),
        pads=(pads[0], pads[1]),
    )  # fmt: skip


def taken(truth: TrueRecording, frames: np.ndarray, **changes: np.ndarray) -> TrueRecording:
    """The recording with these frames of its pads, in this order."""
    left, right = (
        PadTruth(pose=p.pose[frames], displacement_mm=p.displacement_mm[frames], force_N=p.force_N[frames])
        for p in truth.pads
    )
    return replace(truth, pads=(left, right), **changes)


def total_N(pad: PadTruth) -> np.ndarray:
    return np.asarray(pad.force_N.sum(axis=1)[:, 2])


def test_gain_scales_one_pads_force_exactly(truth: TrueRecording) -> None:
    recording = with_gain(truth, pad="right", gain=1.2)
    assert recording.pads[1].force_N == pytest.approx(1.2 * truth.pads[1].force_N)
    assert recording.pads[0] is truth.pads[0]
    assert np.array_equal(recording.pads[1].displacement_mm, truth.pads[1].displacement_mm)


def test_drift_adds_newtons_per_second_to_one_pad(truth: TrueRecording) -> None:
    recording = with_drift(truth, pad="left", newton_per_s=0.3)
    assert total_N(recording.pads[0]) - total_N(truth.pads[0]) == pytest.approx(0.3 * truth.time_s)
    assert recording.pads[1] is truth.pads[1]


def test_a_gripper_that_gives_records_more_travel_than_there_was(truth: TrueRecording) -> None:
    recording = with_gripper_compliance(truth, mm_per_N=0.01)
    excess = 0.01 * total_N(truth.pads[0])
    assert truth.aperture_mm - recording.aperture_mm == pytest.approx(2 * excess)
    for before, after in zip(truth.pads, recording.pads, strict=True):
        moved = after.pose[:, :3, 3] - before.pose[:, :3, 3]
        assert moved == pytest.approx(excess[:, None] * before.pose[:, :3, 2])
    apart = np.linalg.norm(recording.pads[1].pose[:, :3, 3] - recording.pads[0].pose[:, :3, 3], axis=1)
    assert apart == pytest.approx(recording.aperture_mm)


def test_a_wrong_pose_is_the_true_one_times_shift_and_tilt(truth: TrueRecording) -> None:
    recording = with_pose_error(truth, pad="left", shift_mm=(1.0, -2.0), tilt_deg=3.0)
    error = np.linalg.inv(truth.pads[0].pose) @ recording.pads[0].pose
    assert error[:, :3, 3] == pytest.approx(np.broadcast_to([1.0, -2.0, 0.0], (9, 3)))
    assert error[:, :3, 0] == pytest.approx(np.broadcast_to([1.0, 0.0, 0.0], (9, 3)))
    assert np.degrees(np.arctan2(error[:, 2, 1], error[:, 1, 1])) == pytest.approx(3.0)
    assert recording.pads[1] is truth.pads[1]


def test_a_late_clock_shows_what_was_with_the_pose_that_is(truth: TrueRecording) -> None:
    recording = recorded_late(truth, truth.time_s, lag_s=0.5)
    assert np.array_equal(recording.pads[0].force_N[2:], truth.pads[0].force_N[:-2])
    assert np.array_equal(recording.pads[0].force_N[0], truth.pads[0].force_N[0])
    assert np.array_equal(recording.pads[0].pose, truth.pads[0].pose)
    assert np.array_equal(recording.time_s, truth.time_s)
    assert np.array_equal(recording.aperture_mm, truth.aperture_mm)
    some = recorded_late(truth, truth.time_s[[2, 4]] + 0.01, lag_s=0.0)
    assert np.array_equal(some.pads[1].force_N, truth.pads[1].force_N[[2, 4]])
    assert np.array_equal(some.time_s, truth.time_s[[2, 4]])


def test_more_instants_lie_on_the_same_way() -> None:
    grasp = grasp_along_x(drawn_ball(), motion([-0.1, 0.4, 0.4, -0.1]))
    more = with_instants(grasp, np.array([0.05, 0.17])).motion
    assert np.interp(more.time_s, grasp.motion.time_s, grasp.motion.travel_mm) == pytest.approx(
        more.travel_mm
    )
    assert {0.05, 0.17} <= set(more.time_s.tolist())
    assert more.recorded.all()


def test_hysteresis_spares_the_load_and_the_peak(truth: TrueRecording) -> None:
    back = taken(truth, np.r_[0:9, 8:-1:-1])
    force_N, was = total_N(with_hysteresis(back, share=0.1).pads[0]), total_N(back.pads[0])
    assert force_N[:9] == pytest.approx(was[:9])
    assert np.all(force_N[10:17] < was[10:17])
    assert force_N[13] == pytest.approx(0.9 * was[13], rel=0.02)


def test_thermal_drift_goes_with_the_root_of_time_on_both_pads(truth: TrueRecording) -> None:
    recording = with_thermal_drift(truth, strain_per_root_s=0.002, N_per_root_s=0.3)
    reach = np.abs(truth.rest_mm[:, 0]).max()
    for before, after in zip(truth.pads, recording.pads, strict=True):
        added = total_N(after) - total_N(before)
        assert added == pytest.approx(0.3 * np.sqrt(truth.time_s))
        moved = (after.displacement_mm - before.displacement_mm)[-1]
        assert np.abs(moved).max() == pytest.approx(0.002 * reach * np.sqrt(2.0))


def test_a_bent_reading_is_off_by_its_share_at_the_largest_force_and_by_half_at_half(
    truth: TrueRecording,
) -> None:
    bent = with_bent_reading(truth, a=-0.3)
    size, read = (np.linalg.norm(recording.pads[0].force_N, axis=2) for recording in (truth, bent))
    assert read.max() == pytest.approx(0.7 * size.max())
    assert (read[4] / size[4])[size[4] == size[4].max()] == pytest.approx(0.85)


def test_a_gel_face_creeps_on_under_a_steady_load(truth: TrueRecording) -> None:
    held = np.r_[0:9, [8] * 40]
    still = taken(truth, held, time_s=np.arange(len(held)) * 0.25, aperture_mm=truth.aperture_mm[held])
    crept = with_gel_creep(still, creep=0.2, creep_tau_s=1.0)
    more = crept.pads[0].displacement_mm[:, 0, 2] / still.pads[0].displacement_mm[-1, 0, 2]
    assert more[8] < 1.15
    assert more[-1] == pytest.approx(1.2, abs=1e-3)
    assert np.array_equal(crept.pads[0].force_N, still.pads[0].force_N)
