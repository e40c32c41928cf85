"""What a run says and keeps of fruit, and reports anew from what it kept."""

import html
import json
import math
from dataclasses import fields
from datetime import UTC, datetime

import pytest
from graded_results import graded, results_of, rows, work_at_once, written
from rich.console import Console
from small_batches import CLASSES, batch_of_balls, empty_batch, write_ball

from pipeline.batch.layout import Results, write_whole
from pipeline.batch.opening import open_batch
from pipeline.batch.outcome import Outcome
from pipeline.batch.records import ScreenRecord, read_record, write_record
from pipeline.batch.task import fruit_task
from pipeline.fruit.stages import grade_fruit
from pipeline.problem import BatchRefused
from pipeline.ranking.batch_faults import BatchFault
from pipeline.ranking.report_entries import _QUALITY, _flat, _shown
from pipeline.run import grading as grading
from pipeline.run import reporting
from pipeline.run.batch_run import BatchRun, GradeOptions
from pipeline.run.fruit_queue import ended_record
from pipeline.run.reporting import ReportPace, report_so_far
from recon.checks.quality import ReconQuality
from reports.grasp_record import GraspRecord

SOUND = "fruit_id,mass_g\nA,90\nB,90\n"
ONE_IN_KG = "fruit_id,mass_g\nA,0.09\nB,90\n"
ALL_IN_KG = "fruit_id,mass_g\nA,0.09\nB,0.09\n"
IN_KPA = '[[grading.classes]]\nname = "soft"\nE_max_MPa = 300\n[[grading.classes]]\nname = "firm"\n'
FILES = ("fruit.ply", "pit.ply", "mesh.webp")


@pytest.fixture
def batch(tmp_path):
    return batch_of_balls(tmp_path, "A", "B", table=SOUND)


@pytest.fixture
def run(batch, monkeypatch):
    """Grades the batch; the work on a fruit is replaced by one that writes a modulus and files at once."""
    worked = []

    def record_of(fruit_id, task):
        worked.append(fruit_id)
        task.results.claim()
        task.results.forget()
        for name in FILES:
            write_whole(task.results.root / name, name)
        screen = ScreenRecord(p_value=0.4) if task.screen else None
        changes = {"warnings": ("a pit", "w"), "screen": screen}
        return written(task, 0.5, sd=0.04, doubts=["a pit"] * (fruit_id == "B"), changes=changes)

    monkeypatch.setattr(grading, "_work", work_at_once(record_of))

    def grade(table=SOUND, classes="", **options):
        worked.clear()
        (batch / "fruits.csv").write_text(table)
        (batch / "batch.toml").write_text(f'category = "nectarine"\n{classes}')
        console = Console(quiet=True)
        how = GradeOptions(jobs=1, time_limit_s=60, **options)
        status, _ = grading.grade(batch, None, how, console=console)
        return status, "".join(worked), rows(batch / "results")

    return grade


def held(batch, name):
    folder = batch / "results" / "fruits" / name
    there = [file for file in FILES if (folder / file).is_file()]
    return there, read_record(folder / "record.json")


def test_what_is_forced_stands_in_record_table_page_status_and_provenance(batch, run):
    status, _, rows = run(ALL_IN_KG, IN_KPA, force=True)
    assert status == 4
    page = (batch / "results" / "report.html").read_text()
    for name in ("A", "B"):
        doubts = held(batch, name)[1].doubts
        assert held(batch, name)[1].warnings[: len(doubts)] == doubts
        for said in ("mass_g of all 2 fruit is 0.09", 'E_max_MPa of "soft" is 300'):
            (doubt_said,) = [doubt for doubt in doubts if said in doubt]
            assert doubt_said.endswith("drupe grades the fruit anyway (--force).")
            assert said in rows[name]["doubts"]
    assert "mass_g of all 2 fruit is 0.09" in page
    assert "(--force). This widens its error bar" not in page
    assert page.count("a pit This widens its error bar") == 1
    provenance = batch / "results" / "batch.json"
    assert json.loads(provenance.read_text())["force"] is True
    assert run(ALL_IN_KG, IN_KPA, force=True)[2] == rows  # said once, however often it is run

    status, worked, rows = run()
    assert (worked, rows["A"]["doubts"], rows["B"]["doubts"]) == ("", "", "a pit")
    assert held(batch, "A")[1].warnings == ("a pit", "w")
    assert json.loads(provenance.read_text())["force"] is False
    assert "--force" not in (batch / "results" / "report.html").read_text()


