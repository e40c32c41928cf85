"""`drupe check` says of every file what stands in its way, and what grading will put in doubt."""

import re
import shutil

import h5py
import numpy as np
import pytest
from small_batches import DATA, batch_of_nectarines, run, times_force
from tiny_onnx import write_constant_model

from pipeline.batch.opening import open_batch
from pipeline.run import checking as checking
from pipeline.run.checking import check, implausible
from recon.learned import usable_model
from recon.learned.fruit_model import SIDE_PX
from recon.learned.onnx_session import opened
from recon.pit.placement import place_pit
from recon.pit.priors import load_prior
from recon.surface.mesh_file import read_mesh, write_mesh
from tactile.readers.recording import read_recording


@pytest.fixture
def batch(tmp_path):
    return batch_of_nectarines(tmp_path, "A", "B")


def said(batch):
    return [str(problem).replace(f"{batch}/", "") for problem in check(batch)]


def on_one_line(path):
    with h5py.File(path, "r+") as file:
        file["pads/left/rest_mm"][:, 1] = 0.0


def test_markers_on_a_line_are_said_and_hide_no_other_problem(batch):
    on_one_line(batch / "fruits" / "A" / "grasps" / "grasp-1.h5")
    (batch / "fruits" / "B" / "fruit.ply").write_bytes(b"no mesh")
    first, second = said(batch)
    assert first.startswith("fruits/A/grasps/grasp-1.h5: pads/left/rest_mm: found")
    assert "on one line" in first
    assert second.startswith("fruits/B/fruit.ply")


@pytest.mark.parametrize("fault", [ValueError("QH6013\n  of the library"), KeyError("x"), RuntimeError()])
def test_a_fault_of_drupe_itself_is_one_line_of_the_file_and_hides_no_other(batch, monkeypatch, fault):
    def faulty(path, **options):
        if path.parts[-3] == "A":
            raise fault
        return read_recording(path, **options)

    monkeypatch.setattr(checking, "read_recording", faulty)
    (batch / "fruits" / "B" / "grasps" / "grasp-1.h5").write_bytes(b"nothing")
    first, second = said(batch)
    beginning = "fruits/A/grasps/grasp-1.h5: an internal error of drupe occurred while reading grasp-1.h5: "
    assert first.startswith(beginning + type(fault).__name__)
    assert "\n" not in first
    assert "of the library" not in first
    assert second.startswith("fruits/B/grasps/grasp-1.h5")


def with_model(batch, **shapes):
    """A constant model of the batch, by default one that `drupe` can use, and a photo instead of A's mesh."""
    side = shapes.get("side", SIDE_PX)
    name = shapes.get("output", "fruit_log_odds")
    outputs = {name: np.zeros((1, 1, 2, 2))}
    write_constant_model(batch / "model.onnx", outputs, input_shape=("n", 3, side, side))
    with (batch / "batch.toml").open("a") as file:
        file.write('\n[recon]\ngeometry_model = "model.onnx"\n')
    (batch / "fruits" / "A" / "fruit.ply").unlink()
    (batch / "fruits" / "A" / "photos").mkdir()
    (batch / "fruits" / "A" / "photos" / "1.jpg").write_bytes(b"no picture")
    return batch / "model.onnx"


def said_of_model(batch):
    return [line for line in said(batch) if "recon.geometry_model" in line]


@pytest.mark.parametrize("damage", [lambda whole: whole[:-40], lambda whole: b"nonsense" * 99])
def test_a_damaged_model_is_named_before_the_first_fruit(batch, damage):
    model = with_model(batch)
    assert said_of_model(batch) == []
    model.write_bytes(damage(model.read_bytes()))
    (line,) = said_of_model(batch)
    assert line.startswith('batch.toml: "recon.geometry_model": The geometry model model.onnx is damaged')


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        (
            {"side": 64},
            "takes the inputs {'images': ['n', 3, 64, 64]}; "
            'expected one input "images" of shape (n, 3, 192, 192)',
        ),
        (
            {"output": "depth"},
            "takes the inputs {'images': ['n', 3, 192, 192]}; "
            'expected one input "images" of shape (1, S, 3, H, W)',
        ),
    ],
)
def test_a_model_with_other_inputs_is_named_before_the_first_fruit(batch, shapes, words):
    with_model(batch, **shapes)
    (line,) = said_of_model(batch)
    assert words in line


def test_a_missing_model_is_one_problem(batch):
    with_model(batch).unlink()
    (line,) = said_of_model(batch)
    assert "is not a file" in line


def test_the_model_is_opened_once_and_only_for_photos(batch, monkeypatch):
    names, stages = [], []

    def counted(model, providers):
        names.append(model.name)
        return opened(model, providers)

    monkeypatch.setattr(usable_model, "opened", counted)
    with_model(batch)
    list(check(batch, report=stages.append))
    assert (names, stages[0]) == (["model.onnx"], "geometry model")
    shutil.copyfile(DATA / "fruit.ply", batch / "fruits" / "A" / "fruit.ply")
    list(check(batch, report=stages.append))
    assert (names, stages.count("geometry model")) == (["model.onnx"], 1)


