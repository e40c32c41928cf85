"""The bank: fruit stored without noise, cases drawn from them, and their files."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from disturbed_bodies import disturbed
from mismatch_ball import drawn_ball, still_recording

import samples.mismatch.bank as bank
from recon.surface.mesh_file import read_mesh
from samples.gel_contact import Gel
from samples.grasp_plan import four_manners, motion_of
from samples.mismatch.bank import (
    DRAWN,
    MESHES,
    SIMULATED,
    BankFruit,
    draw_case,
    store_truths,
    stored_truths,
    write_case_files,
)
from samples.mismatch.case_simulation import CasePlan, planned
from samples.mismatch.injected import AMPLITUDES, EFFECTS, OUT_OF_CATALOGUE, drawn_parameters
from samples.mismatch.true_recording import PadTruth, TrueRecording
from samples.sample_failure import SampleFailure
from tactile.readers.recording import GelPad, read_recording

FRAMES = 40
LOADED = still_recording(FRAMES, late_N=0.01)


def answer_of(cases: Path, case_id: str) -> dict:
    return json.loads((cases / "answers.json").read_text())[case_id]


def mean_force_N(cases: Path, case_id: str, side: int) -> float:
    pad = read_recording(cases / case_id / "grasp-1.h5").pads[side]
    assert isinstance(pad, GelPad)
    return float(
        (pad.force_N[FRAMES // 2 :].mean(axis=0) - pad.force_N[: FRAMES // 2].mean(axis=0)).mean(0)[2]
    )


def test_every_effect_is_simulated_or_drawn() -> None:
    assert sorted((*SIMULATED, *DRAWN)) == sorted((*EFFECTS, *OUT_OF_CATALOGUE))
    assert OUT_OF_CATALOGUE == ("palm", "gel_softening")


def test_fruit_that_are_stored_keep_their_names_and_seeds() -> None:
    sound, firm = BankFruit(number=3), BankFruit(number=1, effects=("skin",))
    assert (sound.name, sound.seed) == ("null-003", (2028, 0, 3))
    assert (firm.name, firm.seed) == ("skin-3-1", (2028, 1, 437, 3, 1))
    assert sound.plan().drawn.fruit.E_MPa == pytest.approx(0.665084, abs=1e-6)


def test_amplitudes_and_physics_outside_are_planned() -> None:
    wide = BankFruit(number=0, effects=("skin",)).plan().injected[0].number("Et_N_per_mm")
    low, high = AMPLITUDES["skin"]
    assert low <= wide <= high
    both = BankFruit(number=0, effects=("skin", "slip")).plan()
    assert [effect.effect for effect in both.injected] == ["skin", "slip"]
    (palm,) = BankFruit(number=0, effects=("palm",)).plan().injected
    assert 15.0 <= palm.number("N_per_mm") <= 30.0


def test_a_fruit_is_simulated_mesh_by_mesh_and_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def simulated(plan: CasePlan, **_: object) -> tuple[TrueRecording, ...]:
        asked.extend(grasp.name for grasp in plan.grasps)
        return tuple(still_recording(FRAMES, name=grasp.name) for grasp in plan.grasps)

    monkeypatch.setattr(bank, "true_recordings", simulated)
    fruit = BankFruit(number=0)
    for mesh in MESHES:
        with pytest.raises(SampleFailure, match="not every mesh of null-000 is simulated"):
            bank.simulated(tmp_path, fruit)
        bank.simulate(tmp_path, fruit, mesh)
        bank.simulate(tmp_path, fruit, mesh)
    assert asked == ["grasp-1", "grasp-4", "grasp-3", "grasp-2"]
    names = [truth.name for truth in bank.simulated(tmp_path, fruit)]
    assert names == ["grasp-1", "grasp-2", "grasp-3", "grasp-4"]


def test_a_draw_is_repeated_exactly_and_another_record_is_another(tmp_path: Path) -> None:
    fruit, truths = BankFruit(number=0), (LOADED,)
    case_id, repeated = (
        draw_case(tmp_path / name, fruit, truths, added=("sensor_gain",), record=1) for name in "ab"
    )
    again = draw_case(tmp_path / "a", fruit, truths, added=("sensor_gain",), record=2)
    assert (case_id, repeated, again) == ("sensor_gain-3-0-1", "sensor_gain-3-0-1", "sensor_gain-3-0-2")
    assert answer_of(tmp_path / "a", case_id) == answer_of(tmp_path / "b", case_id)
    first, second, third = (
        read_mesh(tmp_path / where / "fruit.ply")[0]
        for where in (f"a/{case_id}", f"b/{case_id}", f"a/{again}")
    )
    np.testing.assert_array_equal(first, second)
    assert np.abs(first - third).max() > 0.01
    assert mean_force_N(tmp_path / "a", case_id, 0) == mean_force_N(tmp_path / "b", case_id, 0)


def test_the_label_of_a_case_says_what_was_added(tmp_path: Path) -> None:
    case_id = draw_case(tmp_path, BankFruit(number=0), (LOADED,), added=("sensor_gain",), record=1)
    entry = answer_of(tmp_path, case_id)
    assert entry["effect"] == "sensor_gain"
    assert entry["drawn_from"] == {
        "fruit": "null-000", "fruit_seed": [2028, 0, 0], "added": ["sensor_gain"], "seed": 2028,
    }  # fmt: skip
    side = ("left", "right").index(entry["parameters"]["pad"])
    true = 0.01 * entry["parameters"]["gain"]
    assert mean_force_N(tmp_path, case_id, side) == pytest.approx(true, rel=3e-3)
    assert mean_force_N(tmp_path, case_id, 1 - side) == pytest.approx(0.01, rel=3e-3)


def test_the_answer_to_physics_outside_the_catalogue_is_unknown(tmp_path: Path) -> None:
    case_id = draw_case(tmp_path, BankFruit(number=0, effects=("palm",)), (LOADED,), record=1)
    entry = answer_of(tmp_path, case_id)
    assert entry["effect"] == "unknown"
    assert entry["parameters"]["physics"] == "palm"


def test_a_pit_is_off_what_its_case_states_as_its_label_says(tmp_path: Path) -> None:
    fruit, truths = BankFruit(number=0), (LOADED,)
    pit = fruit.plan().drawn.fruit.pit
    moved = answer_of(tmp_path, draw_case(tmp_path, fruit, truths, added=("pit_offset",), record=1))
    assert moved["pit_centre_mm"] == pytest.approx(moved["parameters"]["offset_mm"])
    assert moved["pit_semi_axes_mm"] == pytest.approx(pit.semi_axes_mm)
    case_id = draw_case(tmp_path, fruit, truths, added=("pit_size",), record=1)
    stated = np.abs(read_mesh(tmp_path / case_id / "pit.ply")[0]).max(axis=0)
    ratio = np.array(pit.semi_axes_mm) / stated
    assert ratio == pytest.approx(np.full(3, answer_of(tmp_path, case_id)["parameters"]["scale"]), rel=3e-3)


def test_the_stated_poisson_ratio_is_drawn_and_the_label_is_the_true_one(tmp_path: Path) -> None:
    case_id = draw_case(tmp_path, BankFruit(number=0), (LOADED,), added=("poisson_ratio",), record=1)
    entry = answer_of(tmp_path, case_id)
    assert entry["parameters"] == {"nu": 0.45}
    assert entry["nu"] == 0.45
    stated = tomllib.loads((tmp_path / case_id / "case.toml").read_text())["poisson_ratio"]
    assert 0.28 <= stated <= 0.488
    assert stated != 0.45


def truth(seed: int) -> TrueRecording:
    rng = np.random.default_rng(seed)
    left, right = (
        PadTruth(
            pose=rng.normal(size=(5, 4, 4)), displacement_mm=rng.normal(size=(5, 9, 3)),
            force_N=rng.normal(size=(5, 9, 3)),
        )
        for _ in range(2)
    )  # fmt: skip
    return TrueRecording(
        name=f"grasp-{seed}", time_s=np.arange(5.0), aperture_mm=rng.normal(size=5),
        rest_mm=rng.normal(size=(9, 3)), gel=Gel(friction=1.6), pads=(left, right),
    )  # fmt: skip


def test_a_stored_fruit_comes_back_as_it_was(tmp_path: Path) -> None:
    truths = (truth(1), truth(2))
    store_truths(tmp_path / "fruit.npz", truths)
    for stored, recording in zip(stored_truths(tmp_path / "fruit.npz"), truths, strict=True):
        assert (stored.name, stored.gel) == (recording.name, recording.gel)
        np.testing.assert_array_equal(stored.rest_mm, recording.rest_mm)
        for pad, true_pad in zip(stored.pads, recording.pads, strict=True):
            np.testing.assert_array_equal(pad.pose, true_pad.pose)
            np.testing.assert_allclose(pad.displacement_mm, true_pad.displacement_mm, rtol=1e-6)
            np.testing.assert_allclose(pad.force_N, true_pad.force_N, rtol=1e-6)


def test_another_format_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "fruit.npz", words=np.array(json.dumps({"format": 0, "grasps": []})))
    with pytest.raises(ValueError, match="simulate the fruit anew"):
        stored_truths(tmp_path / "fruit.npz")


def test_the_four_grasps_have_the_frames_of_the_shared_cases() -> None:
    motions = [motion_of(m) for m in four_manners(1.95)]
    assert [int(m.recorded.sum()) for m in motions] == [82, 67, 73, 67]
    for m in motions:
        assert np.all(np.diff(m.time_s) > 0)
        shown = m.travel_mm[m.recorded]
        assert np.all(shown[:30] < 0)
        assert np.all(shown[-15:] < 0)
    assert motions[0].travel_mm.max() == 1.95
    assert [m.shear_mm.max() for m in motions] == [0.0, 0.0, 1.2, 0.0]


def test_an_injected_offset_takes_the_place_of_the_spread() -> None:
    plan = planned("x", (("pit_offset", 3.4),), seed=(1, 2))
    offset = np.subtract(plan.drawn.fruit.pit.centre_mm, plan.drawn.prior.centre_mm)
    assert offset == pytest.approx(plan.injected[0].parameters["offset_mm"])
    assert np.linalg.norm(offset) == pytest.approx(3.4)


def test_an_effect_that_is_not_in_the_catalogue_is_refused() -> None:
    with pytest.raises(SampleFailure, match="no effect 'rust'"):
        drawn_parameters("rust", 1.0, np.random.default_rng(0))


def test_a_case_is_read_back_and_its_air_carries_the_noise(tmp_path: Path) -> None:
    drawn = drawn_ball()
    write_case_files(
        tmp_path / "case-1", drawn, (still_recording(60),), peaks_N=(20.0,), rng=np.random.default_rng(1)
    )
    assert [p.name for p in sorted((tmp_path / "case-1").iterdir())] == [
        "case.toml", "fruit.ply", "grasp-1.h5", "pit.ply",
    ]  # fmt: skip
    vertices, _ = read_mesh(tmp_path / "case-1" / "fruit.ply")
    error = np.linalg.norm(vertices, axis=1) - 25.0
    assert np.sqrt(np.mean(error**2)) == pytest.approx(0.1, rel=0.02)
    pad = read_recording(tmp_path / "case-1" / "grasp-1.h5").pads[0]
    assert isinstance(pad, GelPad)
    noise_N = pad.force_N - pad.force_N.mean(axis=0)
    assert noise_N.std() == pytest.approx(2e-4 * 20.0, rel=0.05)
    assert pad.force_N.mean(axis=0).std() == pytest.approx(2e-4 * 10.0, rel=0.2)
    assert not list(tmp_path.glob(".*partial"))


def test_an_exact_body_becomes_a_case_with_noise_a_scan_and_a_wrong_pit(tmp_path: Path) -> None:
    body, cases = tmp_path / "bodies" / "ball", tmp_path / "cases"
    exact = replace(drawn_ball(), mesh_error_mm=0.0)
    peaks_N, rng = (20.0,), np.random.default_rng(1)
    write_case_files(body, exact, (still_recording(60, late_N=0.01),), peaks_N=peaks_N, rng=rng)
    truth = {"E": 0.5, "nu": 0.45, "pit": [10.0] * 3, "pit_centre": [0.0] * 3, "category": "pdms_ball"}
    (body / "truth.json").write_text(json.dumps(truth))
    assert disturbed(body, cases, record=1) == "null-ball-1"
    written = cases / "null-ball-1"
    skin, _ = read_mesh(written / "fruit.ply")
    pit, _ = read_mesh(written / "pit.ply")
    assert 0.04 < np.std(np.linalg.norm(skin, axis=1)) < 0.13
    assert 0.01 < np.linalg.norm(pit.mean(axis=0)) < 3.0
    before, after = (read_recording(folder / "grasp-1.h5").pads[0] for folder in (body, written))
    assert isinstance(before, GelPad)
    assert isinstance(after, GelPad)
    added_um = 1e3 * (after.displacement_mm - before.displacement_mm)
    assert 1.5 < added_um.std() < 8.0
    assert after.gel_kn_MPa_per_mm == before.gel_kn_MPa_per_mm
    assert np.abs(after.force_N - before.force_N).max() > 0
    answer = answer_of(cases, "null-ball-1")
    assert (answer["effect"], answer["E_MPa"], answer["drawn_from"]["fruit"]) == ("none", 0.5, "ball")
    stamp = (written / "fruit.ply").stat().st_mtime_ns
    disturbed(body, cases, record=1)
    assert (written / "fruit.ply").stat().st_mtime_ns == stamp
