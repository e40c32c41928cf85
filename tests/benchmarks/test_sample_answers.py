"""What a graded sample batch must hold beside its moduli: a watertight mesh and a heading of each fruit."""

from datetime import UTC, datetime

import trimesh
from sample_answers import missing_results

from reports.entries import BatchEntry, FruitEntry
from reports.page import report_html


def results(folder, *graded: str):
    """Meshes of two fruit, and the report of those that are graded."""
    for fruit in ("N1", "N10"):
        (folder / "fruits" / fruit).mkdir(parents=True)
        trimesh.creation.icosphere(subdivisions=1).export(folder / "fruits" / fruit / "fruit.ply")
    fruits = tuple(
        FruitEntry(fruit_id=fruit, ok=True, outcome="graded", rank=rank, E_MPa=0.3 * rank, E_sd_MPa=0.02)
        for rank, fruit in enumerate(graded, start=1)
    )
    start = datetime(2026, 11, 1, tzinfo=UTC)
    batch = BatchEntry(
        name="N1 and N10",
        category="nectarine",
        fruits=fruits,
        started_utc=start,
        finished_utc=start,
        exit_status=0,
    )
    (folder / "report.html").write_text(report_html(batch), encoding="utf-8")
    return folder


def test_a_fruit_without_a_heading_of_its_own_is_said(tmp_path):
    (said,) = missing_results(results(tmp_path, "N10"), ["N1", "N10"])
    assert said.startswith("N1: no heading of its own")


def test_a_mesh_that_is_open_or_not_there_is_said(tmp_path):
    folder = results(tmp_path, "N1", "N10")
    assert missing_results(folder, ["N1", "N10"]) == []
    (folder / "fruits" / "N10" / "fruit.ply").unlink()
    opened = trimesh.load_mesh(folder / "fruits" / "N1" / "fruit.ply")
    opened.update_faces(range(1, len(opened.faces)))
    opened.export(folder / "fruits" / "N1" / "fruit.ply")
    first, second = missing_results(folder, ["N1", "N10"])
    assert first.endswith("is not watertight")
    assert second.startswith("N10: no ")