def test_a_recording_of_two_fruit_is_doubted_in_table_page_and_record_while_both_have_it(batch, run):
    run()

    def recorded(**digests):
        for name, digest in digests.items():
            graded_record = held(batch, name)[1]
            grasps = (GraspRecord(grasp="grasp-1", digest=digest),)
            path = batch / "results" / "fruits" / name / "record.json"
            write_record(path, graded_record.model_copy(update={"grasps": grasps}))

    recorded(A="same", B="same")
    status, worked, rows = run()
    assert (status, worked) == (4, "")
    said = "grasp-1: contains the same displacements and forces as fruits/{}/grasps/grasp-1. At least one"
    page = html.unescape((batch / "results" / "report.html").read_text())
    for name, other in ("AB", "BA"):
        kept = held(batch, name)[1]
        assert kept.doubts[0].startswith(said.format(other))
        assert kept.warnings[0] == kept.doubts[0]
        assert kept.modulus.E_sd_MPa == 0.02  # as measured
        assert rows[name]["doubts"].startswith(kept.doubts[0])
        assert float(rows[name]["E_sd_MPa"]) == pytest.approx(math.hypot(0.02, 0.35 * 0.5), rel=1e-3)
        assert kept.doubts[0] in page
    assert run()[2] == rows  # said once, however often it is run
    recorded(B="its own")
    _, _, rows = run()
    assert (held(batch, "A")[1].doubts, held(batch, "B")[1].doubts) == ((), ("a pit",))
    assert (rows["A"]["doubts"], float(rows["A"]["E_sd_MPa"])) == ("", 0.02)


TWO_CLASSES = '[[grading.classes]]\nname = "soft"\nE_max_MPa = 0.9\n[[grading.classes]]\nname = "firm"\n'


def test_a_fruit_whose_E_is_in_doubt_has_no_class_and_the_others_have(batch, run):
    """0.5 of 0.02 MPa below a limit of 0.9: sure by its error bar, which does not cover what is doubted."""
    status, _, rows = run(SOUND, TWO_CLASSES)
    assert status == 4
    assert (rows["A"]["maturity"], float(rows["A"]["maturity_probability"])) == ("soft", pytest.approx(1.0))
    assert [rows["B"][name] for name in ("maturity", "maturity_probability", "doubts")] == ["", "", "a pit"]
    assert (rows["B"]["E_MPa"], rows["B"]["rank"]) == ("0.5", "2")
    page = (batch / "results" / "report.html").read_text()
    assert 'withheld <span class="soft">E in doubt</span>' in page
    assert page.count("class withheld because E is in doubt") == 1


def test_a_fruit_whose_numbers_no_fruit_has_is_graded_when_forced_and_refused_otherwise(batch, run):
    status, worked, rows = run(ONE_IN_KG, force=True)
    assert (status, worked, rows["A"]["outcome"]) == (4, "AB", "graded")
    assert "mass_g 0.09: a nectarine is 18 to 650 g" in rows["A"]["doubts"]
    status, worked, rows = run(ONE_IN_KG)
    assert (status, worked) == (3, "")
    assert (rows["A"]["outcome"], rows["A"]["E_MPa"]) == ("implausible-input", "")
    reason = rows["A"]["reason"]
    assert reason.startswith("mass_g 0.09: a nectarine is 18 to 650 g in mass; is it in kg (90 g)?")
    assert "--force" in reason
    _, worked, rows = run()
    assert (worked, rows["A"]["outcome"], rows["A"]["doubts"]) == ("A", "graded", "")


def test_results_of_other_inputs_do_not_stay_beside_a_refused_fruit(batch, run):
    run()
    write_ball(batch / "fruits" / "A" / "fruit.ply", radius_mm=29)
    _, worked, rows = run(ONE_IN_KG)
    assert (worked, rows["A"]["outcome"]) == ("", "implausible-input")
    files, record = held(batch, "A")
    assert files == []
    assert record.modulus is None
    assert run()[1] == "A"


def test_a_ranking_saved_by_a_spreadsheet_is_kept_and_one_step_gives_a_new_one(batch, run):
    _, _, rows = run()
    ranking, edited = batch / "results" / "ranking.csv", batch / "results" / "ranking, ours.csv"
    ranking.write_bytes(ranking.read_bytes().replace(b",", b";"))
    with pytest.raises(BatchRefused) as refused:
        run()
    assert str(refused.value) == (
        f"{ranking}: was changed since drupe wrote it (opening it in a spreadsheet and saving is enough), so "
        "it is not overwritten; rename it or move it away, which keeps your changes, and run the same "
        "command again: it writes a new ranking.csv. Or choose another place with --out."
    )
    ranking.rename(edited)
    _, worked, again = run()
    assert (worked, again) == ("", rows)  # nothing is computed anew
    assert b";" in edited.read_bytes()


