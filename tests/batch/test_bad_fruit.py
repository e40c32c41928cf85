"""A fruit that cannot be graded ends with its reason, costs no other fruit, and is known to `drupe check`."""

import shutil

import cv2
import h5py
import numpy as np
import pandas as pd
import pytest
from sample_batches import SHIPPED, drupe, ready_batch, record_of, scale_force

from recon.surface.mesh_file import read_mesh, write_mesh

pytestmark = pytest.mark.slow


def spoiled_photos(where):
    shutil.rmtree(where)
    photos = where / "photos"
    photos.mkdir(parents=True)
    source = next((SHIPPED / "fruits").iterdir()) / "photos"
    return photos, sorted(source.iterdir())


def corrupt_jpeg(where):
    photos, source = spoiled_photos(where)
    for path in source[:6]:
        shutil.copy(path, photos)
    broken = photos / source[3].name
    broken.write_bytes(b"\xff\xd8 this is no photo")


def two_photos(where):
    photos, source = spoiled_photos(where)
    for path in source[:2]:
        shutil.copy(path, photos)


def photos_without_fruit(where):
    photos, _ = spoiled_photos(where)
    rng = np.random.default_rng(1)
    for i in range(6):
        table = rng.normal(120, 10, (240, 320, 3)).clip(0, 255).astype(np.uint8)
        cv2.imwrite(str(photos / f"{i}.jpg"), table)


def change_recording(change):
    def spoil(where):
        with h5py.File(where / "grasps" / "grasp-1.h5", "r+") as file:
            change(file)

    return spoil


@change_recording
def wrong_version(file):
    file.attrs["version"] = 7


@change_recording
def nan_in_force(file):
    file["pads/left/force_N"][3, 5, 2] = np.nan


def truncated(where):
    path = where / "grasps" / "grasp-1.h5"
    path.write_bytes(path.read_bytes()[:20_000])


def noise_alone(**sd):
    """A change that leaves noise of this standard deviation in the named fields of both pads."""

    @change_recording
    def change(file):
        for pad in ("left", "right"):
            for name, noise in sd.items():
                field = file[f"pads/{pad}/{name}"]
                field[:] = np.random.default_rng(2).normal(0, noise, field.shape)

    return change


def open_mesh(where):
    vertices, faces = read_mesh(where / "fruit.ply")
    write_mesh(where / "fruit.ply", vertices, faces[40:])


def pit_too_large(where):
    vertices, faces = read_mesh(where / "fruit.ply")
    centre = vertices.mean(axis=0)
    write_mesh(where / "pit.ply", centre + 1.1 * (vertices - centre), faces)


def foreign_name(where):
    path = where / "grasps" / "grasp-1.h5"
    path.rename(path.with_name(b"grasp-\xff1.h5".decode(errors="surrogateescape")))


IN_AIR = {"force_N": 0.008, "displacement_mm": 0.004}
SPOILED = {
    "corrupt-jpeg": (corrupt_jpeg, "unreadable-photo", ".jpg", True),
    "two-photos": (two_photos, "too-few-views", "2 ", True),
    "no-fruit-in-photos": (photos_without_fruit, "mat-not-found", "mat", False),
    "truncated": (truncated, "unreadable-recording", "grasp-1.h5", True),
    "wrong-version": (wrong_version, "unreadable-recording", "version", True),
    "nan-force": (nan_in_force, "unreadable-recording", "force_N", True),
    "never-touches": (noise_alone(**IN_AIR), "never-touches", "never touches", False),
    "dead-force": (noise_alone(force_N=0.008), "implausible-recording", "force is dead", True),
    "open-mesh": (open_mesh, "not-watertight", "fruit.ply", True),
    "large-pit": (pit_too_large, "pit-outside-fruit", "pit", False),
    "foreign-name": (foreign_name, "unreadable-recording", r"grasp-\xff1.h5", True),
    "no-folder": (shutil.rmtree, "no-shape", "no-folder", True),
    "no-grasp": (lambda where: shutil.rmtree(where / "grasps"), "no-grasp", "grasps", True),
}
"""Name -> (what is done to the fruit, its outcome, what its reason names, whether reading files shows it)."""


@pytest.fixture(scope="module")
def spoiled(tmp_path_factory):
    """One good fruit and one for each way of going wrong, graded and checked once."""
    folder = ready_batch(tmp_path_factory.mktemp("spoiled") / "batch", 1)
    shutil.copy(SHIPPED / "mat.json", folder)
    good = next((folder / "fruits").iterdir())
    height_mm = np.ptp(read_mesh(good / "fruit.ply")[0][:, 2])
    rows = ["fruit_id,height_mm", f"{good.name},{height_mm:.1f}"]
    for number, (name, (spoil, *_)) in enumerate(SPOILED.items(), 1):
        where = folder / "fruits" / name
        shutil.copytree(good, where)
        with h5py.File(where / "grasps" / "grasp-1.h5", "r+") as file:
            file.attrs["fruit_id"] = name
        scale_force(where / "grasps" / "grasp-1.h5", 1 + 0.001 * number)
        spoil(where)
        rows.append(f"{name},{height_mm:.1f}")
    (folder / "fruits.csv").write_text("\n".join(rows) + "\n")
    return folder, good.name, drupe("grade", "--no-screen", folder), drupe("check", folder)


def test_the_run_says_that_some_fruit_are_not_graded(spoiled):
    _, _, graded, _ = spoiled
    assert graded.status == 3
    assert "Traceback" not in graded.err + graded.out


def test_the_good_fruit_is_graded_beside_all_the_spoiled_ones(spoiled):
    folder, good, _, _ = spoiled
    ranking = pd.read_csv(folder / "results" / "ranking.csv", dtype={"fruit_id": str}).set_index("fruit_id")
    assert ranking.index[0] == good
    assert ranking.loc[good, "outcome"] == "graded"
    assert ranking.loc[good, "E_MPa"] > 0
    assert len(ranking) == 1 + len(SPOILED)


@pytest.mark.parametrize("name", SPOILED)
def test_a_spoiled_fruit_ends_with_its_reason(spoiled, name):
    folder, _, graded, _ = spoiled
    _, outcome, names, _ = SPOILED[name]
    ranking = pd.read_csv(folder / "results" / "ranking.csv", dtype={"fruit_id": str}).set_index("fruit_id")
    row = ranking.loc[name]
    assert row["outcome"] == outcome, row["reason"]
    assert names in row["reason"]
    assert np.isnan(row["E_MPa"])
    assert record_of(folder / "results", name)["outcome"] == outcome
    said = [line for line in graded.out.splitlines() if line.startswith(f"not graded: {name}:")]
    assert len(said) == 1
    assert names in said[0]


@pytest.mark.parametrize("name", [n for n, (*_, by_reading) in SPOILED.items() if by_reading])
def test_check_finds_what_reading_can_find(spoiled, name):
    folder, _, _, checked = spoiled
    assert checked.status == 2
    said = [line for line in checked.out.splitlines() if str(folder / "fruits" / name) in line]
    assert said
    assert any(SPOILED[name][2] in line for line in said)


def test_check_does_not_blame_the_good_fruit(spoiled):
    folder, good, _, checked = spoiled
    assert str(folder / "fruits" / good) not in checked.out


def test_the_report_lists_failures_before_the_ranking(spoiled):
    folder, good, _, _ = spoiled
    page = (folder / "results" / "report.html").read_text()
    assert page.index("never-touches") < page.index("Ranking") < page.rindex(good)
