"""A recording with a known fault of a pad, the jaws or the gels, corrected, is the recording without it."""

from dataclasses import replace

import numpy as np
import pytest
from injected_grasp import injected_grasp, with_pads
from series_springs import bare_press

from tactile.correction import (
    ComplianceFault,
    DriftFault,
    ForceLawFault,
    GainFault,
    GelCreepFault,
    GelHysteresisFault,
    LagFault,
    PoseFault,
    ThermalFault,
    corrected,
    misplacement,
)


@pytest.fixture(scope="module")
def true():
    return injected_grasp(np.random.default_rng(3)).recording


def same(recording, expected, atol=1e-9):
    assert recording.aperture_mm == pytest.approx(expected.aperture_mm, abs=atol)
    for pad, other in zip(recording.pads, expected.pads, strict=True):
        for name in ("pose", "force_N", "displacement_mm"):
            np.testing.assert_allclose(getattr(pad, name), getattr(other, name), atol=atol, err_msg=name)


def test_a_gain_is_taken_out_of_its_own_pad_alone(true):
    recorded = with_pads(true, lambda pad: replace(pad, force_N=1.14 * pad.force_N), "left")
    same(corrected(recorded, [GainFault(pad="left", gain=1.14)]), true)


def test_a_drift_is_taken_out_of_the_total_and_leaves_shear_alone(true):
    def drifting(pad):
        force = pad.force_N.copy()
        force[:, :, 2] += 0.05 * (true.time_s - true.time_s[0])[:, None] / force.shape[1]
        return replace(pad, force_N=force)

    recorded = with_pads(true, drifting, "right")
    total = [r.pads[1].force_N[:, :, 2].sum(axis=1) for r in (recorded, true)]
    assert np.polyfit(true.time_s, total[0] - total[1], 1)[0] == pytest.approx(0.05)
    same(corrected(recorded, [DriftFault(pad="right", newton_per_s=0.05)]), true)


def test_a_jaw_that_gives_way_is_put_back_by_its_own_force(true):
    force = [pad.force_N[:, :, 2].sum(axis=1) for pad in true.pads]
    pads = []
    for pad, push in zip(true.pads, force, strict=True):
        pose = pad.pose.copy()
        pose[:, :3, 3] += 0.02 * push[:, None] * pose[:, :3, 2]
        pads.append(replace(pad, pose=pose))
    recorded = replace(true, pads=tuple(pads), aperture_mm=true.aperture_mm - 0.02 * sum(force))
    restored = corrected(recorded, [ComplianceFault(mm_per_N=0.02)])
    same(restored, true)
    gap = np.linalg.norm(restored.pads[0].pose[:, :3, 3] - restored.pads[1].pose[:, :3, 3], axis=1)
    assert gap == pytest.approx(restored.aperture_mm, abs=1e-9)


@pytest.mark.parametrize("frames", [3, -2])
def test_a_lag_of_whole_frames_is_undone_exactly_up_to_the_origin_of_time(true, frames):
    def late(pad):
        return replace(
            pad,
            displacement_mm=np.roll(pad.displacement_mm, frames, axis=0),
            force_N=np.roll(pad.force_N, frames, axis=0),
        )

    recorded = with_pads(true, late)
    restored = corrected(recorded, [LagFault(lag_s=frames * 0.1)])
    now, then = slice(8, -8), slice(8 - frames, len(true.time_s) - 8 - frames)
    assert restored.aperture_mm[now] == pytest.approx(true.aperture_mm[then], abs=1e-9)
    for restored_pad, other in zip(restored.pads, true.pads, strict=True):
        np.testing.assert_allclose(restored_pad.pose[now], other.pose[then], atol=1e-9)
        np.testing.assert_array_equal(restored_pad.force_N[now], other.force_N[then])


def test_a_misplaced_pad_is_put_back(true):
    fault = PoseFault(pad="left", shift_mm=(1.5, -0.7), tilt_deg=4.0)
    moved = misplacement(fault)
    assert moved[:3, 3] == pytest.approx([1.5, -0.7, 0.0])
    assert moved[:3, 0] == pytest.approx([1.0, 0.0, 0.0])
    recorded = with_pads(true, lambda pad: replace(pad, pose=pad.pose @ moved), "left")
    same(corrected(recorded, [fault]), true)