def test_a_fruit_that_was_not_screened_is_graded_anew_by_a_run_that_screens(batch, run):
    _, worked, rows = run(screen=False)
    assert (worked, rows["A"]["screen"], rows["A"]["mismatch"]) == ("AB", "", "")
    assert json.loads((batch / "results" / "batch.json").read_text())["screened"] is False
    _, worked, rows = run()
    assert (worked, rows["A"]["screen"], rows["A"]["screen_p"]) == ("AB", "none", "0.4")
    assert (rows["A"]["mismatch"], rows["A"]["mismatch_by"]) == ("none", "screen")
    assert run()[1] == ""
    _, worked, again = run(screen=False)
    assert (worked, again) == ("", rows)  # what is known stays
    path = batch / "results" / "fruits" / "B" / "record.json"
    failed = ScreenRecord(failure="no memory", again=True)
    write_record(path, held(batch, "B")[1].model_copy(update={"screen": failed}))
    assert run()[1] == "B"  # and what may come out otherwise is tried again


def test_a_fault_of_the_whole_batch_stands_in_report_and_provenance(batch, run, monkeypatch):
    fault = BatchFault(
        effect="sensor_gain", pad="left", parameter="gain", value=0.04, sd=0.001, between_sd=0.0,
        p_value=1e-6, shown_by=("A", "B"), fruit=2, sentence="The left pad reads 4 % too much force.",
    )  # fmt: skip
    monkeypatch.setattr(reporting, "batch_faults", lambda records: (fault,))
    run()
    page = (batch / "results" / "report.html").read_text()
    assert page.count(fault.sentence) == 1
    assert page.index(fault.sentence) < page.index("Ranking, softest first")
    (kept,) = json.loads((batch / "results" / "batch.json").read_text())["faults"]
    assert (kept["effect"], kept["pad"], kept["shown_by"]) == ("sensor_gain", "left", ["A", "B"])


def test_page_and_table_are_there_from_the_first_fruit_on(batch):
    opened, results = open_batch(batch), Results(batch / "results")
    run = BatchRun(
        batch=opened, results=results, inputs={}, options=GradeOptions(),
        started=datetime(2026, 8, 14, tzinfo=UTC), since_s=0.0,
    )  # fmt: skip
    results.claim()
    assert report_so_far(run, {}) is None
    assert not results.report.exists()
    records = {"B": graded("B", 0.4)}
    report_so_far(run, records)
    assert "Still running:</b> 1 of 2 fruit are finished" in results.report.read_text()
    assert list(rows(results.root)) == ["B"]


def test_reports_while_a_run_goes_on_take_a_hundredth_of_its_time():
    now = [200.0]
    pace = ReportPace(lambda: now[0])
    assert pace.due()
    with pace.reporting():
        now[0] += 0.05
    for later, due in ((1.0, False), (4.0, False), (6.0, True)):  # 0.05 s are 1 % of 5 s
        now[0] = 200.05 + later
        assert pace.due() is due


@pytest.fixture
def kept_batch(tmp_path):
    return batch_of_balls(tmp_path / "batch", "A", "B")


@pytest.fixture
def results(kept_batch):
    return results_of(kept_batch / "results", [graded("A", 0.3), graded("B", 0.8)])


def test_classes_of_now_are_in_the_report_anew(drupe, kept_batch, results):
    assert drupe("report", results).status == 0
    assert rows(results)["A"]["maturity"] == ""
    (kept_batch / "batch.toml").write_text(CLASSES)
    assert drupe("report", results).status == 0
    assert {name: row["maturity"] for name, row in rows(results).items()} == {"A": "soft", "B": "firm"}
    assert {name: row["decision"] for name, row in rows(results).items()} == {"A": "ship", "B": "hold"}
    page = (results / "report.html").read_text()
    assert "Started 2026-08-10 12:00:00 UTC, finished 2026-08-10 12:00:00 UTC" in page
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
def test_settings_of_now_decide_and_the_reason_is_on_page_and_terminal(drupe, kept_batch, setting, decision):
    skin = {"effect": "skin", "E_ratio": 1.2, "added_sd": 0.02}
    screen = {"p_value": 6e-41, "names": ("skin",), "suspected": (skin,)}
    screened = graded("A", 0.3, sd=1 / 30).model_copy(update={"screen": ScreenRecord.model_validate(screen)})
    results = results_of(kept_batch / "results", [screened, graded("B", 0.8)])
    (kept_batch / "batch.toml").write_text(CLASSES.replace("\n", f"\n[grading]\n{setting}\n", 1))
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


