"""`import drupe`: the names that it promises, and recordings from arrays, refused by name where wrong."""

import inspect
import re
import tomllib
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from small_batches import python

import drupe
from drupe.array_batch import array_batch
from recon.surface.mesh_file import read_mesh

PAGE = Path(__file__).parents[2] / "docs" / "python.md"
MODULES = (
    "array_batch", "array_modulus", "batches", "explained", "live_frames", "numbers", "recordings", "refusal",
)  # fmt: skip
AT_MOST_S = 0.3


def said(program: str, *, folder: Path | None = None) -> str:
    done = python(program, cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_import_takes_less_than_a_third_of_a_second_and_no_library():
    """Processor time, which other processes on the machine do not change."""
    program = (
        "import sys, time; start = time.process_time(); import drupe; took = time.process_time() - start; "
        "print(took, 'numpy' in sys.modules)"
    )
    took, loaded = said(program).split()
    assert float(took) < AT_MOST_S
    assert loaded == "False"


def test_the_callers_import_path_and_folder_stay(tmp_path):
    (tmp_path / "mine.py").write_text("E_MPa = 0.5\n")
    root = Path(__file__).parents[2]
    program = (
        f"import os, sys; sys.path.append({str(root)!r}); before = sys.path[:], os.getcwd(); import drupe; "
        "drupe.grade, drupe.read_recording; assert (sys.path, os.getcwd()) == before, sys.path; "
        "import mine; print(mine.E_MPa)"
    )
    assert said(program, folder=tmp_path) == "0.5"


@pytest.mark.parametrize("name", drupe.__all__)
def test_every_public_name_exists_has_a_docstring_and_stands_on_the_page(name):
    value = getattr(drupe, name)
    assert value.__name__ == name
    assert value.__module__.startswith("drupe.")
    assert inspect.getdoc(value)
    assert f"`{name}" in PAGE.read_text(encoding="utf-8")


def test_every_name_that_the_page_uses_is_public():
    used = set(re.findall(r"\bdrupe\.(\w+)", PAGE.read_text(encoding="utf-8")))
    assert used <= {*drupe.__all__, "__all__"}


def test_a_name_that_is_not_public_is_no_attribute():
    with pytest.raises(AttributeError, match="has no attribute 'modulos'"):
        _ = drupe.modulos


def test_no_module_is_left_out():
    folder = Path(drupe.__file__).parent
    assert {path.stem for path in folder.glob("*.py")} == {*MODULES, "__init__"}


DATA = Path(__file__).parents[1] / "data" / "nectarine-grasp"


@pytest.fixture(scope="module")
def stored():
    return drupe.read_recording(DATA / "grasp.h5")


@pytest.fixture(scope="module")
def arrays(stored):
    return {
        "time_s": stored.time_s,
        "aperture_mm": stored.aperture_mm,
        "rest_mm": np.array([pad.rest_mm for pad in stored.pads]),
        "displacement_mm": np.array([pad.displacement_mm for pad in stored.pads]),
        "force_N": np.array([pad.force_N for pad in stored.pads]),
        "pose": np.array([pad.pose for pad in stored.pads]),
        "gel_stiffness_MPa_per_mm": (0.22, 0.055),
    }


def same(recording, other):
    for held, its in zip((recording, *recording.pads), (other, *other.pads), strict=True):
        for name, value in vars(held).items():
            if name != "pads":
                np.testing.assert_array_equal(value, getattr(its, name), err_msg=name)


def test_arrays_make_the_recording_that_the_file_holds(arrays, stored):
    made = drupe.recording(**arrays, fruit_id="nectarine", category="nectarine", sensor=stored.sensor)
    same(made, stored)


def test_a_written_recording_is_read_back_the_same(arrays, tmp_path):
    made = drupe.recording(**arrays, force_scale_sd=0.05, displacement_scale_sd=0.01)
    drupe.write_recording(tmp_path / "grasp.h5", made)
    same(drupe.read_recording(tmp_path / "grasp.h5"), made)


def test_a_single_pad_is_a_press_on_a_base(arrays):
    names = ("rest_mm", "displacement_mm", "force_N", "pose")
    made = drupe.recording(**{**arrays, **{name: arrays[name][:1] for name in names}})
    assert (made.loading, made.support, made.pads[0].name) == ("press", "base", "tip")


def test_nothing_is_overwritten(arrays, tmp_path):
    mine = tmp_path / "grasp.h5"
    mine.write_text("my notes")
    with pytest.raises(drupe.DrupeError, match=r"grasp\.h5: exists already"):
        drupe.write_recording(mine, drupe.recording(**arrays))
    assert mine.read_text() == "my notes"


@pytest.mark.parametrize("name", ["grasp", "grasp.mat", "grasp.csv"])
def test_a_recording_is_written_as_hdf5_alone(arrays, tmp_path, name):
    ending = Path(name).suffix
    with pytest.raises(drupe.DrupeError, match=rf'found the ending "{ending}", expected \.h5 or \.hdf5$'):
        drupe.write_recording(tmp_path / name, drupe.recording(**arrays))
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"displacement_mm": np.zeros((2, 46, 9, 3))}, "displacement_mm[0]: found shape (46, 9, 3)"),
        ({"pose": np.zeros((1, 47, 4, 4))}, "pose: found 1 pads, expected 2, as in rest_mm"),
        ({"rest_mm": np.zeros((2, 400, 2))}, "rest_mm[0]: found shape (400, 2), expected (1 or more, 3)"),
        ({"rest_mm": np.zeros((3, 400, 3))}, "rest_mm: found 3 pads, expected 2 (a grasp) or 1 (a press)"),
        ({"rest_mm": None}, "rest_mm: found NoneType, expected a sequence with an array per pad"),
        ({"pose": {"left": [], "right": []}}, "pose: found dict, expected a sequence"),
        ({"force_N": np.ma.masked_less(np.zeros((2, 47, 400, 3)), 1)}, "force_N[0]: found masked values"),
        ({"force_N": [[[1, 2], [3]], [1]]}, "force_N[0]: found no array"),
        ({"force_N": np.full((2, 47, 400, 3), np.nan)}, "force_N[0]: found 56400 values NaN or infinite"),
        ({"time_s": ["0.1"] * 47}, "time_s: found values of type <U3, expected numbers"),
        ({"time_s": np.zeros(47)}, "time_s: found"),
        ({"pose": np.zeros((2, 47, 4, 4))}, "pads/left/pose: found a matrix in frame 0 that is"),
        ({"rest_mm": np.zeros((2, 400, 3))}, "pads/left/rest_mm: found 400 markers in one place"),
        ({"gel_stiffness_MPa_per_mm": (2e5, 1.0)}, "(is it in Pa or kPa?)"),
    ],
)  # fmt: skip
def test_a_wrong_array_is_named_with_what_was_found_and_expected(arrays, changes, sentence):
    with pytest.raises(drupe.DrupeError) as refused:
        drupe.recording(**{**arrays, **changes})
    assert sentence in str(refused.value)


