"""What a logger did is put right, and what a specimen did stays; long traces are thinned."""

import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from injected_grasp import gel_pad, held_by

from tactile.preparation.logged_trace import LoggedTrace, NotPrepared, prepare, written_runs
from tactile.readers.grasp_log import read_log
from tactile.readers.recording import Recording, read_recording, write_recording
from tactile.tactile_failure import TactileFailure
from tactile.trace_thinning import BOUND, MOST_FRAMES, thin

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))
from drawn_sound import SOUND
from drawn_traces import FAULTS
from trace_faults import outcome, read

FRAMES = 150
TIME = np.arange(FRAMES) / 30
JAWS = 60 - np.interp(TIME, [0, 0.5, 2.5, 3.0, 4.9], [0, 0, 4, 4, 0])


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
    with pytest.raises(NotPrepared) as caught:
        prepare(lost(40))
    assert "40 of 600 rows (6.7%) wild or missing" in caught.value.fault


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
    with pytest.raises(NotPrepared, match="zeroed under load, or the specimen broke") as caught:
        prepare(logged(travel, force))
    assert f"at row {row + 2}, and no frames in air" in caught.value.fault


def recording() -> Recording:
    rng = np.random.default_rng(0)
    depth = np.maximum(59 - JAWS, 0)[:, None, None]
    rest = np.stack([*np.meshgrid(np.arange(4.0), np.arange(4.0)), np.zeros((4, 4))], axis=-1).reshape(-1, 3)
    normal = np.array([0, 0, 1.0])

    def pad(name):
        noise = 1e-3 * rng.standard_normal((2, FRAMES, 16, 3))
        moved, force = -0.1 * depth * normal + noise[0], 0.1 * depth**1.5 * normal + noise[1]
        return gel_pad(name, rest, moved, force, kn=0.05, kt=0.02)

    return held_by((pad("left"), pad("right")), TIME, JAWS)


def changed(path: Path, change) -> Path:
    write_recording(path, recording())
    fields = ["time_s", "aperture_mm"]
    fields += [
        f"pads/{pad}/{name}" for pad in ("left", "right") for name in ("pose", "displacement_mm", "force_N")
    ]
    with h5py.File(path, "a") as file:
        for name in fields:
            values = change(name, np.array(file[name]))
            del file[name]
            file[name] = values
    return path


@pytest.mark.parametrize("fill", [0.0, -999.0, np.nan])
@pytest.mark.parametrize(("start", "end"), [(30, 0), (0, 20), (3, 40)])
def test_frames_that_were_never_written_are_left_out_of_every_field(tmp_path, fill, start, end):
    def reserve(_, values):
        blocks = [np.full((count, *values.shape[1:]), fill) for count in (start, end)]
        return np.concatenate([blocks[0], values, blocks[1]])

    read_back = read_recording(changed(tmp_path / "a.h5", reserve))
    np.testing.assert_allclose(read_back.time_s, TIME)
    np.testing.assert_allclose(read_back.aperture_mm, JAWS)
    assert len(read_back.pads[1].force_N) == FRAMES
    assert [len(correction.rows) for correction in read_back.corrections] == [n for n in (start, end) if n]


def of_aperture(change):
    return lambda name, values: change(values) if name == "aperture_mm" else values


def poked(**values):
    def change(aperture):
        for place, value in values.items():
            aperture[int(place[1:])] = value
        return aperture

    return of_aperture(change)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (of_aperture(lambda v: v[np.arange(FRAMES) // 3 * 3]), "was read 10 times a second and repeated"),
        (of_aperture(lambda v: v[np.arange(FRAMES) // 5 * 5]), "was read 6 times a second and repeated"),
        (of_aperture(lambda v: v[np.arange(FRAMES) // 6 * 6]), "was read 5 times a second and repeated"),
        (
            poked(_50=999.0),
            "drupe replaced 1 wild value of aperture_mm by interpolation between neighbours: frame 50",
        ),
        (poked(_40=0.0, _41=-3.0), "drupe replaced 2 wild values of aperture_mm"),
        (poked(_30=np.nan, _90=np.nan), "drupe replaced 2 missing values of aperture_mm"),
    ],
)
def test_apertures_that_the_logger_spoilt_lie_on_lines_between_readings(tmp_path, change, says):
    read_back = read_recording(changed(tmp_path / "a.h5", change))
    assert [says in correction.says for correction in read_back.corrections] == [True]
    np.testing.assert_allclose(read_back.aperture_mm[:145], JAWS[:145], atol=0.12)


@pytest.mark.parametrize("step", [0.05, 0.2, 0.5])
def test_an_aperture_of_few_digits_is_no_slow_reading(tmp_path, step):
    read_back = read_recording(changed(tmp_path / "a.h5", of_aperture(lambda v: np.round(v / step) * step)))
    assert read_back.corrections == ()


@pytest.mark.parametrize("count", [2, 3, 5])
def test_recordings_one_behind_the_other_are_counted(tmp_path, count):
    path = changed(tmp_path / "a.h5", lambda _, values: np.concatenate([values] * count))
    with pytest.raises(
        TactileFailure, match=rf"a\.h5: time_s: found {count} recordings one behind the other"
    ):
        read_recording(path)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ({10: "0.3333,-999"}, "1 wild value of aperture_mm"),
        ({10: "0.3333,", 60: "2.0,nan"}, "2 missing values of aperture_mm"),
        ({10: "77.0,60"}, "1 wild value of time"),
        (dict.fromkeys((148, 149), "0,0"), "2 rows at the end, from row 150 on, never written"),
    ],
)
def test_a_grasps_log_goes_through_the_same_step(tmp_path, rows, says):
    lines = [f"{t:.6f},{a:.6f}" for t, a in zip(TIME, JAWS, strict=True)]
    for row, line in rows.items():
        lines[row] = line
    (tmp_path / "log.csv").write_text("\n".join(["time_s,aperture_mm", *lines]) + "\n")
    log = read_log(tmp_path / "log.csv")
    assert [says in note for note in log.notes] == [True]
    np.testing.assert_allclose(log.aperture_mm, np.interp(log.time_s, TIME, JAWS), atol=0.05)


def test_a_log_of_two_grasps_gets_no_advice_to_sort_its_rows(tmp_path):
    lines = [f"{t:.6f},{a:.6f}" for t, a in zip(TIME, JAWS, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["time_s,aperture_mm", *lines, *lines]) + "\n")
    with pytest.raises(TactileFailure, match="2 recordings one behind the other") as caught:
        read_log(tmp_path / "log.csv")
    assert "sort" not in caught.value.detail


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
