"""`drupe firmness` reads results alone, presses each fruit's own mesh, and changes nothing else."""

import json

import numpy as np
import pytest
from explain_runs import NO_MESH
from graded_results import graded, results_of, rows
from small_batches import batch_of_nectarines, write_ball

import pipeline.fruit.grasped
from fem.firmness.simulated_presses import spheroid_presses
from fem.firmness.trade_tests import trade_tests
from fem.indentation.compressed_ellipsoid import Ellipsoid
from pipeline.batch.layout import Results, write_whole
from pipeline.batch.opening import open_batch
from pipeline.batch.records import (
    FleshRecord,
    MeshRecord,
    ModulusRecord,
    PitRecord,
    ReferenceRecord,
    TemperatureRecord,
    write_record,
)
from pipeline.batch.task import fruit_task
from pipeline.batch.write_guard import results_lock
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog
from pipeline.run import trade_numbers
from recon.surface.mesh_file import mesh_bytes, read_mesh
from reports.html_templates import own_script

MESH = MeshRecord(
    source="fruit.ply", vertices=2562, faces=5120, volume_mm3=9e4, height_mm=56, box_mm=(56, 56, 56),
    surface_sd_mm=0.0,
)  # fmt: skip
FLESH = FleshRecord(nodes=1, tets=1, poisson_ratio=0.45, poisson_ratio_sd=0.0, poisson_ratio_source="batch")
RADIUS_MM, E_MPa = 28.0, 0.5
PIT = PitRecord(
    source="prior", volume_mm3=9e3, centre_mm=(0, 0, 0), box_mm=(25, 25, 25), thinnest_flesh_mm=9,
    flesh_volume_mm3=8e4, size_sd=0.07,
)  # fmt: skip
CHANGES = {"mesh": MESH, "flesh": FLESH}


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A ball without a pit, one that failed, and one whose mesh is gone."""
    root = tmp_path_factory.mktemp("monday") / "results"
    lost = {"outcome": "no-contact", "reason": "no contact", "modulus": None}
    changes = {"A": CHANGES, "B": lost, "C": CHANGES}
    results_of(root, [graded(name, E_MPa, changes=changed) for name, changed in changes.items()])
    write_ball(root / "ball.ply", radius_mm=RADIUS_MM, finer=4)
    write_whole(Results(root).fruit("A").fruit_ply, mesh_bytes(*read_mesh(root / "ball.ply")))
    (root / "ball.ply").unlink()
    return root


def test_a_ball_reads_what_the_table_of_spheroids_says(drupe, out):
    before = {path: path.read_bytes() for path in out.rglob("record.json")}
    done = drupe("firmness", out, "--chord", 20, 200, "--limit", "plates_5pct_N=10", status=0)
    table = rows(out, "firmness.csv")
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
    assert float(done.out.partition("E_max_MPa = ")[2].split()[0].rstrip(".")) == pytest.approx(
        at_limit, rel=2e-3
    )
    assert float(table["A"]["chord_20_200gf_gf_per_mm"]) > 0
    assert {path: path.read_bytes() for path in out.rglob("record.json")} == before
    assert table["B"]["reason"] == "no contact"
    assert "fruit.ply" in table["C"]["reason"]
    assert not table["B"]["plates_2pct_N"]
    page = (out / "firmness.html").read_text("utf-8")
    assert "FirmTech, chord from 20 to 200\u00a0gf" in page
    assert page.count("<script") == 3  # data of the charts, their library, and what draws them
    assert "://" not in page.replace(own_script("uplot.js")[0], "")  # its comment has its address
    assert page.count('class="drawn"') == 7
    drawn = json.loads(page.partition('id="charts">')[2].partition("</script>")[0])
    assert sorted(len(chart["layers"]) for chart in drawn) == [1, *[4] * 6]  # of the ball, one pit has values
    assert drupe("firmness", out, "--limit", "plates_5=1").status == 2
    (out / "firmness.csv").write_text("my own notes\n", "utf-8")
    assert "was changed since drupe wrote it" in drupe("firmness", out, status=2).err
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
    done = drupe("firmness", out, *words, status=2)
    assert said in done.err
    assert "A:" not in done.out


def test_no_results_are_refused(drupe, tmp_path):
    assert drupe("firmness", tmp_path).status == 2


@pytest.fixture
def by_table(monkeypatch):
    """The table of spheroids in the place of elements; how many fruit were asked for."""
    asked = []

    def presses(record, _folder):
        asked.append(record.fruit_id)
        return (spheroid_presses((56.0,) * 3, pit_share=0.4, poisson_ratio=0.45),)

    monkeypatch.setattr(trade_numbers, "fruit_presses", presses)
    return asked


def changed_json(path, **changes):
    """Written as drupe writes it."""
    write_whole(path, json.dumps(json.loads(path.read_text("utf-8")) | changes))


def test_every_fruit_has_a_row_and_only_fruit_without_doubt_make_a_limit(drupe, tmp_path, by_table):
    out = results_of(
        tmp_path / "results",
        [
            graded("A", E_MPa, changes=CHANGES),
            graded("B", E_MPa, changes=CHANGES, doubts=["the pit is too large."]),
            graded("C", E_MPa, changes=CHANGES, reference=True, reference_E_MPa=0.5, reference_E_sd_MPa=0.01),
            graded("D", 0.0, changes=CHANGES),
            graded("E", E_MPa, changes=CHANGES),
        ],
    )
    Results(out).fruit("E").record.write_text("{}")
    done = drupe(
        "firmness", out, "--limit", "chord_50_350gf_gf_per_mm=300", "--limit", "plates_5pct_N=10", status=0
    )
    table = rows(out, "firmness.csv")
    assert list(table) == ["A", "B", "C", "D", "E"]
    assert by_table == ["A", "B"]
    assert "reference body" in table["C"]["reason"]
    assert table["D"]["reason"] == "its E is 0 MPa"
    assert "cannot be read" in table["E"]["reason"]
    assert not table["C"]["plates_5pct_N"]
    assert table["B"]["doubt"] == "the pit is too large."
    assert {row["finished_utc"] for row in table.values()} == {"2026-08-10T12:00:00Z"}
    assert "Left out, because in doubt: B." in done.out
    assert done.out.count("one rigid contact up to twice as much") == 1
    assert "2 of 5 fruit" in done.out
    page = (out / "firmness.html").read_text("utf-8")
    for words in ("one rigid contact up to twice as much", "2026-08-10 12:00:00 UTC", "kept from turning",
                  "those of the ellipsoid", "the pit is too large",
                  "no pit, large fruit"):  # fmt: skip
        assert words in page


@pytest.mark.parametrize("factor", [None, 2.0])
def test_the_scale_is_as_uncertain_as_reference_bodies_leave_it(drupe, tmp_path, by_table, factor):
    """Verified by bodies: 1 % and not the sensor's own 20 %; a temperature's factor scales both."""
    E_MPa = 0.4
    modulus = ModulusRecord(E_MPa=0.5, E_sd_MPa=0.02, scale_sd_MPa=0.1)
    reference = ReferenceRecord(
        bodies=("R",), ratio=1.25, ratio_sd=0.01, corrected=True, E_MPa=E_MPa, E_sd_MPa=0.016,
        E_scale_sd_MPa=0.004,
    )  # fmt: skip
    changes = CHANGES | {"modulus": modulus, "reference": reference}
    if factor:
        changes["temperature"] = TemperatureRecord(
            pulp_C=10, reference_C=20, factor=factor, E_at_pulp_MPa=E_MPa, E_at_pulp_sd_MPa=0.016,
            E_MPa=factor * E_MPa, E_sd_MPa=factor * 0.016,
        )  # fmt: skip
    out = results_of(tmp_path / "results", [graded("A", 0.5, changes=changes)])
    assert drupe("firmness", out).status == 0
    expected = (factor or 1) * np.hypot(0.016, 0.004)
    assert float(rows(out, "firmness.csv")["A"]["E_sd_MPa"]) == pytest.approx(expected, rel=1e-3)


def test_what_is_done_stays_when_it_is_interrupted(drupe, tmp_path, monkeypatch):
    def presses(record, _folder):
        if record.fruit_id == "B":
            raise KeyboardInterrupt
        return (spheroid_presses((56.0,) * 3, pit_share=0.4, poisson_ratio=0.45),)

    monkeypatch.setattr(trade_numbers, "fruit_presses", presses)
    out = results_of(tmp_path / "results", [graded(name, E_MPa, changes=CHANGES) for name in "ABC"])
    assert drupe("firmness", out).status == 130
    table = rows(out, "firmness.csv")
    assert float(table["A"]["plates_5pct_N"]) > 0
    assert [table[name]["reason"] for name in "BC"] == [trade_numbers.PENDING] * 2
    assert trade_numbers.PENDING in (out / "firmness.html").read_text("utf-8")
    with results_lock(out):
        said = drupe("firmness", out)
    assert said.status == 2
    assert "another run is writing here" in said.err


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"exit_status": None}, "belongs to an unfinished run"),
        ({"outcomes": {}}, "contains no fruit's record"),
        ({"outcomes": ["A"]}, "is damaged or from another version"),
        ({"outcomes": {"../../other/A": "graded"}}, "a fruit_id that drupe never writes"),
    ],
)
def test_results_that_are_not_sound_are_refused(drupe, tmp_path, by_table, changes, words):
    out = results_of(tmp_path / "results", [graded("A", E_MPa, changes=CHANGES)])
    changed_json(Results(out).provenance, **changes)
    done = drupe("firmness", out)
    assert (done.status, by_table) == (2, [])
    assert words in done.err
    assert not (out / "firmness.csv").exists()


def test_the_pits_spread_is_the_one_that_graded_the_fruit(tmp_path, monkeypatch):
    """Stated by the batch; grading keeps it in the record, and the simulation takes it from there."""
    settings = 'category = "nectarine"\npoisson_ratio = 0.45\n[pit]\nsize_sd = 0.07\n'
    batch = batch_of_nectarines(tmp_path / "batch", "N02", pit=True, settings=settings)
    log, results = StageLog(lambda _: None), Results(batch / "results")
    task = fruit_task(open_batch(batch), "N02", results)
    task.results.claim()
    monkeypatch.setattr(pipeline.fruit.grasped, "flesh_mesh", lambda *_: NO_MESH)
    grasped = grasped_fruit(task, log)
    assert log.facts.pit.size_sd == grasped.budget.pit_size_sd == 0.07
    record = graded("N02", E_MPa, changes=CHANGES | {"pit": log.facts.pit})
    write_record(task.results.record, record)
    spreads = {}
    monkeypatch.setattr(trade_numbers, "simulated_presses", lambda *_, **how: spreads.update(how))
    trade_numbers.fruit_presses(record, task.results)
    assert spreads["pit_size_sd"] == 0.07


def test_the_page_draws_the_ball_for_large_fruit_without_a_pit_alone():
    tests = trade_tests()
    sizes = trade_numbers._sizes(tests, E_MPa=0.6)
    for test in tests:
        shown = np.isfinite(sizes.values[test.name])
        if test.under_ball:
            assert not shown[1:].any()
            assert shown[0].tolist() == [diameter >= 50 for diameter in sizes.diameters_mm]
        else:
            assert shown.sum() > 20, test.name