def refusal(mesh, recordings, **options):
    with pytest.raises(drupe.DrupeError) as refused:
        drupe.modulus(mesh, recordings, **{"pit": "none", "nu": 0.45, **options})
    return str(refused.value)


@pytest.mark.parametrize(
    ("names", "factor", "sentence"),
    [
        (("rest_mm", "displacement_mm"), 1e-3, "rest_mm looks like metres"),
        (("displacement_mm",), 1e-3, "displacement looks like metres"),
        (("force_N",), 1e3, "forces look like millinewtons"),
    ],
)
def test_a_wrong_unit_of_a_recording_is_named(arrays, names, factor, sentence):
    wrong = drupe.recording(**{**arrays, **{name: factor * arrays[name] for name in names}})
    assert sentence in refusal(read_mesh(DATA / "fruit.ply"), [wrong])


def test_a_wrong_mesh_is_named(stored):
    vertices, faces = read_mesh(DATA / "fruit.ply")
    assert "is it in m (58.9 mm)?" in refusal((vertices / 1000, faces), [stored])
    assert "expected 0 to 2501" in refusal((vertices, faces + 3), [stored])
    assert "is not watertight" in refusal((vertices, faces[:-5]), [stored])
    assert "mesh: found ndarray, expected the pair (vertices, faces)" in refusal(vertices, [stored])
    assert "found fractions" in refusal((vertices, faces + 0.5), [stored])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"nu": 0.7}, '"poisson_ratio": found 0.7; expected at most 0.4999'),
        ({"nu": None}, "nu: found None without a category"),
        ({"pit": "prior"}, 'pit: found "prior" without a category'),
        ({"pit": "Prior"}, 'pit: found "Prior", expected a mesh, "none" or "prior"'),
        ({"pit": "prior", "category": "mango"}, "known: apricot, cherry"),
        ({"settings": {"mesh": {"edge": 3}}}, 'unknown key "mesh.edge"; did you mean "edge_mm"?'),
        ({"settings": {"notes": object()}}, "settings: found <object"),
        ({"settings": [8.0]}, "settings: found list, expected a table of keys and values"),
        (
            {"settings": {"poisson_ratio": 0.3}},
            'settings: found "poisson_ratio", expected it as the argument nu',
        ),
        ({"nu": np.float32(0.7)}, '"poisson_ratio": found 0.'),
        ({"settings": {"mismatch": [{"effect": "no such"}]}}, "mismatch"),
    ],
)
def test_a_wrong_assumption_is_named(stored, options, sentence):
    assert sentence in refusal(read_mesh(DATA / "fruit.ply"), [stored], **options)