@pytest.mark.parametrize("a", [-0.4, -0.2, 0.3])
def test_a_reading_that_bends_is_straightened(true, a):
    largest = max(np.linalg.norm(pad.force_N, axis=2).max() for pad in true.pads)

    def bent(pad):
        size = np.linalg.norm(pad.force_N, axis=2, keepdims=True)
        return replace(pad, force_N=pad.force_N * (1 + a * size / largest))

    recorded = with_pads(true, bent)
    assert np.abs(recorded.pads[0].force_N - true.pads[0].force_N).max() > 0.1 * largest
    same(corrected(recorded, [ForceLawFault(a=a)]), true)


def test_a_face_that_has_crept_is_put_back(true):
    def crept(pad):
        memory = np.zeros_like(pad.displacement_mm)
        for k in range(1, len(true.time_s)):
            q = np.exp(-(true.time_s[k] - true.time_s[k - 1]) / 1.3)
            memory[k] = q * memory[k - 1] + (1 - q) * pad.displacement_mm[k]
        return replace(pad, displacement_mm=pad.displacement_mm + 0.2 * memory)

    same(corrected(with_pads(true, crept), [GelCreepFault(creep=0.2, tau_s=1.3)]), true)


def test_a_loop_is_closed(true):
    def looped(pad):
        total = np.maximum(pad.force_N[:, :, 2].sum(axis=1), 0.0)
        r = total / np.maximum.accumulate(np.maximum(total, 0.02 * total.max()))
        return replace(pad, force_N=pad.force_N * (1 - 0.4 * r * (1 - r))[:, None, None])

    recorded = with_pads(true, looped)
    assert np.abs(recorded.pads[0].force_N - true.pads[0].force_N).max() > 0
    same(corrected(recorded, [GelHysteresisFault(share=0.1)]), true, atol=1e-6)


def test_a_warming_gel_is_cooled(true):
    total = true.pads[0].force_N[:, :, 2].sum(axis=1)
    root = np.sqrt(true.time_s - true.time_s[0])
    fault = ThermalFault(strain_per_root_s=1e-3, N_per_root_s=1e-3 * float(total.max()))

    def warmed(pad):
        force, moved = pad.force_N.copy(), pad.displacement_mm.copy()
        force[:, :, 2] += fault.N_per_root_s / len(pad.rest_mm) * root[:, None]
        moved[:, :, :2] += fault.strain_per_root_s * root[:, None, None] * pad.rest_mm[:, :2]
        return replace(pad, force_N=force, displacement_mm=moved)

    restored = corrected(with_pads(true, warmed), [fault])
    for restored_pad, other in zip(restored.pads, true.pads, strict=True):
        # what had come by the frames in the air is the sensor's offset, which contact takes out
        for name in ("force_N", "displacement_mm"):
            left = getattr(restored_pad, name) - getattr(other, name)
            np.testing.assert_allclose(left, np.broadcast_to(left[0], left.shape), atol=1e-9)


def test_order_of_faults_does_not_matter_and_none_changes_nothing(true):
    faults = [
        ComplianceFault(mm_per_N=0.01),
        LagFault(lag_s=0.05),
        DriftFault(pad="left", newton_per_s=0.01),
        PoseFault(pad="right", shift_mm=(1.0, 0.0), tilt_deg=1.0),
        GainFault(pad="left", gain=0.9),
        ForceLawFault(a=-0.2),
        GelCreepFault(creep=0.1, tau_s=2.0),
        GelHysteresisFault(share=0.05),
        ThermalFault(strain_per_root_s=1e-4, N_per_root_s=0.01),
    ]
    same(corrected(true, faults), corrected(true, faults[::-1]), atol=0.0)
    assert corrected(true, []) is true
    same(corrected(true, [GainFault(pad="tip", gain=2.0)]), true, atol=0.0)


def test_a_bare_indenter_is_corrected_too():
    time_s = np.arange(5.0)
    felt_N, travel_mm = 1.2 * (2.0 * time_s) + 0.1 * time_s, time_s + 0.5 * 2.0 * time_s
    recorded = replace(bare_press(time_s, felt_N, travel_mm), wrench_N=np.ones((5, 6)))
    faults = [
        GainFault(pad="tip", gain=1.2),
        DriftFault(pad="tip", newton_per_s=0.1),
        ComplianceFault(mm_per_N=0.5),
        LagFault(lag_s=0.0),
    ]
    restored = corrected(recorded, faults)
    assert restored.pads[0].force_z_N == pytest.approx(2.0 * time_s)
    assert restored.aperture_mm == pytest.approx(time_s)
    assert restored.wrench_N == pytest.approx(recorded.wrench_N)
