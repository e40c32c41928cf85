"""What a graded sample batch must hold beside its moduli: a watertight mesh and a heading of each fruit."""

import trimesh
from sealed_truths import put_on_path

put_on_path()
from sample_answers import missing_results  # noqa: E402


def results(folder, *headings: str):
    for fruit in ("N1", "N10"):
        (folder / "fruits" / fruit).mkdir(parents=True)
        trimesh.creation.icosphere(subdivisions=1).export(folder / "fruits" / fruit / "fruit.ply")
    page = "".join(f'<h3 id="f">{one}</h3>' for one in headings)
    (folder / "report.html").write_text(f"<p>N1 N10</p>{page}", encoding="utf-8")
    return folder


def test_whole_results_lack_nothing(tmp_path):
    assert missing_results(results(tmp_path, "N1 ripe", "N10"), ["N1", "N10"]) == []


def test_a_fruit_without_a_heading_of_its_own_is_said(tmp_path):
    (said,) = missing_results(results(tmp_path, "N10"), ["N1", "N10"])
    assert said.startswith("N1: no heading of its own")


def test_a_mesh_that_is_open_or_not_there_is_said(tmp_path):
    folder = results(tmp_path, "N1", "N10")
    (folder / "fruits" / "N10" / "fruit.ply").unlink()
    opened = trimesh.load_mesh(folder / "fruits" / "N1" / "fruit.ply")
    opened.update_faces(range(1, len(opened.faces)))
    opened.export(folder / "fruits" / "N1" / "fruit.ply")
    first, second = missing_results(folder, ["N1", "N10"])
    assert first.endswith("is not watertight")
    assert second.startswith("N10: no ")


def test_a_missing_page_is_said(tmp_path):
    folder = results(tmp_path)
    (folder / "report.html").unlink()
    assert missing_results(folder, ["N1"]) == [f"no {folder / 'report.html'}"]
