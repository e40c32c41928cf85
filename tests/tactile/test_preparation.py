"""What a logger did is put right, and what a specimen did stays; known faults are corrected."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_sound import SOUND
from drawn_traces import FAULTS
from injected_grasp import injected_grasp, with_pads
from series_springs import bare_press
from trace_faults import outcome, read

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
from tactile.preparation.logged_trace import LoggedTrace, prepare, written_runs
from tactile.tactile_failure import TactileFailure
from tactile.trace_thinning import BOUND, MOST_FRAMES, thin


def logged(travel, force):
    rows = np.arange(len(travel))
    return LoggedTrace(time_s=rows / 50, travel=travel, force_N=force, rows=rows + 2)


@pytest.mark.parametrize("seed", [0, 2, 4])
@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_is_named_and_the_stiffness_is_that_of_the_sound_press(tmp_path, kind, seed):
    assert outcome(kind, seed, tmp_path) == ""


@pytest.mark.parametrize("seed", [0, 2, 4])
@pytest.mark.parametrize("kind", SOUND)
def test_what_the_specimen_did_keeps_every_row(tmp_path, kind, seed):
    press = SOUND[kind](np.random.default_rng([seed, *kind.encode()]))
    press = replace(
        press, **{name: getattr(press, name)[:1200] for name in ("time_s", "travel_mm", "force_N")}
    )
    columns, notes = read(press, tmp_path)
    assert len(notes) == 1
    for column, written in zip(columns, (press.time_s, press.travel_mm, press.force_N), strict=True):
        np.testing.assert_allclose(column, written, atol=1e-5)


@pytest.mark.parametrize("fill", [0.0, -999.0, 1e4])
def test_rows_lost_inside_a_record_are_left_out_or_are_too_many(fill):
    travel = np.interp(np.arange(600), [0, 300, 599], [1, 3, 1.0])
    force = (
        5 * np.maximum(travel - 1.5, 0) ** 1.5 + 0.3 + 0.01 * np.random.default_rng(0).standard_normal(600)
    )

    def lost(count):
        columns = [signal.copy() for signal in (travel, force)]
        for column in columns:
            column[200 : 200 + count] = fill
        return logged(*columns)

    _, (correction,) = prepare(lost(6))
    assert correction.rows == tuple(range(202, 208))
    with pytest.raises(TactileFailure, match=r"40 of 600 rows \(6\.7%\) wild or missing"):
        prepare(lost(40))


def test_each_block_of_rows_that_were_never_written_has_its_own_note():
    travel = np.interp(np.arange(300), [0, 150, 299], [10, 13, 10.0])
    force = 5 * np.maximum(travel - 11, 0) ** 1.5 + 0.3 + 0.01 * np.random.default_rng(0).standard_normal(300)
    blocks = np.repeat([-999.0, 0.0], 20)
    _, notes = written_runs(logged(np.r_[blocks, travel], np.r_[blocks, force]))
    assert [(note.rows[0], len(note.rows), note.values) for note in notes] == [
        (2, 20, (-999.0, -999.0)),
        (22, 20, (0.0, 0.0)),
    ]


@pytest.mark.parametrize("row", [120, 200, 250])
def test_a_step_to_zero_without_air_behind_it_is_refused_with_both_causes(row):
    travel = np.linspace(0, 3, 300)
    force = 6 * np.maximum(travel - 0.5, 0)
    force[row:] -= force[row]
    force += 0.01 * np.random.default_rng(0).standard_normal(300)
    words = f"at row {row + 2}, and no frames in air .*zeroed under load, or the specimen broke"
    with pytest.raises(TactileFailure, match=words):
        prepare(logged(travel, force))


def drawn(time_s, *, ramp_s, start_s, noise_N, rng, fall_s=None):
    """A press of 3 mm in `ramp_s`, held: Hertz's d^1.5, relaxing by half (20 s); force lost at `fall_s`."""
    travel = 3 * np.clip((time_s - start_s) / ramp_s, 0, 1)
    force = travel**1.5 * (0.5 + 0.5 * np.exp(-np.maximum(time_s - start_s - ramp_s, 0) / 20))
    if fall_s is not None:
        force = np.where(time_s > fall_s, 0.4 * force, force)
    return travel, force, force + noise_N * rng.standard_normal(len(time_s))


