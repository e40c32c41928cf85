"""Fruit that `drupe watch` grades one by one, their cost and ranks, and those it cannot grade."""

import json
import shutil
from collections import Counter

import pytest
from graded_results import rows
from rich.console import Console
from watched_batch import QUIET, modulus_of, of_another, one_by_one, put, reports_take, shown_first

from pipeline.batch import cache, provenance
from pipeline.batch.records import read_record
from pipeline.files import manifest
from pipeline.ranking import report_entries
from pipeline.run import fruit_queue, grading
from pipeline.run.batch_run import GradeOptions


def test_a_newcomer_costs_the_same_however_many_fruit_there_are(batch, watched, monkeypatch):
    """Records read, files hashed, tasks made: of the newcomer alone."""
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
        (provenance, "file_hash"), (manifest, "_hash"),
        (report_entries, "_fruit_entry"),
    ):  # fmt: skip
        counted(module, name)

    def keep(name):
        spent[name] = dict(counts)
        counts.clear()

    names = [f"N{k:02d}" for k in range(12)]
    watched(
        *[
            step
            for name in names
            for step in (lambda name=name: put(batch, name), *QUIET, lambda name=name: keep(name))
        ]
    )
    assert watched.worked == names
    assert spent["N03"] == spent["N06"] == spent["N11"]
    assert spent["N11"]["read_record"] == 1


def test_of_several_at_once_each_is_shown_when_it_ends(batch, watched):
    def both():
        put(batch, "A")
        put(batch, "B")

    watched(*one_by_one(batch, "C", "D"), both, jobs=2)
    shown = [(entry.recent[:2], entry.working) for entry in watched.shown]
    assert shown[shown.index((("A", "D"), ("B",))) + 1] == (("B", "A"), ())


def test_reports_between_take_a_bounded_share_of_the_time_and_the_last_is_of_all(batch, watched, monkeypatch):
    made = reports_take(monkeypatch, watched, 1.0)
    watched(*one_by_one(batch, *[f"N{k:02d}" for k in range(24)]))
    assert len(made) <= 3 + 0.01 * watched.time_s[0]  # the first, the last, and 1 % of the time between
    assert len(made) >= 3
    assert (made[0], made[-1]) == (1, 24)
    assert len(rows(batch / "results")) == 24


