"""`drupe explain` from a case, a batch, arrays or a bare ball's trace to its answer."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace
from unicodedata import normalize

import numpy as np
import pytest
from explain_runs import DATA, SETTINGS, change
from fake_explanation import GAIN, OTHERS, fake_explanation
from threadpoolctl import threadpool_limits

import pipeline.diagnosis.diagnosis
import pipeline.fruit.grasped
from drupe import DrupeError, explain, explain_fruit, read_recording
from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.result import Modulus, Where
from pipeline.fruit import flesh_model
from pipeline.problem import known_names
from recon.surface.mesh_file import read_mesh
from tactile.readers.recording import IndenterPad, Recording, write_recording


def finite(value):
    if isinstance(value, dict):
        return all(map(finite, value.values()))
    if isinstance(value, list):
        return all(map(finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def test_a_case_becomes_an_answer_in_the_fixed_format_a_page_and_a_verdict_that_comes_first(
    drupe, finder, case, tmp_path
):
    before = sorted(p.name for p in case.iterdir())
    finder["answer"] = fake_explanation(p_value=math.nan, where=Where(region="pad left", radius_mm=math.inf))
    ran = drupe("explain", case, "--json", tmp_path / "a.json", "--html", tmp_path / "a.html", status=0)
    assert "The flesh creeps" in ran.out.splitlines()[0]
    assert "naming" in ran.err
    said = json.loads((tmp_path / "a.json").read_text())
    assert (said["format"], said["version"], said["p_value"]) == ("drupe-mismatch", 1, None)
    assert said["where"] == {"region": "pad left", "centre_mm": None, "radius_mm": None}
    assert finite(said)
    page = (tmp_path / "a.html").read_text()
    assert page.index("The flesh creeps") < page.index("What explains it") < page.index("What to record next")
    assert sorted(p.name for p in case.iterdir()) == before


def test_the_finder_is_handed_the_whole_case_and_the_jobs_while_blas_keeps_to_one_thread(drupe, finder, case):
    with threadpool_limits(2):  # the tests' own limit is one
        assert drupe("explain", case, "--jobs", "3").status == 0
    assert (finder["jobs"], finder["jobs of grading"]) == (3, 3)
    assert finder["blas threads"] == {1}, "threads of BLAS beside those of the finder hinder each other"
    handed = finder["case"]
    assert [grasp.name for grasp in handed.grasps] == ["grasp-1", "grasp-2"]
    assert handed.finer_mesh == "for 2 grasps"
    assert (handed.budget.surface_sd_mm, handed.budget.pit_offset_sd_mm) == (0.12, 0.4)
    assert handed.budget.poisson_ratio_sd == 0.015
    (left, right), history = handed.grasps[0].pads, handed.grasps[0].history
    assert (left.name, right.name) == ("left", "right")
    assert left.pose.shape == (len(history.time_s), 4, 4)
    assert 0.01 < left.gel_N_per_mm < 10
    assert "air" in history.phase


def test_recordings_that_grading_has_no_modulus_of_are_explained_all_the_same(
    drupe, finder, case, tmp_path, monkeypatch
):
    def none(*_, jobs):
        raise FemFailure(FemProblem.NOT_CONVERGED, "the grasps contradict each other")

    monkeypatch.setattr(pipeline.diagnosis.diagnosis, "graded_case", none)
    drupe("explain", case, "--json", tmp_path / "a.json", status=0)
    assert finder["graded"] is None
    assert "the grasps contradict each other" in " ".join(
        json.loads((tmp_path / "a.json").read_text())["notes"]
    )


def test_the_finder_keeps_the_mesh_of_grading_where_a_finer_one_fails(drupe, finder, case, monkeypatch):
    def fails(*_, grasps):
        raise FemFailure(FemProblem.INVERTED_ELEMENTS, "3 elements are inverted")

    monkeypatch.setattr(pipeline.diagnosis.diagnosis, "finer_flesh", fails)
    said = drupe("explain", case, status=0).out
    assert finder["case"].finer_mesh is None
    assert "uses the mesh of grading for the plain model: 3 elements are inverted." in said


@pytest.mark.parametrize(("grasps", "dof_limit"), [(2, None), (3, 90_000), (20, 240_000)])
def test_a_finer_mesh_is_made_for_three_grasps_or_more(grasps, dof_limit, monkeypatch):
    """Beside a mesh of grading with 60,000 degrees of freedom."""
    monkeypatch.setattr(flesh_model, "refined", lambda *_, dof_limit, **__: dof_limit)
    task = SimpleNamespace(settings=SimpleNamespace(mesh=SimpleNamespace(edge_mm=5.0, pad_edge_mm=None)))
    pit = SimpleNamespace(skin=(None, None), vertices=None, faces=())
    mesh = SimpleNamespace(nodes_mm=np.zeros((20_000, 3)))
    made = flesh_model.finer_flesh(task, pit, mesh, np.zeros((1, 3)), grasps=grasps)
    assert made == dof_limit


def test_a_case_of_one_grasp_and_several_names_left_still_end_well(drupe, finder, case):
    (case / "grasp-2.h5").unlink()
    finder["answer"] = fake_explanation(verdict=("clock_lag", "viscoelastic"), heldout=None)
    ran = drupe("explain", case, status=0)
    assert "cannot distinguish viscoelastic or clock lag" in ran.out.splitlines()[0]
    assert "nothing confirms the answer" in ran.out
    assert "note: There is only one recording" in ran.out


def test_without_a_pit_the_categorys_is_used_and_it_is_said(drupe, finder, case):
    (case / "pit.ply").unlink()
    said = drupe("explain", case).out
    assert "note: There is no pit.ply, so drupe uses the category's pit" in said
    assert "note: There are 2 recordings: weak effects may stay hidden" in said
    assert len(finder["case"].grasps) == 2


def test_no_frames_in_the_air_is_noted(drupe, finder, case):
    def cut(file):
        force = file["pads/left/force_N"][:, :, 2].sum(axis=1)
        first = int(np.argmax(force > 0.3 * force.max()))
        for name in ("time_s", "aperture_mm"):
            values = file[name][first:]
            del file[name]
            file[name] = values
        for pad in ("left", "right"):
            for name in ("pose", "displacement_mm", "force_N"):
                values = file[f"pads/{pad}/{name}"][first:]
                del file[f"pads/{pad}/{name}"]
                file[f"pads/{pad}/{name}"] = values

    change(case / "grasp-2.h5", cut)
    assert "note: grasp-2: no frame before first contact" in drupe("explain", case, status=0).out


def silent(file):
    for pad in ("left", "right"):
        file[f"pads/{pad}/force_N"][...] = 0.0


def test_a_recording_of_zero_force_is_left_out_and_said_so(drupe, finder, case):
    change(case / "grasp-2.h5", silent)
    ran = drupe("explain", case, status=0)
    assert "note: not used: grasp-2.h5: both pads' force is dead" in ran.out, ran.out
    assert len(finder["case"].grasps) == 1


def of_another_fruit(case):
    change(case / "grasp-2.h5", lambda file: file.attrs.modify("fruit_id", "N77"))


def all_silent(case):
    for path in case.glob("*.h5"):
        change(path, silent)


def settings(text):
    return lambda case: (case / "case.toml").write_text(text)


def without(*patterns):
    return lambda case: [path.unlink() for pattern in patterns for path in case.glob(pattern)]


def no_ply(case):
    (case / "fruit.ply").write_bytes(b"not a mesh")


BAD = {
    "of different fruit": (of_another_fruit, 2, ['"N77"', '"nectarine"', "grasp-1.h5", "grasp-2.h5"]),
    "forces all zero": (all_silent, 3, ["grasp-1.h5", "force is dead"]),
    "no case.toml": (
        without("case.toml"),
        2,
        ["has neither case.toml nor batch.toml; a case holds", 'category = "nectarine"'],
    ),
    "no category": (settings("size_sd = 0.1\n"), 2, ["case.toml", '"category" is missing']),
    "no TOML": (settings("category = nectarine"), 2, ["case.toml", "not valid TOML"]),
    "a slip": (settings(SETTINGS + "ofset_sd_mm = 1\n"), 2, ['did you mean "offset_sd_mm"?']),
    "a wrong value": (settings('category = "plum"\npoisson_ratio = 0.7\n'), 2, ["poisson_ratio", "0.7"]),
    "a wrong type": (settings('category = "plum"\nsize_sd = "small"\n'), 2, ["size_sd", "small"]),
    "no category's prior": (settings('category = "mango"\n'), 2, ["mango", "the key poisson_ratio", "plum"]),
    "no recording": (without("*.h5"), 2, ["no recording (*.h5)"]),
    "no fruit.ply": (without("fruit.ply"), 3, ["fruit.ply"]),
    "unreadable PLY": (no_ply, 3, ["fruit.ply"]),
    "truncated": (
        lambda case: [p.write_bytes(p.read_bytes()[:9000]) for p in case.glob("*.h5")],
        3,
        ["grasp-1.h5", "one that is cut short"],
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_case_is_refused_in_one_line(drupe, finder, case, tmp_path, name):
    spoil, status, said = BAD[name]
    spoil(case)
    ran = drupe("explain", case, "--json", tmp_path / "a.json", status=status)
    line = ran.last_line_error()
    for words in said:
        assert words in line, line
    assert not (tmp_path / "a.json").exists()
    assert "case" not in finder


def test_wrong_places_are_said_before_anything_is_computed(drupe, finder, case, tmp_path):
    for arguments, words in (
        ((tmp_path / "nowhere",), "does not exist"),
        ((case / "fruit.ply",), "is a file; give the folder of a case: recordings (*.h5), a case.toml with"),
        ((case, "--json", tmp_path / "no" / "a.json"), "does not exist"),
        ((case, "--html", tmp_path), "is a folder"),
        ((case, "--fruit", "N1"), "but --fruit applies to batches"),
        ((case, "--apply"), "--apply writes into a batch's settings"),
    ):
        assert words in drupe("explain", *arguments, status=2).last_line_error()


def test_a_key_that_is_not_known_is_noted_and_left_aside(drupe, finder, case):
    (case / "case.toml").write_text(SETTINGS + 'recorded_by = "MK"\n')
    ran = drupe("explain", case, status=0)
    assert 'drupe does not know the key "recorded_by" and ignored it' in ran.out


@pytest.mark.parametrize(
    ("before_MPa", "after_MPa", "words"),
    [
        (
            0.0005,
            0.0006,
            "Found E without an effect 0.0005 MPa and E with it 0.0006 MPa, expected 0.005 to 12 MPa",
        ),
        (300.0, 0.3, "Found E without an effect 300 MPa, expected 0.005 to 12 MPa for nectarine"),
        (0.3, 40.0, "Found E with it 40 MPa, expected 0.005 to 12 MPa for nectarine"),
        (0.3, 0.4, None),
    ],
)
def test_an_E_that_the_category_cannot_have_is_doubted(
    drupe, finder, case, tmp_path, before_MPa, after_MPa, words
):
    finder["answer"] = fake_explanation(
        before=Modulus(value=before_MPa, sd=0.01), after=Modulus(value=after_MPa, sd=0.01)
    )
    done = drupe("explain", case, "--json", tmp_path / "a.json", "--html", tmp_path / "a.html")
    assert done.status == (0 if words is None else 4)
    written = json.loads((tmp_path / "a.json").read_text())
    if words is None:
        assert "doubts" not in written
        assert "doubt:" not in done.out
        return
    assert f"doubt: {words}" in done.out
    assert written["doubts"][0].startswith(words)
    assert words in (tmp_path / "a.html").read_text()


def test_a_fruit_of_a_batch_is_explained_and_its_effect_applied_once(drupe, finder, batch):
    finder["answer"] = fake_explanation(verdict="sensor_gain", ranking=(GAIN, *OTHERS))
    ran = drupe("explain", batch / "fruits" / "N01", "--apply", status=0)
    assert "batch.toml now holds sensor_gain for every fruit of the batch" in ran.out
    text = (batch / "batch.toml").read_text()
    assert text.startswith('# ours\ncategory = "nectarine"\npoisson_ratio = 0.45\n')
    kept = json.loads((batch / "results" / "fruits" / "N01" / "mismatch.json").read_text())
    assert (kept["verdict"], len(kept["key"])) == ("sensor_gain", 64)
    again = drupe("explain", batch, "--fruit", "N01", "--apply")
    assert "already contain effects (sensor_gain)" in again.out
    assert (batch / "batch.toml").read_text() == text


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_a_fruit_is_named_with_composed_or_separate_accents(drupe, finder, batch, form):
    (batch / "fruits" / "N01").rename(batch / "fruits" / normalize("NFD", "Süd 1"))
    table = batch / "fruits.csv"
    table.write_text(table.read_text().replace("N01", "Süd 1"), encoding="utf-8")
    drupe("explain", batch, "--fruit", normalize(form, "Süd 1"), status=0)
    drupe("explain", batch / "fruits" / normalize("NFD", "Süd 1"), status=0)


def test_what_is_not_confirmed_is_not_applied_and_it_is_said_why(drupe, finder, batch):
    finder["answer"] = fake_explanation(verdict="unknown")
    before = (batch / "batch.toml").read_text()
    ran = drupe("explain", batch, "--fruit", "N01", "--apply", status=0)
    assert "Not applied: the cause is unknown" in ran.out
    assert (batch / "batch.toml").read_text() == before


def test_a_batch_needs_to_be_told_which_fruit(drupe, finder, batch):
    assert "--fruit (N01)" in drupe("explain", batch).last_line_error()
    unknown = drupe("explain", batch, "--fruit", "N1").last_line_error()
    assert unknown.endswith('has no fruit "N1"; did you mean "N01"? known fruit: N01.')


def test_of_many_fruit_the_nearest_are_named_and_the_others_counted():
    fruit = [f"{tree}-{k:02d}" for tree in ("A", "B") for k in range(50)]
    said = known_names("B-7", fruit, "fruit", "fruit")
    assert said.startswith('did you mean "B-')
    named, _, others = said.removesuffix(" more.").partition("known fruit: ")[2].partition(" and ")
    assert all(name.startswith("B-") for name in named.split(", "))
    assert len(named.split(", ")) + int(others) == len(fruit)


def test_an_effect_of_a_fruit_that_is_not_there_is_refused(drupe, batch):
    with (batch / "batch.toml").open("a") as file:
        file.write('[[mismatch]]\neffect = "pit_size"\nparameters = { scale = 0.8 }\nfruits = ["N1"]\n')
    line = drupe("grade", batch).last_line_error()
    assert 'pit_size names fruit "N1", which is not in fruits.csv; did you mean "N01"?' in line


TRAVEL = np.concatenate([np.zeros(20), np.linspace(0, 3, 80), np.full(60, 3.0)])


def ball(path, indenter="ball"):
    force = 1.2 * np.maximum(TRAVEL - 0.4, 0.0) ** 1.5
    force = force + np.random.default_rng(1).normal(0, 0.004, len(TRAVEL))
    pose = np.tile(np.eye(4), (len(TRAVEL), 1, 1))
    pad = IndenterPad(name="tip", pose=pose, force_z_N=force, indenter=indenter, radius_mm=5.0)
    what = {"fruit_id": "slab", "category": "silicone", "loading": "press", "support": "base"}
    time_s = np.linspace(0.0, 20.0, len(TRAVEL))
    write_recording(path, Recording(**what, sensor="rig", time_s=time_s, aperture_mm=TRAVEL, pads=(pad,)))


@pytest.fixture
def handed(monkeypatch):
    """What is handed to the finder of curves, whose place is taken."""
    handed = {}

    def explain_trace(trace, **rest):
        handed.update(rest, trace=trace)
        return SimpleNamespace(explanation=fake_explanation(maps=None, traces=(), cells=()))

    monkeypatch.setattr(pipeline.diagnosis.diagnosis, "explain_trace", explain_trace)
    return handed


def test_the_trace_of_a_bare_ball_is_explained_without_any_mesh(drupe, handed, tmp_path):
    folder = tmp_path / "slab"
    folder.mkdir()
    (folder / "case.toml").write_text('category = "silicone"\npoisson_ratio = 0.45\nthickness_mm = 12.0\n')
    ball(folder / "press.h5")
    drupe("explain", folder, "--json", tmp_path / "a.json", "--html", tmp_path / "a.html", status=0)
    assert (handed["thickness_mm"], handed["poisson_ratio"]) == (12.0, 0.45)
    assert handed["trace"].geometry.radius_mm == 5.0
    assert handed["trace"].travel_mm[-1] == 3.0
    ball(folder / "second.h5")
    assert drupe("explain", folder).status == 0
    assert len(handed["trace"].parts) == 2
    assert handed["trace"].parts[1].travel_mm[-1] == 3.0
    ball(folder / "second.h5", "flat")
    said = drupe("explain", folder).last_line_error()
    assert (
        "second.h5: has the geometry flat punch of radius 5 mm, but press.h5 has ball of radius 5 mm" in said
    )


def test_a_trace_that_names_a_fruit_which_the_batch_does_not_have_is_said(drupe, batch, handed, tmp_path):
    """As of a grasp: its fruit's E would be in doubt."""
    grasps = batch / "fruits" / "N01" / "grasps"
    for path in grasps.iterdir():
        path.unlink()
    ball(grasps / "press.h5")
    drupe("explain", batch, "--fruit", "N01", "--json", tmp_path / "a.json", status=0)
    said = 'press.h5: attribute fruit_id: found "slab", expected "N01", and fruits.csv has no "slab"'
    assert any(note.startswith(said) for note in json.loads((tmp_path / "a.json").read_text())["notes"])