def test_recordings_are_needed_and_belong_to_one_fruit(stored):
    mesh = read_mesh(DATA / "fruit.ply")
    assert refusal(mesh, []) == "recordings: found none, expected one or more of this fruit"
    assert refusal(mesh, ["grasp.h5"]) == "recordings: found str, expected one or more of this fruit"
    other = replace(stored, fruit_id="N02")
    assert "found fruit N02, nectarine, expected one fruit" in refusal(mesh, [stored, other])


def test_settings_reach_the_batch_whole_and_a_single_recording_is_a_list_of_it(stored):
    """NumPy's numbers, tables in tables and letters of every script; None leaves a key out."""
    further = {
        "mesh": {"edge_mm": np.float32(8)},
        "harvest_date": date(2026, 8, 14),
        "variety": "🍑",
        "poisson_ratio_sd": None,
    }
    effects = [{"effect": "stiffening", "amount": [np.float64(0.5)]}]
    given = array_batch(
        read_mesh(DATA / "fruit.ply"),
        stored,
        pit="none",
        nu=np.float64(0.45),
        category=None,
        settings={**further, "mismatch": effects},
    )
    with given as root:
        held = tomllib.loads((root / "batch.toml").read_text(encoding="utf-8"))
        assert len(list(root.glob("fruits/*/grasps/*.h5"))) == 1
    assert held.pop("mismatch") == [{"effect": "stiffening", "amount": [0.5]}]
    assert held == {
        "category": "phantom",
        "poisson_ratio": 0.45,
        "pit": {"prior": "none"},
        "mesh": {"edge_mm": 8.0},
        "harvest_date": "2026-08-14",
        "variety": "🍑",
    }


AWAY = np.diag([1.0, -1, -1, 1])
PAST = np.array([[1.0, 0, 0, 500], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize("moved", [AWAY, PAST])
def test_pads_that_look_away_from_the_fruit_or_past_it_give_no_live_modulus(stored, moved):
    away = replace(stored, pads=tuple(replace(pad, pose=pad.pose @ moved) for pad in stored.pads))
    with pytest.raises(drupe.DrupeError, match="pad left: found no fruit in front of the pad"):
        drupe.live(read_mesh(DATA / "fruit.ply"), away, travel_mm=1.0, pit="none", nu=0.45)


def test_jaws_close_on_the_centre_and_poses_are_rigid():
    aperture = np.array([60.0, 55.0])
    left, right = drupe.jaw_poses(aperture, centre_mm=(1, 2, 3), closing=(0, 5, 0), up=(0.1, 1, 2))
    gap = np.einsum("tij,tj->ti", left[:, :3, :3].transpose(0, 2, 1), right[:, :3, 3] - left[:, :3, 3])
    np.testing.assert_allclose(gap, np.column_stack([0 * aperture, 0 * aperture, aperture]), atol=1e-12)
    np.testing.assert_allclose((left + right)[:, :3, 3] / 2, [[1, 2, 3]] * 2)
    for pose in (left, right):
        turn = pose[0, :3, :3]
        np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1)
    np.testing.assert_allclose(left[0, :3, 2], [0, 1, 0])
    np.testing.assert_allclose(left[0, :3, 1], right[0, :3, 1])


def test_a_negative_aperture_and_a_recording_of_another_type_are_refused(tmp_path):
    with pytest.raises(
        drupe.DrupeError, match=r"aperture_mm: found -2 mm, expected 0 or more; give the dist"
    ):
        drupe.jaw_poses([60.0, -2.0], centre_mm=(0, 0, 0))
    with pytest.raises(drupe.DrupeError, match="held: found dict, expected what `recording` returns"):
        drupe.write_recording(tmp_path / "grasp.h5", {"time_s": [0.0]})


def test_parallel_directions_are_refused():
    with pytest.raises(drupe.DrupeError, match="closing, up: found"):
        drupe.jaw_poses([60.0], centre_mm=(0, 0, 0), closing=(0, 0, 1), up=(0, 0, -3))