def test_each_mesh_is_read_once(batch, monkeypatch):
    opened = []

    def counted(path):
        opened.append(path.relative_to(batch / "fruits").as_posix())
        return read_mesh(path)

    monkeypatch.setattr(checking, "read_mesh", counted)
    vertices, faces = place_pit(*read_mesh(DATA / "fruit.ply"), load_prior("nectarine"))
    write_mesh(batch / "fruits" / "B" / "pit.ply", vertices, faces)
    assert said(batch) == []
    assert sorted(opened) == ["A/fruit.ply", "B/fruit.ply", "B/pit.ply"]


def test_grade_ends_by_the_rules_that_check_says(batch):
    """One slip in the table, one in a mesh: the sentences are the same."""
    (batch / "fruits.csv").write_text("fruit_id,mass_g\nA,0.1\nB,\n")
    vertices, faces = read_mesh(DATA / "fruit.ply")
    write_mesh(batch / "fruits" / "B" / "fruit.ply", 0.001 * vertices, faces)
    opened = open_batch(batch)
    ended = [implausible(opened, row) for row in opened.rows]
    assert all(ended)
    checked = [problem.sentence.removeprefix("A: ") for problem in check(batch) if problem.implausible]
    assert checked == ended


def checked(batch):
    """The command's exit status, and what it prints."""
    status, text = run("check", batch)
    return status, text.replace(f"{batch}/", "")


def with_pit(batch, shift_mm):
    vertices, faces = place_pit(*read_mesh(DATA / "fruit.ply"), load_prior("nectarine"))
    write_mesh(batch / "fruits" / "A" / "pit.ply", vertices + np.array([shift_mm, 0.0, 0.0]), faces)


@pytest.mark.parametrize(
    ("shift_mm", "status", "line", "last"),
    [
        (0.3, 0, "^$", "0 problems found in {}"),
        (
            8.0,
            2,
            "^fruits/A/pit.ply: pit.ply lies 8.0 mm from the expected place of a nectarine's pit",
            "1 problem found in {}",
        ),
        (
            4.0,
            4,
            "^fruits/A/pit.ply: pit.ply lies 4.0 mm from the expected place .*The mesh in pit.ply is "
            r"shifted, uses another frame than fruit.ply.*E will be in doubt\.$",
            "0 problems found in {}, and 1 finding that will put E in doubt",
        ),
    ],
)
def test_a_pit_is_in_order_refused_or_doubted_as_grading_does(batch, shift_mm, status, line, last):
    with_pit(batch, shift_mm)
    ended, text = checked(batch)
    assert ended == status
    *lines, final = text.splitlines()
    assert re.search(line, "".join(lines))
    assert final == last.format(batch)


def test_a_pit_is_judged_where_the_settings_move_it(batch):
    """As grading does: 4 mm back to the middle, by what the grasps showed."""
    with_pit(batch, 4.0)
    with (batch / "batch.toml").open("a") as file:
        file.write(
            '[[mismatch]]\neffect = "pit_offset"\nfruits = ["A"]\n'
            "parameters = { offset_mm = [-4.0, 0.0, 0.0] }\n"
        )
    assert checked(batch)[0] == 0


def test_a_gain_that_grading_doubts_is_said(batch):
    with h5py.File(batch / "fruits" / "B" / "grasps" / "grasp-1.h5", "r+") as file:
        times_force(file, 1.4)
    status, text = checked(batch)
    assert status == 4
    line, _ = text.splitlines()
    assert line.startswith("fruits/B/grasps/grasp-1.h5: ")
    assert "1.4" in line
    assert line.endswith("E will be in doubt.")
    (batch / "fruits" / "A" / "fruit.ply").write_bytes(b"no mesh")
    assert checked(batch)[0] == 2


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("fruits/A", "is the folder of one fruit; give the batch, {}."),
        ("fruits/AA", "does not exist; give an existing batch folder."),
        ("loop", "does not exist; give an existing batch folder."),
    ],
)
def test_a_place_that_is_no_batch_is_refused_and_a_fruits_own_leads_to_its_batch(batch, place, said):
    (batch / "loop").symlink_to("loop")
    (problem,) = check(batch / place)
    assert problem.sentence == said.format(batch)


def test_problems_of_the_batch_come_before_any_fruit_is_read(batch):
    (batch / "fruits" / "stray" / "photos").mkdir(parents=True)
    stages = []
    problems = check(batch, quick=True, report=stages.append)
    assert "is not in fruits.csv" in next(problems).sentence
    assert not stages
    list(problems)
    assert stages == ["A (1 of 2)", "B (2 of 2)"]


def test_a_slip_in_the_path_is_told_before_anything_else(batch, drupe):
    ran = drupe("check", batch.with_name("nowhere"))
    assert (ran.status, ran.out) == (2, "")
    assert "nowhere: does not exist; give an existing batch folder." in ran.err
