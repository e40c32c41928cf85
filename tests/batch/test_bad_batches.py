"""A batch that cannot be graded as a whole is refused in one line that names the file and the cause."""

import pandas as pd
import pytest
from sample_batches import drupe, drupe_alone, scale_force

from recon.surface.mesh_file import read_mesh, write_mesh


def refused(batch):
    graded = drupe("grade", "--no-screen", batch, status=2)
    line = graded.one_line_error()
    assert not (batch / "results").exists()
    checked = drupe("check", batch, status=2)
    assert line.removeprefix("drupe: ") in checked.out
    return line


def absent_model(batch):
    with (batch / "batch.toml").open("a") as file:
        file.write('[recon]\ngeometry_model = "vggt.onnx"\n')


BROKEN = {
    "no settings": (lambda b: (b / "batch.toml").unlink(), ["batch.toml: does not exist. Write one"]),
    "a case": (
        lambda b: (b / "batch.toml").rename(b / "case.toml"),
        ["this is a single case; use `drupe explain`"],
    ),
    "cut mat": (lambda b: (b / "mat.json").write_text("{"), ["mat.json"]),
    "absent model": (absent_model, ['batch.toml: "recon.geometry_model": found "vggt.onnx"']),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_batch_is_refused_by_grade_and_check(batch, name):
    change, said = BROKEN[name]
    change(batch)
    line = refused(batch)
    assert [words for words in said if words not in line] == []


@pytest.mark.slow
def test_own_pits_in_a_category_without_a_prior_need_only_poissons_ratio(batch):
    for mesh in (batch / "fruits").glob("*/fruit.ply"):
        vertices, faces = read_mesh(mesh)
        centre = vertices.mean(axis=0)
        write_mesh(mesh.with_name("pit.ply"), centre + 0.4 * (vertices - centre), faces)
    (batch / "batch.toml").write_text('category = "mango"\n')
    assert "Poisson's ratio of the flesh is unknown" in refused(batch)
    (batch / "batch.toml").write_text('category = "mango"\npoisson_ratio = 0.45\n')
    assert drupe("check", batch).status == 0


@pytest.mark.slow
def test_no_height_and_no_mat(batch):
    for mesh in (batch / "fruits").glob("*/fruit.ply"):
        mesh.unlink()
        (mesh.parent / "photos").mkdir()
    assert "fruits.csv: no fruit has a height_mm and the batch has no mat.json" in refused(batch)
    checked = drupe("check", batch)
    assert (checked.out + checked.err).count("height_mm and") == 1, "said once, not of every fruit again"
    assert "has no height_mm," not in checked.out + checked.err


def test_wrong_usage_is_status_two_without_a_traceback():
    ran = drupe_alone("grade")
    assert ran.status == 2
    assert "Traceback" not in ran.err
    assert "BATCH" in ran.err


def test_results_that_cannot_be_written(batch, tmp_path):
    (tmp_path / "taken").write_text("a file, not a folder")
    ran = drupe("grade", batch, "--out", tmp_path / "taken", status=2)
    assert "is a file; choose another place with --out" in ran.one_line_error()


def test_check_says_that_forces_are_in_another_unit(batch):
    path = next((batch / "fruits").glob("*/grasps/grasp-1.h5"))
    scale_force(path, 101.97)
    ran = drupe("check", batch, status=2)
    assert str(path) in ran.out
    assert "grams" in ran.out


def test_check_says_what_is_wrong_with_table_and_fruit_together(batch):
    table = pd.read_csv(batch / "fruits.csv", dtype=str)
    more = pd.DataFrame({"fruit_id": ["GONE", "BAD"], "height_mm": [None, "tall"]})
    pd.concat([table, more]).to_csv(batch / "fruits.csv", index=False)
    (batch / "fruits" / "STRAY").mkdir()
    said = drupe("check", batch).out
    for words in ('height_mm is "tall"', "GONE: does not exist", "STRAY: is not in fruits.csv"):
        assert words in said
