"""`drupe watch`: fruit are graded as they arrive; the page is for this machine, by its token, read only."""

import csv
import http.client
import json
import shutil
import time
from collections import Counter
from contextlib import closing
from urllib.parse import urlsplit

import pytest
from rich.console import Console

from pipeline.batch import cache, provenance
from pipeline.batch.layout import Results, write_whole
from pipeline.batch.outcome import Outcome
from pipeline.batch.records import FruitRecord, GraspRecord, ModulusRecord, read_record, write_record
from pipeline.files import manifest
from pipeline.problem import BatchRefused
from pipeline.ranking import report_entries
from pipeline.run import fruit_queue, grading
from pipeline.run.fruit_records import ended_record
from pipeline.run.packed_records import PackedRecords
from pipeline.watch import watching
from pipeline.watch.page_server import PageServer
from pipeline.watch.watching import BatchWatch, WatchOptions
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import write_mesh
from reports.kiosk_page import kiosk_html

HEAD = 'category = "nectarine"\n[[grading.classes]]\nname = "soft"\nE_max_MPa = 0.5\n'


@pytest.fixture
def batch(tmp_path):
    """No row in fruits.csv, no fruit yet."""
    root = tmp_path / "monday"
    (root / "fruits").mkdir(parents=True)
    (root / "batch.toml").write_text(HEAD + '[[grading.classes]]\nname = "firm"\n')
    (root / "fruits.csv").write_text("fruit_id,height_mm\n")
    return root


def put(batch, name, *, recording=True):
    """A fruit's files, as a gripper leaves them."""
    folder = batch / "fruits" / name
    (folder / "grasps").mkdir(parents=True, exist_ok=True)
    directions, faces = ball(2)
    write_mesh(folder / "fruit.ply", 28 * directions, faces)
    if recording:
        (folder / "grasps" / "grasp-1.h5").write_text(f"of {name}")


def modulus_of(name):
    """E of the fake work (MPa): 0.1 of A, 0.2 of B, 0.3 of C; of a reference body 1.2 times its known 0.5."""
    return 0.6 if name.startswith("body") else 0.1 * (1 + (sum(name.encode()) - ord("A")) % 19)


def fake_record(fruit_id, task):
    """What the fake work makes of a fruit: its recording's content tells whether it is another's, too."""
    if fruit_id.startswith("crash"):
        return ended_record(task, Outcome.CRASHED, "signal 9")
    task.results.claim()
    (path,) = task.folder.grasp_files()[:1]
    said = path.read_text()
    named = {said.removeprefix("of "): said.removeprefix("of ") in task.batch_fruits}
    strangers = {name: known for name, known in named.items() if name != fruit_id}
    grasp = GraspRecord(grasp="grasp-1", digest=said)
    E_MPa = modulus_of(fruit_id)
    record = FruitRecord(
        fruit_id=fruit_id,
        outcome="graded",
        key=task.key,
        given=task.given,
        grasps=(grasp,),
        modulus=ModulusRecord(E_MPa=E_MPa, E_sd_MPa=0.01 * E_MPa),
        strangers=strangers,
        doubts=tuple(f"names {name}" for name, known in strangers.items() if known),
    )
    write_record(task.results.record, record)
    return record


@pytest.fixture
def worked(monkeypatch):
    """Fruit in the order in which they are worked on, which takes no time; "stop" is where Ctrl-C comes."""
    worked = []

    def work(todo, records, ended, **_):
        for fruit_id, task in todo:
            worked.append(fruit_id)
            if fruit_id == "stop" and worked.count("stop") == 1:
                raise KeyboardInterrupt
            records[fruit_id] = fake_record(fruit_id, task)
            ended(records[fruit_id])
        while todo.refused:
            ended(todo.refused.popleft())

    monkeypatch.setattr(grading, "_work", work)
    return worked


