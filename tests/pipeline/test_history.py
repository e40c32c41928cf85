"""Lots over days: results become days of a lot, on the terminal, the page and in a table."""

import csv
import sqlite3
from datetime import UTC, date, datetime

import numpy as np
import pytest
from graded_results import graded, results_of

from pipeline.batch.fruits_table import Given
from pipeline.batch.records import FruitRecord
from pipeline.history.lot_database import history_store
from pipeline.history.lot_history import history_entry
from pipeline.history.stored_batch import stored_batch

NOW = datetime(2026, 8, 20, 12, tzinfo=UTC)
CLASSES = {"classes": [{"name": "ready", "E_max_MPa": 0.5}, {"name": "firm", "E_max_MPa": None}]}


@pytest.fixture
def three_days(tmp_path):
    """A lot of two cultivars' one over three days, each with a reference body; readings of Shore OO."""
    outs = []
    rng = np.random.default_rng(1)
    for k, day in enumerate(("2026-08-10", "2026-08-12", "2026-08-15")):
        E = 1.1 * np.exp(-0.12 * (0, 2, 5)[k] + rng.normal(0, 0.12, 6))
        fruit = [
            graded(f"N{j}", float(E_MPa), shore_oo=float(55 + 14 * np.log(E_MPa) + rng.normal(0, 0.8)))
            for j, E_MPa in enumerate(E)
        ]
        body = graded("ball", 0.9 * (1, 1, 1.5)[k], sd=0.04, reference=True, reference_E_MPa=0.9)
        odd = graded("odd", 40.0, doubts=["a gram for a newton"])
        lost = FruitRecord(fruit_id="lost", outcome="no-photos", key="k", given=Given())
        outs.append(
            results_of(
                tmp_path / day,
                [*fruit, body, odd, lost],
                day=day,
                cultivar="Big Top",
                lot="<script>alert(1)</script>",
                grading=CLASSES,
            )
        )
    return outs


def test_results_become_days_of_a_lot(three_days):
    batches = [stored_batch(out) for out in three_days]
    entry = history_entry(batches, now=NOW)
    (series,) = entry.series
    assert [day.day for day in series.days] == [date(2026, 8, 10), date(2026, 8, 12), date(2026, 8, 15)]
    assert [(day.fruit, day.left_out) for day in series.days] == [(6, 2)] * 3
    assert series.days[-1].E_MPa < 0.8
    assert "E falls by" in series.softening_words
    (ready,) = series.limits
    assert "2026-08-" in ready.words
    assert len(entry.alarms) == 1
    assert "ball: the last batch deviates by more than 3" in entry.alarms[0]


def test_measured_on_takes_the_place_of_the_day_of_grading(tmp_path):
    out = results_of(tmp_path / "late", [graded("A", 1.0)], day="2026-08-19", measured_on="2026-08-11")
    assert stored_batch(out).measured == date(2026, 8, 11)
    (series,) = history_entry([stored_batch(out)], now=NOW).series
    assert not series.notes


def test_a_day_of_grading_and_the_kind_of_mean_are_stated(drupe, tmp_path):
    out = results_of(
        tmp_path / "day", [graded("A", 0.4), graded("B", 0.9)], day="2026-08-19", grading=CLASSES
    )
    shown = drupe("history", out).out
    assert "geometric mean of E 0.6 MPa (" in shown
    assert "10 % of the fruit: Already; 50 % of the fruit are at or below this limit." in shown
    assert "batch.toml has no measured_on for 2026-08-19, so drupe takes the day of grading" in shown


def test_the_command_keeps_days_and_says_them_again(drupe, three_days, tmp_path):
    store, page, table = tmp_path / "lots.sqlite", tmp_path / "h.html", tmp_path / "h.csv"
    first = drupe("history", *three_days[:2], "--store", store)
    assert first.status == 0
    assert "2 batches (2 new), 1 lot\n" in first.out
    again = drupe("history", *three_days, "--store", store, "--html", page, "--csv", table)
    assert again.status == 4  # the ball reads half too much
    assert "3 batches (1 new)" in again.out
    assert "reference body ball" in again.out
    said = page.read_text()
    assert "<script>alert" not in said
    assert "&lt;script&gt;" in said
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert len(rows) == 3 * 8
    assert {row["measured_on"] for row in rows} == {"2026-08-10", "2026-08-12", "2026-08-15"}
    once_more = drupe("history", "--store", store, "--html", page)
    assert "3 batches (0 new)" in once_more.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "needs results folders, or a store with --store"),
        (("nowhere",), "nowhere: does not exist; give the folder from --out."),
        (("OUT", "--store", "notes.txt"), "is not a store of drupe history; drupe does not overwrite it"),
        (("OUT", "--store", "other.sqlite"), "belongs to another program; drupe does not write to it"),
        (("OUT", "--store", "link"), "is a link, and drupe does not write through links"),
        (("OUT", "--store", "OUT/lots.sqlite"), "lies in"),
        (("OUT", "--html", "notes.txt"), "exists and is not a page of drupe history"),
        (("OUT", "--csv", "none/h.csv"), "does not exist; create the folder first"),
        (("running",), "belongs to an unfinished run"),
    ],
)
def test_what_cannot_be_done_is_said_and_nothing_is_touched(drupe, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    results_of(tmp_path / "OUT", [graded("A", 1.0)])
    results_of(tmp_path / "running", [graded("A", 1.0)], status=None)
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "link").symlink_to("notes.txt")
    with sqlite3.connect(tmp_path / "other.sqlite") as other:
        other.execute("CREATE TABLE mine (a)")
    other.close()
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    ran = drupe("history", *arguments)
    assert ran.status == 2
    assert said in ran.err
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert {path: data for path, data in after.items() if path in before} == before
    assert {path.name for path in after if path not in before} <= {"S"}


def test_nothing_of_a_failed_run_is_kept(drupe, three_days, tmp_path):
    store = tmp_path / "lots.sqlite"
    drupe("history", three_days[0], "--store", store)
    failed = drupe("history", three_days[1], "--store", store, "--firmness", "brix=N@8mm")
    assert failed.status == 2
    with history_store(store) as opened:
        assert len(opened.batches()) == 1