@pytest.fixture(scope="module")
def recordings():
    """One recording, and another that is a little stronger."""
    first = read_recording(DATA / "grasp.h5")
    pads = tuple(replace(pad, force_N=1.002 * pad.force_N) for pad in first.pads)
    return [first, replace(first, pads=pads)]


def test_the_finder_gets_the_arrays_and_its_answer_comes_back(finder, recordings):
    mesh, pit = read_mesh(DATA / "fruit.ply"), read_mesh(DATA / "pit.ply")
    mismatch = explain(mesh, recordings, pit=pit, nu=0.42, category="nectarine")
    answer = fake_explanation()
    assert finder["case"].poisson_ratio == 0.42
    assert [grasp.name for grasp in finder["case"].grasps] == ["recording-1", "recording-2"]
    assert (mismatch.E_MPa, mismatch.E_without_MPa) == (answer.after.value, answer.before.value)
    assert mismatch.candidates["effect"].tolist() == [candidate.effect for candidate in answer.ranking]
    assert np.isfinite(mismatch.candidates["probability"]).all()
    assert mismatch.answer["format"] == "drupe-mismatch"
    assert (mismatch.heldout, mismatch.next_grasp) == (mismatch.answer["fit"], answer.next_grasp)
    assert mismatch.heldout["heldout_rms_before"] == answer.heldout.rms_before
    assert mismatch.sentence


def test_one_recording_has_no_residual_on_others(finder, recordings):
    mesh, pit = read_mesh(DATA / "fruit.ply"), read_mesh(DATA / "pit.ply")
    finder["answer"] = fake_explanation(heldout=None)
    mismatch = explain(mesh, recordings[:1], pit=pit, nu=0.42, category="nectarine")
    assert mismatch.heldout is None


def test_a_fruit_of_a_batch_is_explained_with_the_batchs_settings(finder, batch):
    mismatch = explain_fruit(batch, "N01")
    assert finder["case"].poisson_ratio == 0.45
    assert mismatch.answer["case"] == "N01"
    with pytest.raises(DrupeError, match='has no fruit "N1"; did you mean "N01"'):
        explain_fruit(batch, "N1")
