"""`drupe firmness` reads results alone, presses each fruit's own mesh, and changes nothing else."""

import csv

import numpy as np
import pytest
from graded_results import graded, results_of
from small_batches import write_ball

from fem.indentation.compressed_ellipsoid import Ellipsoid
from pipeline.batch.layout import Results, write_whole
from pipeline.batch.records import FleshRecord, MeshRecord
from recon.surface.mesh_file import mesh_bytes, read_mesh

MESH = MeshRecord(
    source="fruit.ply", vertices=2562, faces=5120, volume_mm3=9e4, height_mm=56, box_mm=(56, 56, 56),
    surface_sd_mm=0.0,
)  # fmt: skip
FLESH = FleshRecord(nodes=1, tets=1, poisson_ratio=0.45, poisson_ratio_sd=0.0, poisson_ratio_source="batch")
RADIUS_MM, E_MPa = 28.0, 0.5


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A ball without a pit, one that failed, and one whose mesh is gone."""
    root = tmp_path_factory.mktemp("monday") / "results"
    changes = {"mesh": MESH, "flesh": FLESH}
    lost = {"outcome": "no-contact", "reason": "no contact", "modulus": None}
    results_of(
        root,
        [
            graded("A", E_MPa, changes=changes),
            graded("B", E_MPa, changes=lost),
            graded("C", E_MPa, changes=changes),
        ],
    )
    write_ball(root / "ball.ply", radius_mm=RADIUS_MM, finer=4)
    write_whole(Results(root).fruit("A").fruit_ply, mesh_bytes(*read_mesh(root / "ball.ply")))
    (root / "ball.ply").unlink()
    return root


def rows(out):
    lines = (out / "firmness.csv").read_text("utf-8").splitlines()
    return {row["fruit_id"]: row for row in csv.DictReader(lines)}


def test_a_ball_reads_what_the_table_of_spheroids_says(drupe, out):
    before = {path: path.read_bytes() for path in out.rglob("record.json")}
    done = drupe("firmness", out, "--chord", 20, 200, "--limit", "plates_5pct_N=10")
    assert done.status == 0, done.err
    table = rows(out)
    curve = Ellipsoid(diameters_mm=(56.0,) * 3, axis=0, pit_share=0.0).curve(
        thickness_mm=None, poisson_ratio=0.45
    )
    for percent in (2, 5):
        depth = percent / 100 * 2 * RADIUS_MM
        force = E_MPa * float(curve.force_N_per_MPa(np.array(depth)))
        assert float(table["A"][f"plates_{percent}pct_N"]) == pytest.approx(force, rel=0.02)
        assert float(table["A"][f"plates_{percent}pct_N_per_mm"]) == pytest.approx(force / depth, rel=0.02)
        spread = float(table["A"][f"plates_{percent}pct_N_sd"]) / force
        assert 0.05 < spread < 0.06  # of E, and a little of the method
    at_limit = float(table["A"]["E_MPa_at_10_plates_5pct_N"])
    assert at_limit == pytest.approx(E_MPa * 10 / float(table["A"]["plates_5pct_N"]), rel=2e-3)
    assert f"E_max_MPa = {at_limit:.3g}" in done.out
    assert float(table["A"]["chord_20_200gf_gf_per_mm"]) > 0
    assert {path: path.read_bytes() for path in out.rglob("record.json")} == before
    assert table["B"]["reason"] == "no contact"
    assert "fruit.ply" in table["C"]["reason"]
    assert not table["B"]["plates_2pct_N"]
    page = (out / "firmness.html").read_text("utf-8")
    assert "FirmTech, chord from 20 to 200 gf" in page
    assert "<script" not in page
    assert "://" not in page
    assert page.count('role="img"') == 7
    assert drupe("firmness", out, "--limit", "plates_5=1").status == 2
    (out / "firmness.csv").write_text("my own notes\n", "utf-8")
    again = drupe("firmness", out)
    assert again.status == 2
    assert "was changed since drupe wrote it" in again.err
    assert (out / "firmness.csv").read_text("utf-8") == "my own notes\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--limit", "plates_5pct=1"), 'found "plates_5pct=1"'),
        (("--limit", "plates_5pct_N=soft"), "expected plates_5pct_N=NUMBER, above 0"),
        (("--chord", "300", "50"), "expected 0 <= first < second"),
        (("--ball-force", "0"), "expected 0 <= first < second, 0 < N"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_simulated(drupe, out, words, said):
    done = drupe("firmness", out, *words)
    assert done.status == 2
    assert said in done.err
    assert "A:" not in done.out


def test_no_results_are_refused(drupe, tmp_path):
    assert drupe("firmness", tmp_path).status == 2
