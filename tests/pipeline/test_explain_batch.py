"""`drupe explain` of a fruit of a batch, with --apply, and of a bare ball's trace."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from fake_explanation import GAIN, OTHERS, fake_explanation

import pipeline.diagnosis.diagnosis
import pipeline.fruit.grasped
from pipeline.problem import known_names
from tactile.readers.recording import IndenterPad, Recording, write_recording


def test_a_fruit_of_a_batch_is_explained_and_its_effect_applied_once(drupe, finder, batch):
    finder["answer"] = fake_explanation(verdict="sensor_gain", ranking=(GAIN, *OTHERS))
    ran = drupe("explain", batch / "fruits" / "N01", "--apply")
    assert ran.status == 0, ran.err
    assert "batch.toml now holds sensor_gain for every fruit of the batch" in ran.out
    text = (batch / "batch.toml").read_text()
    assert text.startswith('# ours\ncategory = "nectarine"\npoisson_ratio = 0.45\n')
    kept = json.loads((batch / "results" / "fruits" / "N01" / "mismatch.json").read_text())
    assert (kept["verdict"], len(kept["key"])) == ("sensor_gain", 64)
    again = drupe("explain", batch, "--fruit", "N01", "--apply")
    assert "already contain effects (sensor_gain)" in again.out
    assert (batch / "batch.toml").read_text() == text


def test_what_is_not_confirmed_is_not_applied_and_it_is_said_why(drupe, finder, batch):
    finder["answer"] = fake_explanation(verdict="unknown")
    before = (batch / "batch.toml").read_text()
    ran = drupe("explain", batch, "--fruit", "N01", "--apply")
    assert ran.status == 0
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
    ran = drupe("explain", folder, "--json", tmp_path / "a.json", "--html", tmp_path / "a.html")
    assert ran.status == 0, ran.err
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
    ran = drupe("explain", batch, "--fruit", "N01", "--json", tmp_path / "a.json")
    assert ran.status == 0, ran.err
    said = 'press.h5: attribute fruit_id: found "slab", expected "N01", and fruits.csv has no "slab"'
    assert any(note.startswith(said) for note in json.loads((tmp_path / "a.json").read_text())["notes"])
