"""Reports anew from what a run kept."""

import json

import pytest
from graded_results import graded, results_of, rows
from small_batches import CLASSES, batch_of_balls

from pipeline.batch.records import ScreenRecord


@pytest.fixture
def batch(tmp_path):
    return batch_of_balls(tmp_path / "batch", "A", "B")


@pytest.fixture
def results(batch):
    return results_of(batch / "results", [graded("A", 0.3), graded("B", 0.8)])


def test_classes_of_now_are_in_the_report_anew(drupe, batch, results):
    assert drupe("report", results).status == 0
    assert rows(results)["A"]["maturity"] == ""
    (batch / "batch.toml").write_text(CLASSES)
    assert drupe("report", results).status == 0
    assert {name: row["maturity"] for name, row in rows(results).items()} == {"A": "soft", "B": "firm"}
    assert {name: row["decision"] for name, row in rows(results).items()} == {"A": "ship", "B": "hold"}
    page = (results / "report.html").read_text()
    assert "Started 2026-08-10 12:00:00 UTC" in page
    table = json.loads((results / "ranking.json").read_text())
    assert [row["fruit_id"] for row in table] == ["A", "B"]
    assert [row["E_MPa"] for row in table] == [float(row["E_MPa"]) for row in rows(results).values()]


@pytest.mark.parametrize(
    ("setting", "decision"),
    [
        ("", "inspect"),
        ("inspect_below_p = 1e-50", "ship"),
        ("inspect_below_p = 0.5\ncertainty = 0.99", "inspect"),
    ],
)
def test_settings_of_now_decide_and_the_reason_is_on_page_and_terminal(drupe, batch, setting, decision):
    skin = {"effect": "skin", "E_ratio": 1.2, "added_sd": 0.02}
    screen = {"p_value": 6e-41, "names": ("skin",), "suspected": (skin,)}
    screened = graded("A", 0.3, sd=1 / 30).model_copy(update={"screen": ScreenRecord.model_validate(screen)})
    results = results_of(batch / "results", [screened, graded("B", 0.8)])
    (batch / "batch.toml").write_text(CLASSES.replace("\n", f"\n[grading]\n{setting}\n", 1))
    done = drupe("report", results)
    assert rows(results)["A"]["decision"] == decision
    reason = (
        "missing physics suspected: skin (p = 6.0e-41), E is 0.300 ± 0.010 MPa (soft) without it and 0.360 ± "
        "0.014 MPa (soft) with it"
    )
    for said in (
        rows(results)["A"]["decision_reason"],
        done.out.replace("\u00a0", " "),
        (results / "report.html").read_text().replace("\u00a0", " "),
    ):
        assert (reason in said) == (decision == "inspect")


def test_a_batch_of_which_no_class_is_shipped_says_so(drupe, batch, results):
    (batch / "batch.toml").write_text(CLASSES.replace("0.5\n", "0.5\nship = false\n"))
    assert "no class is shipped, so all fruit are held" in drupe("report", results).out
    assert {row["decision"] for row in rows(results).values()} == {"hold"}
    assert "No class is shipped" in (results / "report.html").read_text()


def test_fruit_that_were_graded_without_a_row_are_in_the_report_and_stray_folders_are_not(
    drupe, batch, results
):
    (batch / "fruits.csv").write_text("fruit_id\nA\n")
    (batch / "fruits" / "stray").mkdir()
    assert drupe("report", results).status == 0
    assert set(rows(results)) == {"A", "B"}


def test_of_an_interrupted_run_the_page_says_so(drupe, batch):
    results = results_of(batch / "results", [graded("A", 0.3)], status=130)
    ran = drupe("report", results)
    assert ran.status == 3
    assert "some fruit are not graded yet" in ran.out
    assert "Interrupted:</b> 1 of 2 fruit" in (results / "report.html").read_text()


def test_a_batch_that_moved_is_named(drupe, batch, results, tmp_path):
    moved = tmp_path / "elsewhere"
    kept = tmp_path / "kept"
    results.rename(kept)
    batch.rename(moved)
    ran = drupe("report", kept)
    assert ran.status == 2
    assert "which does not exist; give the batch with --batch" in ran.err
    assert drupe("report", kept, "--batch", moved).status == 0


def test_what_is_no_result_is_refused(drupe, batch, results):
    ran = drupe("report", batch)
    assert ran.status == 2
    assert "contains no results of drupe grade (batch.json); did you mean" in ran.err


def test_results_that_do_not_exist_are_those_that_were_likely_meant(drupe, results):
    ran = drupe("report", results.with_name(f"{results.name}x"))
    assert ran.status == 2
    assert f'{results.name}x: does not exist; did you mean "{results.name}"?' in ran.err
