"""From arrays, drupe gives the modulus that `drupe grade` gives; the page's example gives the true one."""

import json
import re
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from phantom_batches import BALL_MM, CORE_MM, E_MPA, ball, grasped_ball
from sample_batches import SETTINGS, SHIPPED, drupe, ready_batch

from drupe import grade, modulus, read, read_recording
from drupe.refusal import DrupeError
from recon.surface.mesh_file import read_mesh, write_mesh

PAGE = Path(__file__).parents[2] / "docs" / "python.md"
FRAME_S = 0.02
"""A frame of a camera at 50 frames/s; a frame takes 1 to 10 ms on two loaded cores."""


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    batch = ready_batch(tmp_path_factory.mktemp("arrays") / "batch", 1)
    (batch / "batch.toml").write_text(SETTINGS)  # large deformation, as it is without [flesh]
    assert drupe("grade", "--no-screen", batch, "--jobs", 1).status == 0
    return batch


def test_arrays_give_the_modulus_that_grading_gives(graded):
    (fruit,) = (graded / "fruits").iterdir()
    measured = modulus(
        read_mesh(fruit / "fruit.ply"),
        [read_recording(fruit / "grasps" / "grasp-1.h5")],
        pit="prior",
        nu=0.45,
        category="nectarine",
        settings={"mesh": {"edge_mm": 12.0, "pad_edge_mm": 4.0}},
    )
    record = read(graded / "results").record(fruit.name)
    held = record["modulus"]
    assert measured.E_MPa == pytest.approx(held["E_MPa"], rel=1e-9)
    assert measured.E_sd_MPa == pytest.approx(held["E_sd_MPa"], rel=1e-9)
    assert measured.parts_sd_MPa == pytest.approx(held["parts_sd_MPa"])
    assert [text.replace("recording-1", "grasp-1") for text in measured.warnings] == record["warnings"]
    assert measured.recordings["E_MPa"].tolist() == pytest.approx([record["grasps"][0]["E_MPa"]])
    low, high = measured.interval_90_MPa
    assert low < measured.E_MPa < high
    assert {residual.name for residual in measured.residuals} == {"recording-1, left", "recording-1, right"}
    assert all(residual.place_mm.shape == (len(residual.residual_mm), 3) for residual in measured.residuals)


def test_the_table_is_that_of_the_results_with_types_and_provenance(graded):
    batch = read(graded / "results")
    row = json.loads((graded / "results" / "ranking.json").read_text())[0]
    assert batch.ranking.loc[0, "E_MPa"] == row["E_MPa"]
    kinds = {name: str(batch.ranking.dtypes[name]) for name in ("rank", "E_MPa", "reason", "reference")}
    assert kinds == {"rank": "Int64", "E_MPa": "Float64", "reason": "string", "reference": "bool"}
    fruit_id = batch.ranking.loc[0, "fruit_id"]
    assert batch.provenance["inputs"][f"fruits/{fruit_id}/fruit.ply"]
    with pytest.raises(DrupeError, match='fruit_id: found "X", expected a fruit of the batch'):
        batch.record("X")


