"""What a run says and keeps of fruit whose numbers cannot be, or whose modulus does not count."""

import html
import json
import math
from datetime import UTC, datetime

import pytest
from graded_results import graded, rows, work_at_once, written
from rich.console import Console
from small_batches import batch_of_balls, write_ball

from pipeline.batch.layout import Results, write_whole
from pipeline.batch.opening import open_batch
from pipeline.batch.records import ScreenRecord, read_record, write_record
from pipeline.problem import BatchRefused
from pipeline.ranking.batch_faults import BatchFault
from pipeline.run import grading as grading
from pipeline.run import reporting
from pipeline.run.batch_run import BatchRun, GradeOptions
from pipeline.run.reporting import ReportPace, report_so_far
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


CLASSES = '[[grading.classes]]\nname = "soft"\nE_max_MPa = 0.9\n[[grading.classes]]\nname = "firm"\n'


def test_a_fruit_whose_E_is_in_doubt_has_no_class_and_the_others_have(batch, run):
    """0.5 of 0.02 MPa below a limit of 0.9: sure by its error bar, which does not cover what is doubted."""
    status, _, rows = run(SOUND, CLASSES)
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