def test_a_batch_of_which_no_class_is_shipped_says_so(drupe, kept_batch, results):
    (kept_batch / "batch.toml").write_text(CLASSES.replace("0.5\n", "0.5\nship = false\n"))
    assert "no class is shipped, so all fruit are held" in drupe("report", results).out
    assert {row["decision"] for row in rows(results).values()} == {"hold"}
    assert "No class is shipped" in (results / "report.html").read_text()


def test_fruit_that_were_graded_without_a_row_are_in_the_report_and_stray_folders_are_not(
    drupe, kept_batch, results
):
    (kept_batch / "fruits.csv").write_text("fruit_id\nA\n")
    (kept_batch / "fruits" / "stray").mkdir()
    assert drupe("report", results).status == 0
    assert set(rows(results)) == {"A", "B"}


def test_of_an_interrupted_run_the_page_says_so(drupe, kept_batch):
    results = results_of(kept_batch / "results", [graded("A", 0.3)], status=130)
    assert "some fruit are not graded yet" in drupe("report", results, status=3).out
    assert "Interrupted:</b> 1 of 2 fruit" in (results / "report.html").read_text()


def test_a_batch_that_moved_is_named(drupe, kept_batch, results, tmp_path):
    moved = tmp_path / "elsewhere"
    kept = tmp_path / "kept"
    results.rename(kept)
    kept_batch.rename(moved)
    assert "which does not exist; give the batch with --batch" in drupe("report", kept, status=2).err
    assert drupe("report", kept, "--batch", moved).status == 0


def test_what_is_no_result_is_refused(drupe, kept_batch, results):
    ran = drupe("report", kept_batch, status=2)
    assert "contains no results of drupe grade (batch.json); did you mean" in ran.err


def test_results_that_do_not_exist_are_those_that_were_likely_meant(drupe, results):
    ran = drupe("report", results.with_name(f"{results.name}x"), status=2)
    assert f'{results.name}x: does not exist; did you mean "{results.name}"?' in ran.err


def test_every_measure_of_a_mesh_has_words():
    assert {field.name for field in fields(ReconQuality)} == set(_QUALITY)


def test_settings_are_written_as_a_reader_does():
    settings = {
        "recon": {"fruit_model": True, "providers": ["CPU", "GPU"]},
        "mismatch": [],
        "grading": {"classes": [{"name": "ripe", "E_max_MPa": 0.3}, {"name": "firm"}]},
    }
    assert _flat(settings) == [
        ("recon.fruit_model", "yes"),
        ("recon.providers", "CPU, GPU"),
        ("mismatch", "none"),
        ("grading.classes 1: name", "ripe"),
        ("grading.classes 1: E_max_MPa", "0.3"),
        ("grading.classes 2: name", "firm"),
    ]


def test_figures_have_three_digits_and_switches_are_words():
    assert [_shown(value) for value in (0.012345, 1861.4, 24, False)] == ["0.0123", "1861", "24", "no"]


@pytest.fixture
def task(tmp_path):
    root = empty_batch(tmp_path / "monday", "A", table="fruit_id,height_mm\nA,56\n")
    return fruit_task(open_batch(root), "A", Results(root / "results"))


def test_the_fruits_own_files_are_named_from_the_batchs_folder_on(task):
    reason = grade_fruit(task, lambda _: None).reason
    assert reason.startswith("fruits/A holds neither photos nor fruit.ply")
    task.folder.fruit_ply.write_text("ply of nothing")
    assert grade_fruit(task, lambda _: None).reason.startswith("The mesh fruits/A/fruit.ply is broken")


def test_a_file_outside_the_batch_keeps_its_whole_path(task, tmp_path):
    inside, outside = task.batch_root / "results" / "one.png", f"/mnt{task.batch_root}/one.png"
    said = ended_record(task, Outcome.NOT_WRITTEN, f"{outside} and {inside}: No space left on device.").reason
    assert f"{outside} and results/one.png: No space" in said


@pytest.mark.parametrize("before", ["", "of ", "(", '"', "'", "[", "`", "file:", "path=", "['"])
def test_a_file_is_named_from_the_folder_on_whatever_mark_stands_before_it(task, before):
    said = task.named_in_batch(f"{before}{task.batch_root}/fruits/A/one.png")
    assert said == f"{before}fruits/A/one.png"