def test_surfaces_of_photos_are_in_the_frame_of_the_poses(graded, tmp_path):
    """As photos on a mat give them: the meshes are where the fruit stood, 200 mm from the mat's middle."""
    results = tmp_path / "results"
    shutil.copytree(graded / "results", results)
    (folder,) = (results / "fruits").iterdir()
    record = json.loads((folder / "record.json").read_text())
    record["mesh"]["source"] = "photos"
    (folder / "record.json").write_text(json.dumps(record))
    (skin, faces), (pit, pit_faces) = read_mesh(folder / "fruit.ply"), read_mesh(folder / "pit.ply")
    away_mm = np.array([200.0, 0.0, 0.0])
    write_mesh(folder / "fruit.ply", skin + away_mm, faces)
    write_mesh(folder / "pit.ply", pit + away_mm, pit_faces)
    (on_mat, _), _ = read(results).surfaces(folder.name, frame="mat")
    assert on_mat == pytest.approx(skin + away_mm, abs=1e-4)
    (placed, _), (placed_pit, _) = read(results).surfaces(folder.name)
    assert placed.max(axis=0)[:2] + placed.min(axis=0)[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert placed[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert placed_pit.mean(axis=0) - placed.mean(axis=0) == pytest.approx(
        pit.mean(axis=0) - skin.mean(axis=0), abs=1e-4
    )
    for given, said in (({"fruit_id": "X"}, "expected a fruit"), ({"frame": "robot"}, 'found "robot"')):
        with pytest.raises(DrupeError, match=said):
            read(results).surfaces(**{"fruit_id": folder.name, **given})
    (folder / "fruit.ply").unlink()
    with pytest.raises(DrupeError, match=r"found no mesh in .*, expected a fruit graded with one"):
        read(results).surfaces(folder.name)


@pytest.mark.slow
def test_the_page_s_ten_lines_give_the_true_modulus_of_the_sample(graded, tmp_path, monkeypatch, capsys):
    (tmp_path / "sample-results").symlink_to(graded / "results")
    (tmp_path / "samples").symlink_to(SHIPPED.parents[1])
    (block,) = re.findall(r"<!-- sample -->\n```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert len(block.splitlines()) <= 10
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(block, PAGE.name, "exec"), names)
    true_MPa = json.loads((SHIPPED / "answers.json").read_text())["fruits"]["N01"]["E_MPa"]
    low, high = names["found"].interval_90_MPa
    assert low < true_MPa < high
    assert capsys.readouterr().out == f"E = {names['found'].E_MPa:.3f} ± {names['found'].E_sd_MPa:.3f} MPa\n"


def test_grading_a_graded_batch_from_python_gives_the_same_table(graded):
    again = grade(graded, jobs=1, screen=False)
    assert again.ranking.equals(read(graded / "results").ranking)
    assert again.folder == graded / "results"


def test_a_folder_without_results_is_refused(graded):
    with pytest.raises(DrupeError, match=r"found no results of drupe grade.*; give .*results"):
        read(graded)


def test_a_table_with_a_value_of_another_kind_is_refused(graded, tmp_path):
    for name in ("batch.json", "ranking.json"):
        (tmp_path / name).write_bytes((graded / "results" / name).read_bytes())
    rows = json.loads((tmp_path / "ranking.json").read_text())
    rows[0]["rank"] = "first"
    (tmp_path / "ranking.json").write_text(json.dumps(rows))
    with pytest.raises(DrupeError, match=r"ranking\.json: found a value of another kind"):
        read(tmp_path)


def test_a_batch_that_cannot_be_graded_is_refused_with_the_commands_sentence(tmp_path):
    with pytest.raises(DrupeError, match="does not exist; give an existing batch folder"):
        grade(tmp_path / "nowhere")


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The names that the page's blocks make, in a folder with the arrays of a grasped ball."""
    folder = tmp_path_factory.mktemp("page")
    held = grasped_ball(core=True, rng=np.random.default_rng(20261121))
    (vertices, faces), (pit_vertices, pit_faces) = ball(BALL_MM), ball(CORE_MM)
    surfaces = {"vertices": vertices, "faces": faces, "pit_vertices": pit_vertices, "pit_faces": pit_faces}
    np.savez(folder / "fruit.npz", **surfaces)
    np.savez(
        folder / "grasp.npz",
        time_s=held.time_s,
        aperture_mm=held.aperture_mm,
        rest_mm=[pad.rest_mm for pad in held.pads],
        displacement_mm=[pad.displacement_mm for pad in held.pads],
        force_N=[pad.force_N for pad in held.pads],
    )
    blocks = re.findall(r"<!-- run -->\n```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 2
    assert len(blocks[0].splitlines()) <= 10
    names: dict[str, object] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in blocks:
            exec(compile(block, PAGE.name, "exec"), names)
    return names


@pytest.mark.slow
def test_the_pages_example_gives_the_true_modulus_from_arrays_without_poses(page):
    """The truth is CalculiX's (phantom_batches)."""
    assert page["found"].E_MPa == pytest.approx(E_MPA, rel=0.02)
    low, high = page["found"].interval_90_MPa
    assert low < E_MPA < high


@pytest.mark.slow
def test_single_frames_give_the_true_modulus_within_milliseconds(page):
    live, grasp, poses = page["live"], page["grasp"], page["pose"]
    live.restart()
    arrays = list(zip(*grasp["displacement_mm"], strict=True)), list(zip(*grasp["force_N"], strict=True))
    frames, seconds = [], []
    for frame in zip(*arrays, zip(*poses, strict=True), strict=True):
        started = time.process_time()
        frames.append(live.estimate(*frame))
        seconds.append(time.process_time() - started)
    assert np.median(seconds) < FRAME_S
    moduli = np.array([frame.E_MPa for frame in frames])
    deepest = int(np.argmin(grasp["aperture_mm"]))
    assert np.isnan(moduli[:30]).all()
    assert moduli[deepest - 4 : deepest + 1] == pytest.approx(E_MPA, rel=0.03)
    assert len(frames[deepest].residual_mm) == sum(map(len, live.markers))


@pytest.mark.slow
def test_wrong_frames_and_pads_off_the_fruit_are_refused(page):
    live, grasp = page["live"], page["grasp"]
    still, poses = grasp["displacement_mm"][:, 0], [pose[0] for pose in page["pose"]]
    with pytest.raises(DrupeError, match=r"force_N\[1\]: found shape \(3, 3\), expected \(400, 3\)"):
        live.estimate(still, [still[0], np.zeros((3, 3))], poses)
    with pytest.raises(DrupeError, match="force_N: found 1 pads, expected 2"):
        live.estimate(still, still[:1], poses)
    with pytest.raises(DrupeError, match=r"pose\[0\]: found a matrix that is no rotation and shift"):
        live.estimate(still, still, [pose.T for pose in poses])