@pytest.fixture
def watched(batch, worked):
    """Watches with a clock that sleeping moves; `during` are done one at each sleep."""
    shown, time_s = [], [0.0]

    def begun(*during, idle_s=30.0, settle_s=2.0, jobs=1):
        steps = list(during)

        def sleep(seconds):
            time_s[0] += seconds
            if steps:
                steps.pop(0)()

        options = WatchOptions(
            out=batch / "results", jobs=jobs, time_limit_s=60, screen=False, settle_s=settle_s, idle_s=idle_s
        )
        watch = BatchWatch(
            root=batch,
            options=options,
            console=Console(quiet=True),
            show=shown.append,
            clock=lambda: time_s[0],
            sleep=sleep,
        )
        return watch, steps

    def run(*during, **how):
        watch, steps = begun(*during, **how)
        status = watch.run()
        assert not steps
        return status

    run.begun, run.worked, run.shown, run.time_s = begun, worked, shown, time_s
    return run


def rows(batch):
    with (batch / "results" / "ranking.csv").open() as file:
        return {row["fruit_id"]: row for row in csv.DictReader(file)}


def test_fruit_are_graded_as_they_come_and_shown_at_once(batch, watched):
    status = watched(lambda: put(batch, "B"), *[lambda: None] * 6, lambda: put(batch, "A"))
    assert status == 0
    assert watched.worked == ["B", "A"]
    assert {name: row["maturity"] for name, row in rows(batch).items()} == {"A": "soft", "B": "soft"}
    assert [entry.recent for entry in watched.shown if entry.batch][-1] == ("A", "B")
    working = [entry.working for entry in watched.shown if entry.working]
    assert working == [("B",), ("A",)]
    assert (batch / "fruits.csv").read_text() == "fruit_id,height_mm\n"


def test_files_that_still_arrive_are_waited_for(batch, watched):
    put(batch, "A", recording=False)
    photo = batch / "fruits" / "A" / "grasps" / "grasp-1.h5"

    def grow():
        with photo.open("a") as file:
            file.write("more")

    watched(*[lambda: None] * 8, *[grow] * 8)
    assert watched.worked == ["A"]
    waiting = [entry.waiting for entry in watched.shown]
    assert waiting[0] == (("A", "a recording in grasps/"),)
    assert waiting[-1] == ()


def test_a_fruit_without_shape_yet_holds_up_no_other(batch, watched):
    """Photos without a mat or a height would stop the whole batch, if it were one of it already."""
    (batch / "fruits" / "B" / "grasps").mkdir(parents=True)
    (batch / "fruits" / "B" / "grasps" / "grasp-1.h5").write_text("of B")
    (batch / "fruits.csv").write_text("fruit_id,height_mm\nA,\nC,\n")
    put(batch, "A")
    watched()
    assert watched.worked == ["A"]
    assert watched.shown[-1].waiting == (("B", "photos or fruit.ply"),)
    assert watched.shown[-1].expected == 1


def test_watching_ends_where_the_batch_cannot_be_graded(batch, watched):
    put(batch, "A")
    (batch / "batch.toml").write_text("category = 3\n")
    assert watched() == 0
    assert not watched.worked


def test_a_fruit_that_changes_is_graded_again_and_one_that_does_not_is_not(batch, watched):
    put(batch, "A")
    put(batch, "B")
    watched()
    assert sorted(watched.worked) == ["A", "B"]
    watched(lambda: (batch / "fruits" / "B" / "grasps" / "grasp-2.h5").write_text("again"))
    assert sorted(watched.worked) == ["A", "B", "B"]
    assert len(rows(batch)) == 2


def test_a_fruit_that_crashed_is_not_tried_at_each_newcomer(batch, watched):
    put(batch, "crash-1")
    status = watched(
        *[lambda: None] * 6, lambda: put(batch, "A"), *[lambda: None] * 6, lambda: put(batch, "B")
    )
    assert watched.worked == ["crash-1", "A", "B"]
    assert status == 3
    last = kiosk_html(watched.shown[-1])
    assert '<p class="id">B</p>' in last


def test_a_fault_in_the_settings_is_shown_and_mended_while_it_watches(batch, watched):
    put(batch, "A")
    good = (batch / "batch.toml").read_text()
    (batch / "batch.toml").write_text('category = "nectarin"\n')
    watched(*[lambda: None] * 6, lambda: (batch / "batch.toml").write_text(good))
    assert any("nectarin" in problem for entry in watched.shown for problem in entry.problems)
    assert watched.shown[-1].problems == ()
    assert watched.worked == ["A"]