def test_the_page_ranks_a_newcomer_among_all_before_any_report(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    watched(*one_by_one(batch, "C", "E", "A", "D", "B"))
    ranks = {}
    for entry in watched.shown:
        if entry.recent:
            fruit = next(fruit for fruit in entry.batch.fruits if fruit.fruit_id == entry.recent[0])
            ranks.setdefault(fruit.fruit_id, (fruit.rank, len(entry.batch.fruits)))
    assert ranks == {"C": (1, 1), "E": (2, 2), "A": (1, 3), "D": (3, 4), "B": (2, 5)}
    assert {name: row["rank"] for name, row in rows(batch / "results").items()} == dict(
        zip("ABCDE", "12345", strict=True)
    )


def test_a_recording_that_two_fruit_have_is_said_of_both(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    assert watched(*one_by_one(batch, "C", "A"), lambda: of_another(batch, "B", "A")) == 4
    assert [name for name, row in sorted(rows(batch / "results").items()) if row["warnings"]] == ["A", "B"]


def correct_by_a_body(batch, fruit):
    """Lists the fruit and a reference body, by which the batch corrects E."""
    (batch / "fruits.csv").write_text(
        "fruit_id,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
        "body,true,0.5,0.005,0.48\n" + "".join(f"{name},,,,\n" for name in fruit)
    )
    with (batch / "batch.toml").open("a") as settings:
        settings.write("[reference]\ncorrect = true\n")


def test_a_newcomer_is_corrected_by_the_reference_bodies_so_far(batch, watched, monkeypatch):
    reports_take(monkeypatch, watched, 1000.0)
    correct_by_a_body(batch, "ABC")
    watched(*one_by_one(batch, "body", "C", "A", "B"))
    for name in "ABC":
        assert shown_first(watched, name).E_MPa == pytest.approx(modulus_of(name) / 1.2)
        assert float(rows(batch / "results")[name]["E_MPa"]) == pytest.approx(
            modulus_of(name) / 1.2, rel=1e-3
        )
        assert read_record(batch / "results" / "fruits" / name / "record.json").reference.corrected


def test_a_reference_body_that_comes_late_corrects_all_at_once(batch, watched, monkeypatch):
    """C of 0.3 / 1.2 = 0.25 MPa ranks among A of 0.1 / 1.2 and E of 0.5 / 1.2 before any other report."""
    reports_take(monkeypatch, watched, 1000.0)
    correct_by_a_body(batch, "ACE")
    watched(*one_by_one(batch, "A", "E", "body", "C"))
    first = next(entry for entry in watched.shown if entry.recent[:1] == ("C",))
    E_MPa = {fruit.fruit_id: fruit.E_MPa for fruit in first.batch.fruits if not fruit.reference}
    assert E_MPa == {name: pytest.approx(modulus_of(name) / 1.2) for name in "ACE"}


def test_a_watched_day_ends_with_the_results_of_a_plain_grade(batch, watched, tmp_path):
    """Files, ranking and outcomes: with a copy, a crash, a stranger, a reference body and a late row."""
    body = "body,,true,0.5,0.005,0.48\n"
    head = "fruit_id,height_mm,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
    names = ["B", "crash-1", "K", "body", "A", "D", "H"]
    (batch / "fruits.csv").write_text(head + body + "K,560,,,,\n")

    all_rows = head + body + "K,560,,,,\n" + "".join(f"{n},56,,,,\n" for n in names if n not in ("body", "K"))
    watched(
        lambda: of_another(batch, "A", "D"),
        *QUIET,
        *one_by_one(batch, *(name for name in names if name not in "AH")),
        lambda: of_another(batch, "H", "B"),
        *QUIET,
        lambda: (batch / "fruits.csv").write_text(all_rows),
        *QUIET,
    )
    how = GradeOptions(jobs=1, time_limit_s=60, screen=False)
    grading.grade(batch, tmp_path / "plain", how, console=Console(quiet=True))

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


LATER = [lambda: None] * 40
"""Enough looks for what was refused to be tried again."""


def in_the_way(batch, name):
    """A file of somebody else's where the fruit's results go."""
    place = batch / "results" / "fruits" / name
    place.mkdir(parents=True)
    (place / "record.json").write_text("somebody else's")


def taken_away(batch, name):
    shutil.rmtree(batch / "fruits" / name)


def problems(watched):
    return {problem for entry in watched.shown for problem in entry.problems}


def test_a_fruit_keeps_its_record_when_a_newcomer_that_it_names_is_refused(batch, watched):
    put(batch, "D")
    of_another(batch, "A", "B")
    assert watched() == 0
    status = watched(
        lambda: in_the_way(batch, "B"), *one_by_one(batch, "B"), lambda: taken_away(batch, "B"), *LATER
    )
    assert any("fruits/B/record.json" in problem for problem in problems(watched))
    assert (status, sorted(rows(batch / "results"))) == (0, ["A", "D"])


def test_a_newcomer_that_is_still_refused_is_said_by_the_status(batch, watched):
    assert watched(*one_by_one(batch, "A"), lambda: in_the_way(batch, "N9"), *one_by_one(batch, "N9")) == 2
    assert sorted(rows(batch / "results")) == ["A"]


def changed(batch, name):
    (batch / "fruits" / name / "grasps" / "grasp-2.h5").write_text("again")


def as_before(batch, name):
    (batch / "fruits" / name / "grasps" / "grasp-2.h5").unlink()


@pytest.mark.parametrize("why", ["place", "memory"])
@pytest.mark.parametrize("then", [as_before, taken_away])
def test_a_changed_fruit_that_was_refused_and_is_as_before_or_gone_leaves_a_whole_batch(
    batch, watched, monkeypatch, why, then
):
    memory_MiB = grading.free_memory_MiB

    def refused():
        changed(batch, "B")
        if why == "memory":
            monkeypatch.setattr(grading, "free_memory_MiB", lambda: 1.0)
        else:
            (batch / "results" / "fruits" / "B").rename(batch / "B before")
            (batch / "results" / "fruits" / "B").symlink_to(batch / "B before")

    def restored():
        then(batch, "B")
        if why == "memory":
            monkeypatch.setattr(grading, "free_memory_MiB", memory_MiB)
        else:
            (batch / "results" / "fruits" / "B").unlink()
            (batch / "B before").rename(batch / "results" / "fruits" / "B")

    assert watched(*one_by_one(batch, "A", "B")) == 0
    status = watched(refused, *QUIET, restored, *LATER)
    assert problems(watched)
    assert (status, sorted(rows(batch / "results"))) == (0, ["A", "B"] if then is as_before else ["A"])
