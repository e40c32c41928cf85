"""What a logger did is put right, and what a specimen did stays; long traces are thinned."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_sound import SOUND
from drawn_traces import FAULTS
from trace_faults import outcome, read

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
    with pytest.raises(TactileFailure) as caught:
        prepare(lost(40))
    assert "40 of 600 rows (6.7%) wild or missing" in caught.value.detail


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
    with pytest.raises(TactileFailure, match="zeroed under load, or the specimen broke") as caught:
        prepare(logged(travel, force))
    assert f"at row {row + 2}, and no frames in air" in caught.value.detail


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