def test_after_a_change_of_settings_all_fruit_are_taken_up_in_one_go(batch, watched):
    for name in "ABC":
        put(batch, name)
    (batch / "notes.txt").write_text("of no account")
    change = (batch / "batch.toml").read_text().replace("0.5", "0.15")
    watched(
        *[lambda: None] * 16,
        lambda: (batch / "notes.txt").write_text("changed"),
        *[lambda: None] * 4,
        lambda: (batch / "batch.toml").write_text(change),
    )
    assert watched.worked == ["A", "B", "C"]
    assert [entry.working for entry in watched.shown if entry.working] == [
        ("A",),
        ("B",),
        ("C",),
        ("A", "B", "C"),
    ]
    assert {row["maturity"] for row in rows(batch).values()} == {"soft", "firm"}


def test_a_deleted_fruit_costs_nothing(batch, watched):
    put(batch, "A")
    put(batch, "B")
    watched(*[lambda: None] * 12, lambda: shutil.rmtree(batch / "fruits" / "A"), lambda: put(batch, "C"))
    assert sorted(rows(batch)) == ["B", "C"]


def test_a_fruit_whose_files_are_away_for_a_moment_is_not_lost(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    own, away = batch / "fruits" / "A", batch / "A"
    watch, _ = watched.begun(
        *one_by_one(batch, "A", "B", "C"),
        lambda: own.rename(away),
        *QUIET,
        *one_by_one(batch, "D"),
        lambda: away.rename(own),
        *QUIET,
        interrupted,
    )
    with pytest.raises(KeyboardInterrupt):
        watch.run()
    assert watch.stop() == 0
    assert sorted(rows(batch)) == ["A", "B", "C", "D"]


QUIET = [lambda: None] * 8
"""Enough looks for a fruit to be at rest and graded."""


def one_by_one(batch, *names):
    """Each put there when the one before is graded."""
    return [step for name in names for step in (lambda name=name: put(batch, name), *QUIET)]


def reports_take(monkeypatch, watched, seconds):
    """Reports take so long by the watch's clock; how many fruit each was of."""
    made, report = [], grading.report

    def slow(run, records):
        made.append(len(run.batch.rows))
        watched.time_s[0] += seconds
        return report(run, records)

    monkeypatch.setattr(grading, "report", slow)
    return made


def test_a_newcomer_costs_the_same_however_many_fruit_there_are(batch, watched, monkeypatch):
    """Records read and unpacked, files hashed, tasks made: of the newcomer alone."""
    reports_take(monkeypatch, watched, 10.0)
    counts, spent = Counter(), {}

    def counted(module, name):
        function = getattr(module, name)

        def counting(*arguments, **options):
            counts[name] += 1
            return function(*arguments, **options)

        monkeypatch.setattr(module, name, counting)

    for module, name in (
        (fruit_queue, "read_record"), (fruit_queue, "fruit_task"), (cache, "file_hash"),
        (provenance, "file_hash"), (manifest, "_hash"), (PackedRecords, "__getitem__"),
        (report_entries, "_fruit_entry"),
    ):  # fmt: skip
        counted(module, name)

    def keep(name):
        spent[name] = dict(counts)
        counts.clear()

    names = [f"N{k:02d}" for k in range(24)]
    watched(
        *[
            step
            for name in names
            for step in (lambda name=name: put(batch, name), *QUIET, lambda name=name: keep(name))
        ]
    )
    assert watched.worked == names
    assert spent["N03"] == spent["N12"] == spent["N23"]
    assert spent["N23"]["read_record"] == 1


def test_of_several_at_once_each_is_shown_when_it_ends(batch, watched):
    def both():
        put(batch, "A")
        put(batch, "B")

    watched(*one_by_one(batch, "C", "D"), both, jobs=2)
    shown = [(entry.recent[:2], entry.working) for entry in watched.shown]
    at = shown.index((("A", "D"), ("B",)))
    assert shown[at + 1] == (("B", "A"), ())


def test_folders_of_graded_fruit_are_looked_into_in_turn(batch, watched, monkeypatch):
    monkeypatch.setattr(watching, "TURN", 2)
    looked, into = [], watching.arrival
    monkeypatch.setattr(
        watching, "arrival", lambda folder, row: looked.append(row.fruit_id) or into(folder, row)
    )
    watched(
        *one_by_one(batch, *"ABCDE"),
        looked.clear,
        *[lambda: None] * 3,
        lambda: looked.append("here"),
        lambda: (batch / "fruits" / "C" / "grasps" / "grasp-2.h5").write_text("again"),
        *QUIET,
    )
    three_looks = looked[: looked.index("here")]
    assert sorted(three_looks[:5]) == list("ABCDE")
    assert len(three_looks) <= 8
    assert watched.worked == [*"ABCDE", "C"]


def test_reports_between_take_a_bounded_share_of_the_time_and_the_last_is_of_all(batch, watched, monkeypatch):
    made = reports_take(monkeypatch, watched, 1.0)
    watched(*one_by_one(batch, *[f"N{k:02d}" for k in range(40)]))
    assert len(made) <= 3 + 0.01 * watched.time_s[0]  # the first two, the last, and 1 % of the time between
    assert len(made) >= 4
    assert (made[0], made[-1]) == (1, 40)
    assert len(rows(batch)) == 40


def test_a_report_that_is_late_is_made_when_nothing_comes(batch, watched, monkeypatch):
    made = reports_take(monkeypatch, watched, 1.0)
    watched(*one_by_one(batch, "A", "B", "C"), *[lambda: None] * 240, idle_s=200.0)
    assert made == [1, 2, 3, 3]


def test_the_page_ranks_a_newcomer_among_all_before_any_report(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    watched(*one_by_one(batch, "C", "E", "A", "D", "B"))
    ranks = {}
    for entry in watched.shown:
        if entry.recent:
            fruit = next(one for one in entry.batch.fruits if one.fruit_id == entry.recent[0])
            ranks.setdefault(fruit.fruit_id, (fruit.rank, len(entry.batch.fruits)))
    assert ranks == {"C": (1, 1), "E": (2, 2), "A": (1, 3), "D": (3, 4), "B": (2, 5)}
    assert {name: row["rank"] for name, row in rows(batch).items()} == dict(
        zip("ABCDE", "12345", strict=True)
    )


def shown_first(watched, name):
    """A fruit's entry as the page has it first."""
    for entry in watched.shown:
        for fruit in () if entry.batch is None else entry.batch.fruits:
            if fruit.fruit_id == name:
                return fruit
    raise AssertionError(name)


def test_a_recording_that_two_fruit_have_is_said_of_both(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)

    def twin():
        put(batch, "B")
        (batch / "fruits" / "B" / "grasps" / "grasp-1.h5").write_text("of A")

    assert watched(*one_by_one(batch, "C", "A"), twin) == 4
    assert "fruits/A/grasps/grasp-1.h5" in " ".join(shown_first(watched, "B").doubts)
    assert [name for name, row in sorted(rows(batch).items()) if row["warnings"]] == ["A", "B"]


def test_a_newcomer_is_corrected_by_the_reference_bodies_so_far(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    (batch / "fruits.csv").write_text(
        "fruit_id,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
        "body,true,0.5,0.005,0.48\nA,,,,\nB,,,,\nC,,,,\n"
    )
    with (batch / "batch.toml").open("a") as settings:
        settings.write("[reference]\ncorrect = true\n")
    watched(*one_by_one(batch, "body", "C", "A", "B"))
    for name in "ABC":
        assert shown_first(watched, name).E_MPa == pytest.approx(modulus_of(name) / 1.2)
        assert float(rows(batch)[name]["E_MPa"]) == pytest.approx(modulus_of(name) / 1.2, rel=1e-3)
        assert read_record(batch / "results" / "fruits" / name / "record.json").reference.corrected


def test_a_reference_body_that_comes_late_corrects_all_at_once(batch, watched, monkeypatch):
    """C of 0.3 / 1.2 = 0.25 MPa ranks among A of 0.1 / 1.2 and E of 0.5 / 1.2 before any other report."""
    reports_take(monkeypatch, watched, 1000.0)
    (batch / "fruits.csv").write_text(
        "fruit_id,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
        "body,true,0.5,0.005,0.48\nA,,,,\nC,,,,\nE,,,,\n"
    )
    with (batch / "batch.toml").open("a") as settings:
        settings.write("[reference]\ncorrect = true\n")
    watched(*one_by_one(batch, "A", "E", "body", "C"))
    first = next(entry for entry in watched.shown if entry.recent[:1] == ("C",))
    E_MPa = {fruit.fruit_id: fruit.E_MPa for fruit in first.batch.fruits if not fruit.reference}
    assert E_MPa == {name: pytest.approx(modulus_of(name) / 1.2) for name in "ACE"}


def test_a_fruit_that_a_recording_of_another_names_has_that_one_graded_again(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)

    def of_another():
        put(batch, "A")
        (batch / "fruits" / "A" / "grasps" / "grasp-1.h5").write_text("of B")

    watched(
        *one_by_one(batch, "D"), of_another, *QUIET, lambda: put(batch, "C"), *QUIET, *one_by_one(batch, "B")
    )
    assert watched.worked == ["D", "A", "C", "B", "A"]
    assert "names B" in read_record(batch / "results" / "fruits" / "A" / "record.json").doubts


def test_a_row_that_comes_after_its_fruit_is_taken_up_without_the_others(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    table = batch / "fruits.csv"
    watched(
        *one_by_one(batch, "A", "B", "C"),
        lambda: table.write_text("fruit_id,height_mm,notes\nA,56,\n"),
        *QUIET,
        lambda: table.write_text("fruit_id,height_mm,notes\nA,56,\nB,,sunny side\n"),
        *QUIET,
    )
    assert watched.worked == ["A", "B", "C", "A"]
    working = [entry.working for entry in watched.shown if entry.working]
    assert working == [("A",), ("B",), ("C",), ("A",), ("B",)]
    given = {name: read_record(batch / "results" / "fruits" / name / "record.json").given for name in "AB"}
    assert (given["A"].height_mm, given["B"].notes) == (56, "sunny side")


def test_a_fruit_that_is_only_read_again_is_not_shown_as_the_last(batch, watched, monkeypatch):
    """For its row, or for a newcomer that its recording names; with files of its own that changed it is."""
    reports_take(monkeypatch, watched, 1000.0)
    recent = []

    def keep():
        recent.append("".join(watched.shown[-1].recent))

    def of_another():
        put(batch, "C")
        (batch / "fruits" / "C" / "grasps" / "grasp-1.h5").write_text("of D")

    watched(
        *one_by_one(batch, "A", "B"),
        of_another,
        *QUIET,
        keep,
        lambda: (batch / "fruits.csv").write_text("fruit_id,height_mm,notes\nA,,sunny side\n"),
        *QUIET,
        keep,
        *one_by_one(batch, "D"),
        keep,
        lambda: (batch / "fruits" / "B" / "grasps" / "grasp-2.h5").write_text("again"),
        *QUIET,
        keep,
    )
    assert watched.worked == ["A", "B", "C", "D", "C", "B"]
    assert recent == ["CBA", "CBA", "DCBA", "BDCA"]


def test_a_watched_day_ends_with_the_results_of_a_plain_grade(batch, watched, tmp_path):
    """Files, ranking and outcomes: with a copy, a crash, a stranger, a reference body and a late row."""
    body = "body,,true,0.5,0.005,0.48\n"
    head = "fruit_id,height_mm,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
    names = ["B", "crash-1", "K", "body", "A", "D", "H"]
    (batch / "fruits.csv").write_text(head + body + "K,560,,,,\n")

    def recorded(name, said):
        put(batch, name)
        (batch / "fruits" / name / "grasps" / "grasp-1.h5").write_text(said)

    all_rows = head + body + "K,560,,,,\n" + "".join(f"{n},56,,,,\n" for n in names if n not in ("body", "K"))
    watched(
        lambda: recorded("A", "of D"),
        *QUIET,
        *one_by_one(batch, *(name for name in names if name not in "AH")),
        lambda: recorded("H", "of B"),
        *QUIET,
        lambda: (batch / "fruits.csv").write_text(all_rows),
        *QUIET,
    )
    grading.grade(
        batch, tmp_path / "plain", jobs=1, time_limit_s=60, console=Console(quiet=True), screen=False
    )

    def left(out):
        files = {path.relative_to(out): path for path in out.rglob("*") if path.is_file()}
        said = json.loads((out / "batch.json").read_text())
        return (
            set(files),
            {
                name: path.read_text()
                for name, path in files.items()
                if name.name in ("record.json", "ranking.csv")
            },
            {name: said[name] for name in ("outcomes", "inputs", "exit_status", "reference", "settings")},
        )

    assert left(batch / "results") == left(tmp_path / "plain")
    assert json.loads((batch / "results" / "batch.json").read_text())["outcomes"]["K"] == "implausible-input"


def interrupted():
    raise KeyboardInterrupt


def test_ctrl_c_between_fruit_leaves_ranking_and_report_of_all(batch, watched, monkeypatch):
    made = reports_take(monkeypatch, watched, 1000.0)
    watch, _ = watched.begun(*one_by_one(batch, "A", "B", "C"), interrupted)
    with pytest.raises(KeyboardInterrupt):
        watch.run()
    assert sorted(rows(batch)) == ["A", "B"]
    assert watch.stop() == 0
    assert made == [1, 2, 3]
    assert sorted(rows(batch)) == ["A", "B", "C"]
    assert json.loads((batch / "results" / "batch.json").read_text())["exit_status"] == 0
    assert watch.stop() == 0
    assert made == [1, 2, 3]


def test_ctrl_c_tells_by_its_status_that_the_report_could_not_be_written(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)

    def edited():
        with (batch / "results" / "ranking.csv").open("a") as ranking:
            ranking.write("by hand\n")

    watch, _ = watched.begun(*one_by_one(batch, "A", "B", "C"), edited, interrupted)
    with pytest.raises(KeyboardInterrupt):
        watch.run()
    assert watch.stop() == 2
    assert (batch / "results" / "ranking.csv").read_text().endswith("by hand\n")
    assert "ranking.csv" in " ".join(watched.shown[-1].problems)


def test_ctrl_c_in_the_middle_of_a_fruit_leaves_those_before_it_and_says_so(batch, watched, monkeypatch):
    made = reports_take(monkeypatch, watched, 1000.0)
    watch, _ = watched.begun(*one_by_one(batch, "A", "B", "C", "stop"))
    with pytest.raises(KeyboardInterrupt):
        watch.run()
    assert watch.working == ("stop",)
    assert watch.stop() == 130
    assert made == [1, 2]
    assert sorted(rows(batch)) == ["A", "B", "C"]
    assert "Interrupted:</b> 3 of 4 fruit" in (batch / "results" / "report.html").read_text()
    said = json.loads((batch / "results" / "batch.json").read_text())
    assert (said["exit_status"], sorted(said["outcomes"])) == (130, ["A", "B", "C"])
    assert watched() == 0
    assert watched.worked == ["A", "B", "C", "stop", "stop"]
    assert sorted(rows(batch)) == ["A", "B", "C", "stop"]


def test_newcomers_are_not_written_through_a_link(batch, watched, monkeypatch, tmp_path):
    reports_take(monkeypatch, watched, 1000.0)
    results, stranger = batch / "results", tmp_path / "stranger"
    stranger.mkdir()

    def linked():
        results.rename(batch / "before")
        results.symlink_to(stranger)

    watch, _ = watched.begun(*one_by_one(batch, "A", "B"), linked, *one_by_one(batch, "C"))
    assert watch.run() == 2
    assert list(stranger.iterdir()) == []
    assert watched.worked == ["A", "B"]
    assert any("is a link" in problem for entry in watched.shown for problem in entry.problems)


def test_newcomers_are_not_written_into_the_results_of_another_batch(batch, watched, monkeypatch, tmp_path):
    """Neither their records nor, between fruit, ranking and report."""
    reports_take(monkeypatch, watched, 1000.0)
    results, other = batch / "results", tmp_path / "tuesday"
    (other / "fruits").mkdir(parents=True)
    shutil.copy(batch / "batch.toml", other)
    (other / "fruits.csv").write_text("fruit_id\nX\n")
    put(other, "X")
    grading.grade(other, None, jobs=1, time_limit_s=60, console=Console(quiet=True), screen=False)
    theirs = (other / "results" / "ranking.csv").read_text()

    def replaced():
        results.rename(batch / "before")
        shutil.copytree(other / "results", results)

    watch, _ = watched.begun(*one_by_one(batch, "A", "B", "C"), replaced, *one_by_one(batch, "D"))
    assert watch.run() == 2
    assert watch.stop() == 2
    assert watched.worked == ["X", "A", "B", "C"]
    assert not (results / "fruits" / "D").exists()
    assert (results / "ranking.csv").read_text() == theirs


def test_ctrl_c_while_a_fruit_is_graded_again_for_a_newcomer_says_so(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)

    def names_b():
        put(batch, "stop")
        (batch / "fruits" / "stop" / "grasps" / "grasp-1.h5").write_text("of B")

    def stops_again():
        watched.worked[:] = [name for name in watched.worked if name != "stop"]

    watched.worked.append("stop")  # it is graded once before Ctrl-C comes
    watch, _ = watched.begun(*one_by_one(batch, "D"), names_b, *QUIET, stops_again, *one_by_one(batch, "B"))
    with pytest.raises(KeyboardInterrupt):
        watch.run()
    assert watched.worked == ["D", "B", "stop"]
    assert watch.working == ("stop",)
    assert watch.stop() == 130
    assert sorted(rows(batch)) == ["B", "D"]
    assert "Interrupted:</b> 2 of 3 fruit" in (batch / "results" / "report.html").read_text()
    assert json.loads((batch / "results" / "batch.json").read_text())["exit_status"] == 130


def test_a_fruit_that_could_not_be_graded_again_makes_the_run_an_interrupted_one(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)

    def without_memory():
        monkeypatch.setattr(grading, "free_memory_MiB", lambda: 1.0)
        (batch / "fruits" / "A" / "grasps" / "grasp-2.h5").write_text("again")

    watch, _ = watched.begun(*one_by_one(batch, "A", "B", "C"), without_memory, *QUIET, interrupted)
    with pytest.raises(KeyboardInterrupt):
        watch.run()
    assert any("memory" in problem for entry in watched.shown for problem in entry.problems)
    assert watch.stop() == 130
    assert sorted(rows(batch)) == ["B", "C"]
    assert "Interrupted:</b> 2 of 3 fruit" in (batch / "results" / "report.html").read_text()


@pytest.mark.parametrize("place", ["FruitQueue", "report"])
def test_ctrl_c_in_the_last_comparison_leaves_ranking_and_report_of_all(batch, watched, monkeypatch, place):
    made = reports_take(monkeypatch, watched, 1000.0)
    watch, _ = watched.begun(*one_by_one(batch, *"ABCDE"))
    grades = watching.grade

    def interrupted_there(*arguments, **how):
        if how["retried"]:
            return grades(*arguments, **how)
        with monkeypatch.context() as patch:
            patch.setattr(grading, place, lambda *_, **__: interrupted())
            return grades(*arguments, **how)

    monkeypatch.setattr(watching, "grade", interrupted_there)
    with pytest.raises(KeyboardInterrupt):
        watch.run()
    assert sorted(rows(batch)) == ["A", "B"]
    assert watch.working == ()
    assert watch.stop() == 0
    assert made == [1, 2, 5]
    assert sorted(rows(batch)) == list("ABCDE")
    assert json.loads((batch / "results" / "batch.json").read_text())["exit_status"] == 0


def test_ctrl_c_while_the_last_comparison_grades_a_fruit_again_says_so(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    watched.worked.append("stop")  # it is graded once before Ctrl-C comes
    watch, _ = watched.begun(*one_by_one(batch, "A", "stop", "B"))
    grades = watching.grade

    def once_more(*arguments, **how):
        if not how["retried"]:
            (batch / "results" / "fruits" / "stop" / "record.json").unlink()
            watched.worked.clear()
        return grades(*arguments, **how)

    monkeypatch.setattr(watching, "grade", once_more)
    with pytest.raises(KeyboardInterrupt):
        watch.run()
    assert watch.working == ("stop",)
    assert watch.stop() == 130
    assert sorted(rows(batch)) == ["A", "B"]
    assert json.loads((batch / "results" / "batch.json").read_text())["exit_status"] == 130


@pytest.mark.parametrize("before", [(), ("A",)])
def test_the_command_says_that_ctrl_c_left_a_fruit_unfinished(batch, drupe, worked, before):
    for name in (*before, "stop"):
        put(batch, name)
    ran = drupe("watch", batch, "--settle", "0", "--no-screen", "-q")
    assert worked == [*before, "stop"]
    assert ran.status == 130
    assert "drupe: stopped; a fruit was not finished" in ran.err


def ask(server, path, *, host=None, method="GET"):
    """Status, headers and body of one answer."""
    address = urlsplit(server.address)
    with closing(http.client.HTTPConnection(address.hostname, address.port, timeout=10)) as connection:
        connection.putrequest(method, path, skip_host=True)
        connection.putheader("Host", host or address.netloc)
        connection.endheaders()
        with connection.getresponse() as answer:
            return answer.status, dict(answer.getheaders()), answer.read()


@pytest.fixture
def server(tmp_path):
    results = Results(tmp_path / "results")
    results.claim()
    with PageServer(results) as serving:
        serving.show("<p>first</p>")
        yield serving


def test_the_page_is_given_to_who_knows_its_token_alone(server):
    own = urlsplit(server.address).path
    assert len(own) > 20
    status, headers, body = ask(server, own)
    assert (status, body) == (200, b"<p>first</p>")
    assert headers["x-frame-options"] == "DENY"
    assert ask(server, "/")[0] == 404
    assert ask(server, "/wrong/")[0] == 404
    assert ask(server, own, host="evil.example")[0] == 400
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        assert ask(server, own, method=method)[0] == 405


def test_of_the_results_only_what_drupe_wrote_is_given(server, tmp_path):
    own = urlsplit(server.address).path
    results = Results(tmp_path / "results")
    fruit = results.fruit("N01")
    fruit.root.mkdir(parents=True)
    fruit.claim()
    write_whole(results.report, "<p>report</p>")
    write_whole(fruit.picture, b"png")
    (fruit.root / "mine.png").write_bytes(b"mine")
    secret = tmp_path / "secret.json"
    secret.write_text("{}")
    (results.root / "linked.json").symlink_to(secret)
    assert ask(server, own + "report.html")[2] == b"<p>report</p>"
    assert ask(server, own + f"fruits/N01/{fruit.picture.name}")[2] == b"png"
    for path in (
        "fruits/N01/mine.png", "linked.json", "../secret.json", "%2e%2e/secret.json", ".written.json",
        "fruits/N01/.written.json", "fruits/N01", "fruits/../../secret.json", "report.html%00.png",
        "//etc/passwd",
    ):  # fmt: skip
        assert ask(server, own + path)[0] == 404, path


def test_news_reach_an_open_page_within_a_second(server):
    address = urlsplit(server.address)
    with closing(http.client.HTTPConnection(address.hostname, address.port, timeout=10)) as connection:
        connection.request("GET", address.path + "events")
        with connection.getresponse() as answer:
            assert answer.getheader("content-type").startswith("text/event-stream")
            assert answer.readline() == b"event: changed\n"
            for _ in range(2):
                answer.readline()
            began = time.monotonic()
            server.show("<p>second</p>")
            assert answer.readline() == b"event: changed\n"
            assert time.monotonic() - began < 1.0
    assert ask(server, address.path)[2] == b"<p>second</p>"


def test_a_port_that_is_taken_is_said(server, tmp_path):
    taken = urlsplit(server.address).port
    with pytest.raises(BatchRefused, match=f"--port {taken}"):
        PageServer(Results(tmp_path / "other"), port=taken)