@pytest.mark.parametrize(("ramp_s", "frames"), [(0.3, 40_000), (60.0, 24_000), (300.0, 100_000)])
def test_a_thinned_trace_keeps_its_ramp_and_its_hold_within_the_bound_that_it_states(ramp_s, frames):
    rng = np.random.default_rng(1)
    time = np.linspace(0, 400, frames)
    travel, true, force = drawn(time, ramp_s=ramp_s, start_s=20.0, noise_N=0.01, rng=rng)
    thinned = thin(time, travel, force)
    kept = thinned.kept
    assert thinned.noise_N == pytest.approx(0.01, rel=0.05)
    assert 250 < len(kept) <= 1000
    assert thinned.off < 1.6 * BOUND
    assert kept[0] == 0
    assert kept[-1] == frames - 1
    off = np.abs(np.interp(time, time[kept], force[kept]) - true)
    assert np.sqrt(np.mean(off**2)) < 1.1 * 0.01
    ramp = (time[kept] > 20) & (time[kept] < 20 + ramp_s)
    assert ramp.sum() > min(60, 0.5 * ramp_s * frames / 400)
    assert (time[kept] < 20).sum() > 8
    assert (time[kept] > 350).sum() > 8
    assert "drupe thinned" in thinned.said("t.csv")


@pytest.mark.parametrize(("step_N", "noise_N"), [(0.01, 0.0), (0.1, 0.01)])
def test_a_force_that_is_rounded_has_the_noise_of_its_steps(step_N, noise_N):
    rng = np.random.default_rng(4)
    time = np.linspace(0, 400, 40_000)
    travel, _, force = drawn(time, ramp_s=60.0, start_s=20.0, noise_N=noise_N, rng=rng)
    thinned = thin(time, travel, np.round(force / step_N) * step_N)
    assert thinned.noise_N == pytest.approx(step_N / 12**0.5, rel=0.3)
    assert thinned.off < 3 * BOUND


def test_a_sudden_fall_is_kept_to_the_frame():
    rng = np.random.default_rng(2)
    time = np.linspace(0, 100, 30_000)
    travel, _, force = drawn(time, ramp_s=90.0, start_s=2.0, noise_N=0.01, rng=rng, fall_s=71.3)
    kept = thin(time, travel, force).kept
    before, after = kept[time[kept] <= 71.3][-1], kept[time[kept] > 71.3][0]
    assert time[after] - time[before] < 0.05
    assert force[after] < 0.5 * force[before]


def test_frames_that_are_kept_are_no_choice_of_their_noise():
    rng = np.random.default_rng(3)
    time = np.linspace(0, 400, 40_000)
    travel, true, force = drawn(time, ramp_s=60.0, start_s=20.0, noise_N=0.01, rng=rng)
    kept = thin(time, travel, force).kept
    noise = (force - true)[kept]
    assert noise.std() == pytest.approx(0.01, rel=0.12)
    assert abs(noise.mean()) < 4 * 0.01 / np.sqrt(len(kept))


def test_a_trace_of_a_usual_length_is_left_as_it_is():
    time = np.linspace(0, 10, MOST_FRAMES)
    assert thin(time, time, time**1.5) is None


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
    grown = np.zeros((len(true.time_s), 1, 3))
    grown[:, 0, 2] = 0.05 * (true.time_s - true.time_s[0]) / true.pads[1].force_N.shape[1]
    recorded = with_pads(true, lambda pad: replace(pad, force_N=pad.force_N + grown), "right")
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

    restored = corrected(with_pads(true, late), [LagFault(lag_s=frames * 0.1)])
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
