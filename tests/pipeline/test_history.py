"""Lots over days, their store and its tables: graded again, renamed, forgotten, damaged."""

import csv
import io
import math
import re
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, date, datetime
from threading import Barrier

import numpy as np
import pandas as pd
import pytest
from graded_results import graded, queried, results_of
from scipy import stats

from pipeline.batch.fruits_table import Given
from pipeline.batch.records import FruitRecord
from pipeline.history.history_table import fruit_table
from pipeline.history.lot_database import history_store
from pipeline.history.lot_history import history_entry
from pipeline.history.stored_batch import stored_batch
from pipeline.history.table_file import table_bytes
from pipeline.problem import BatchRefused
from reports.history_page import history_html

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


def test_the_page_states_how_fast_lots_soften_as_least_squares_do(tmp_path):
    """Of balanced lots: the slopes of ln E by scipy, their mean, and its interval from their spread."""
    rng, days, outs, slopes, squares = np.random.default_rng(4), (0, 3, 6), [], {}, []
    for lot, k in {"1": 0.06, "2": 0.10, "3": 0.15}.items():
        logs = {day: -k * day + rng.normal(0, 0.05, 5) for day in days}
        for day, ln_E in logs.items():
            E = {f"N{j}": float(E_MPa) for j, E_MPa in enumerate(np.exp(ln_E))}
            outs.append(day_of(tmp_path / f"{lot}-{day}", E, lot=lot, day=f"2026-08-{10 + day}"))
        t, ln_E = np.repeat(days, 5), np.concatenate(list(logs.values()))
        line = stats.linregress(t, ln_E)
        slopes[lot] = line.slope
        squares.append(np.sum((ln_E - line.intercept - line.slope * t) ** 2))
    entry = history_entry([stored_batch(out) for out in outs], now=NOW)
    page = re.sub(r"<[^>]+>", "", history_html(entry)).replace("\u00a0", " ")
    fell = [float(rate) for rate in re.findall(r"E falls by ([\d.]+) % a day", page)]
    half_lives = [float(half) for half in re.findall(r"the half-life is ([\d.]+) days", page)]
    assert fell == pytest.approx([-100 * math.expm1(slope) for slope in slopes.values()], abs=0.051)
    assert half_lives == pytest.approx([-math.log(2) / slope for slope in slopes.values()], abs=0.051)
    common = r"changes by (.+?) % a day \((.+?) to (.+?) %, 90 %\)\. The standard deviation .+? is (.+?) %\."
    stated = [float(number.replace("−", "-")) for number in re.search(common, page).groups()]
    mean, spread = np.mean(list(slopes.values())), np.std(list(slopes.values()), ddof=1)
    half = stats.norm.ppf(0.95) * spread / math.sqrt(3)
    of_fit = np.sum(squares) / (3 * 15 - 6) / np.sum((np.repeat(days, 5) - 3) ** 2)
    changes = [100 * math.expm1(rate) for rate in (mean, mean - half, mean + half)]
    assert stated[:3] == pytest.approx(changes, abs=0.15)
    assert stated[3] == pytest.approx(100 * math.sqrt(spread**2 - of_fit) * math.exp(mean), abs=0.15)
    of_lots = re.search(r"Change of E of each lot, % a day: 1 (\S+), 2 (\S+), 3 (\S+)\.", page)
    assert [float(change.replace("−", "-")) for change in of_lots.groups()] == pytest.approx(
        [100 * math.expm1(slope) for slope in slopes.values()], abs=0.6
    )  # the model draws each towards the mean


def test_the_mean_of_one_day_has_students_interval(tmp_path):
    """Of two fruit, by scipy on ln E."""
    E = {"A": 0.6, "B": 1.35}
    (series,) = history_entry([stored_batch(day_of(tmp_path / "out", E))], now=NOW).series
    logs = np.log(list(E.values()))
    low, high = np.exp(stats.t.interval(0.9, 1, loc=logs.mean(), scale=stats.sem(logs)))
    (day,) = series.days
    assert (day.E_low_MPa, day.E_high_MPa) == pytest.approx((low, high))


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
    first = drupe("history", *three_days[:2], "--store", store, status=0)
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
    assert "3 batches (0 new)" in drupe("history", "--store", store, "--html", page).out


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
    assert said in drupe("history", *arguments, status=2).err
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert {path: data for path, data in after.items() if path in before} == before
    assert {path.name for path in after if path not in before} <= {"S"}


def test_nothing_of_a_failed_run_is_kept(drupe, three_days, tmp_path):
    store = tmp_path / "lots.sqlite"
    drupe("history", three_days[0], "--store", store)
    drupe("history", three_days[1], "--store", store, "--firmness", "brix=N@8mm", status=2)
    with history_store(store) as opened:
        assert len(opened.batches()) == 1


def kept_in(store):
    with history_store(store) as opened:
        return opened.batches()


def day_of(out, E, *, lot="7", day="2026-08-10", scale="a", extra=(), **settings):
    """Results of a day; `scale`: of recordings, whose files change with it."""
    inputs = {f"fruits/{name}/grasps/g.h5": f"{name}{scale}" for name in E}
    return results_of(
        out,
        [*(graded(name, E_MPa) for name, E_MPa in E.items()), *extra],
        day=day,
        lot=lot,
        inputs=inputs,
        **settings,
    )


def two_lots(root):
    """Results of a day of lots 7 and 8."""
    return [day_of(root / "b" / "results", DAY), day_of(root / "c" / "results", DAY, scale="c", lot="8")]


DAY = {"A": 0.8, "B": 0.9, "C": 1.0, "D": 1.1}
FIVE = {**DAY, "E": 1.2}


@pytest.mark.parametrize(
    ("again", "count"),
    [
        (lambda root: day_of(root / "b" / "results", FIVE), 5),
        (lambda root: day_of(root / "b" / "other", FIVE), 5),
        (lambda root: day_of(root / "moved" / "results", FIVE), 5),
        (lambda root: day_of(root / "b" / "results", {n: 1.1 * E for n, E in DAY.items()}, scale="b"), 4),
        (lambda root: day_of(root / "b" / "results", DAY, lot="8"), 4),
        (lambda root: day_of(root / "b" / "results", DAY, day="2026-08-11"), 4),
        (lambda root: day_of(root / "b" / "results", {"A": 0.8}), 4),
    ],
    ids=["fruit added", "other --out", "moved", "recalibrated", "lot corrected", "graded later", "one fruit"],
)
def test_a_batch_graded_again_is_counted_once(drupe, tmp_path, again, count):
    store = tmp_path / "lots.sqlite"
    drupe("history", day_of(tmp_path / "b" / "results", DAY), "--store", store)
    out = again(tmp_path)
    done = drupe("history", out, "--store", store)
    assert "1 batch (0 new), 1 lot\n" in done.out
    assert f"1 day, {count} fruit on 2026-08-10" in done.out
    drupe("history", out, "--store", store)
    (batch,) = kept_in(store)
    said = stored_batch(out)
    assert {fruit.fruit_id: fruit.E_MPa for fruit in batch.fruit} == {
        **DAY,
        **{fruit.fruit_id: fruit.E_MPa for fruit in said.fruit},
    }
    assert batch.lot == said.lot


@pytest.mark.parametrize(
    "other",
    [{"day": "2026-08-12"}, {"lot": "8"}, {"day": "2026-08-12", "measured_on": "2026-08-12"}],
    ids=["another day", "another lot", "another day by its settings"],
)
def test_other_recordings_of_the_same_ids_are_another_batch(tmp_path, other):
    with history_store(None) as store:
        store.add(stored_batch(day_of(tmp_path / "b" / "results", DAY)))
        store.add(stored_batch(day_of(tmp_path / "b" / "results-2", DAY, scale="b", **other)))
        assert len(store.batches()) == 2


def test_the_latest_graded_counts_whichever_is_read_last_and_the_page_says_how_many_are_kept(drupe, tmp_path):
    new = day_of(tmp_path / "b" / "new", {n: 2 * E for n, E in DAY.items()}, day="2026-08-11")
    old = day_of(tmp_path / "b" / "old", DAY)
    store, page = tmp_path / "s", tmp_path / "h.html"
    drupe("history", new, "--store", store)
    done = drupe("history", old, "--store", store, "--html", page)
    (batch,) = kept_in(store)
    assert {f.fruit_id: f.E_MPa for f in batch.fruit} == {n: 2 * E for n, E in DAY.items()}
    said = (
        "1 of its batches was graded again: the newest results count, and the store keeps 1 earlier revision"
    )
    assert said in done.out
    assert said in page.read_text()


def test_a_fruit_that_is_lost_when_graded_again_no_longer_counts(tmp_path):
    lost = FruitRecord(fruit_id="D", outcome="no-photos", key="k", given=Given())
    three = {name: DAY[name] for name in "ABC"}
    with history_store(None) as store:
        store.add(stored_batch(day_of(tmp_path / "b" / "results", DAY)))
        store.add(stored_batch(day_of(tmp_path / "b" / "results", three, day="2026-08-11", extra=[lost])))
        (batch,) = store.batches()
    assert ([f.fruit_id for f in batch.fruit], batch.lost) == (["A", "B", "C"], ("D",))


def renamed_day(out, ids, **settings):
    """Results of a day whose fruit A to D have other ids, with the same recordings."""
    E = {ids.get(name, name): E_MPa for name, E_MPa in DAY.items()}
    inputs = {f"fruits/{ids.get(name, name)}/grasps/g.h5": f"{name}a" for name in DAY}
    return results_of(
        out, [graded(name, E_MPa) for name, E_MPa in E.items()], lot="7", inputs=inputs, **settings
    )


@pytest.mark.parametrize(
    ("place", "ids"),
    [
        ("b", {"D": "X"}),
        ("moved", {n: f"new-{n}" for n in DAY}),
        ("dated", {n: f"new-{n}" for n in DAY}),
        ("b", {"C": "D", "D": "C"}),
        ("b", {"C": "D", "D": "X"}),
    ],
    ids=["one", "all, and the folder moved", "all, and dated", "two swapped", "a chain"],
)
def test_a_renamed_fruit_is_counted_once_and_forgotten_with_its_former_id(drupe, tmp_path, place, ids):
    store, first = tmp_path / "s", day_of(tmp_path / "b" / "results", DAY)
    dated = {"measured_on": "2026-08-11"} if place == "dated" else {}
    later = renamed_day(tmp_path / place / "again", ids, day="2026-08-11", **dated)
    for outs in ((first, later), (later, first), (first,)):  # in either order, and once more
        done = drupe("history", *outs, "--store", store)
        assert "1 batch (" in done.out
        assert "4 fruit on 2026-08-1" in done.out
        assert "lack" not in done.out
        (batch,) = kept_in(store)
        assert {f.fruit_id: f.E_MPa for f in batch.fruit} == {ids.get(n, n): E for n, E in DAY.items()}
        assert batch.revisions == 1
    drupe("history", "--store", store, "--forget", f"7/{ids.get('D', 'D')}")
    (batch,) = kept_in(store)
    assert {f.fruit_id for f in batch.fruit} == {ids.get(n, n) for n in "ABC"}


def test_a_fruit_renamed_and_back_has_its_first_id_and_a_copied_recording_replaces_no_fruit(tmp_path):
    first = stored_batch(day_of(tmp_path / "b" / "results", DAY))
    other = stored_batch(renamed_day(tmp_path / "b" / "other", {"D": "X"}, day="2026-08-11"))
    with history_store(None) as store:
        for revision in (first, other, replace(first, graded_utc="2026-08-12T08:00:00+00:00")):
            store.add(revision)
        (batch,) = store.batches()
        assert [f.fruit_id for f in batch.fruit] == [*"ABCD"]
    copy = replace(other.fruit[-1], grasps=first.fruit[0].grasps)
    assert copy.fruit_id == "X"
    both = replace(other, fruit=(*first.fruit, copy), listed=(*"ABCD", "X"))
    with history_store(None) as store:
        for revision in (first, both):
            store.add(revision)
        (batch,) = store.batches()
    assert [f.fruit_id for f in batch.fruit] == [*"ABCDX"]


def test_a_fruit_that_the_latest_results_lack_counts_and_is_named_until_it_is_forgotten(drupe, tmp_path):
    store, page = tmp_path / "s", tmp_path / "h.html"
    drupe("history", day_of(tmp_path / "b" / "results", DAY), "--store", store)
    fewer = day_of(tmp_path / "b" / "again", {n: DAY[n] for n in "AB"}, day="2026-08-11")
    done = drupe("history", fewer, "--store", store, "--html", page)
    assert "4 fruit on 2026-08-10" in done.out
    (batch,) = kept_in(store)
    said = (
        "lack C, D, which earlier results contain; they still count. To remove one from a store: "
        f"--forget {batch.key}/C"
    )
    assert said in done.out
    assert said in page.read_text()
    drupe("history", "--store", store, "--forget", f"{batch.key}/C")
    done = drupe("history", "--store", store)
    assert "3 fruit on 2026-08-10" in done.out
    assert "lack D, which earlier results contain; it still counts" in done.out


@pytest.mark.parametrize(
    ("named", "left"),
    [("7", [("8", 4)]), ("b", [("8", 4)]), ("7/A", [("7", 3), ("8", 4)]), ("NAME/B", [("7", 3), ("8", 4)])],
)
def test_what_is_named_is_forgotten_and_nothing_else(drupe, tmp_path, named, left):
    store = tmp_path / "s"
    outs = two_lots(tmp_path)
    drupe("history", *outs, "--store", store)
    named = named.replace("NAME", next(batch.key for batch in kept_in(store) if batch.lot == "7"))
    files = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    listed = drupe("history", "--store", store, "--forget", named, "--dry-run")
    assert {path: path.read_bytes() for path in files} == files
    done = drupe("history", "--store", store, "--forget", named)
    assert done.out == listed.out.replace("would forget", "forgotten")
    assert "lot 7, measured 2026-08-10" in done.out
    assert sorted((batch.lot, len(batch.fruit)) for batch in kept_in(store)) == left
    files.pop(store)
    assert {path: path.read_bytes() for path in files} == files


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--store", "s", "--forget", "9"), 'contains no batch, lot or fruit "9"'),
        (("--store", "s", "--forget", "7/Z"), 'contains no batch, lot or fruit "7/Z"'),
        (("--forget", "7"), "--forget needs a store"),
        (("--store", "none", "--forget", "7"), "--forget needs a store"),
        (("b/results", "--store", "s", "--forget", "7"), "--forget allows only --store and --dry-run"),
        (("--store", "s", "--dry-run"), "--dry-run shows the effect of --forget"),
    ],
)
def test_what_cannot_be_forgotten_is_said(drupe, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    drupe("history", day_of(tmp_path / "b" / "results", DAY), "--store", "s")
    before = (tmp_path / "s").read_bytes()
    assert said in drupe("history", *arguments, status=2).err
    assert (tmp_path / "s").read_bytes() == before
    assert not (tmp_path / "none").exists()


def flipped(path, place):
    data = bytearray(path.read_bytes())
    data[place % len(data)] ^= 1 << (place % 8)
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(
    "damaged", ["batch.json", "fruits/A/record.json", ".written.json", "fruits/B/.written.json"]
)
def test_no_flipped_bit_of_results_is_used(tmp_path, damaged):
    """What `damaged` names is refused by its name, or is read as it was written."""
    sound = day_of(tmp_path / "b" / "results", DAY)
    expected, path = stored_batch(sound), sound / damaged
    data = path.read_bytes()
    for place in np.random.default_rng(1).integers(0, 8 * len(data), 25):
        flipped(path, int(place))
        try:
            assert stored_batch(sound) == expected
        except BatchRefused as refused:
            (problem,) = refused.problems
            name = damaged.replace(".written.json", "record.json" if "fruits" in damaged else "batch.json")
            assert str(sound / name) in str(problem)
        path.write_bytes(data)


def test_no_flipped_bit_of_a_store_is_used_and_a_damaged_batch_is_named_and_forgotten(drupe, tmp_path):
    store = tmp_path / "s"
    outs = two_lots(tmp_path)
    drupe("history", *outs, "--store", store)
    expected = kept_in(store)
    data, refusals = store.read_bytes(), 0
    for place in np.random.default_rng(2).integers(0, 8 * len(data), 60):
        flipped(store, int(place))
        try:
            assert kept_in(store) == expected
        except BatchRefused as refused:
            assert str(store) in str(refused.problems[0])  # noqa: PT017 - one of two right endings
            refusals += 1
        store.write_bytes(data)
    assert refusals > 3  # most of the file is not in use
    key = next(batch.key for batch in expected if batch.lot == "7")
    with sqlite3.connect(store) as other:
        other.execute("UPDATE fruit SET E_MPa = 0.8 WHERE fruit_id = 'B'")
    other.close()
    done = drupe("history", "--store", store, status=2)
    assert f"batch {key} is damaged" in done.err
    assert f"--forget {key}" in done.err
    for batch in expected:
        assert "fruit A, B, C, D" in drupe("history", "--store", store, "--forget", batch.key).out
    assert drupe("history", *outs, "--store", store).status == 0
    assert kept_in(store) == expected


@pytest.mark.parametrize("ending", [".csv", ".xlsx"])
def test_a_lot_that_is_a_formula_has_a_cell_that_is_none(tmp_path, ending):
    batch = stored_batch(day_of(tmp_path / "b" / "results", DAY, lot="7;=cmd|' /C calc'!A0"))
    file = io.BytesIO(table_bytes(fruit_table([batch]), ending))
    table = pd.read_csv(file) if ending == ".csv" else pd.read_excel(file, engine="openpyxl")
    assert set(table["lot"]) == {"7;'=cmd|' /C calc'!A0"}


TABLES = ("result", "fruit", "grasp")


@pytest.mark.parametrize(
    ("sql", "said"),
    [
        (
            "UPDATE alembic_version SET version_num = 'of_2027'",
            'comes from another version of drupe (its tables are "of_2027"); update drupe',
        ),
        (
            "DROP TABLE alembic_version",
            "comes from a development version of drupe; create a new store from the results folders",
        ),
    ],
)
def test_a_store_of_another_drupe_is_refused(tmp_path, sql, said):
    with history_store(tmp_path / "s"):
        pass
    queried(tmp_path / "s", sql)
    with pytest.raises(BatchRefused) as refused, history_store(tmp_path / "s"):
        pass
    assert str(refused.value.problems[0]) == f"{tmp_path / 's'}: {said}; name another file with --store."


def test_writers_at_once_all_succeed(tmp_path):
    store, writers = tmp_path / "s", 6
    batches = [
        stored_batch(results_of(tmp_path / f"b{k}", [graded("A", 1.0 + k)], lot=f"{k}"))
        for k in range(writers)
    ]
    start = Barrier(writers)

    def write(batch):
        start.wait()
        with history_store(store) as stored:
            return stored.add(batch)

    with ThreadPoolExecutor(writers) as pool:
        assert list(pool.map(write, batches)) == [True] * writers
    with history_store(store) as stored:
        assert sorted(batch.lot for batch in stored.batches()) == sorted(batch.lot for batch in batches)


def test_a_corrected_lot_has_both_names_and_what_is_forgotten_leaves_no_row(tmp_path):
    store = tmp_path / "s"
    described = {
        "orchard": "north", "operator": "Ada", "gripper": {"name": "G1", "serial": "1"},
        "sensor": {"name": "gel", "calibration": "C1", "calibrated_on": "2026-08-01"},
    }  # fmt: skip
    inputs = {"fruits/A/grasps/g.h5": "1"}
    for lot, day in (("wrong", "2026-08-10"), ("right", "2026-08-11")):
        out = results_of(tmp_path / lot, [graded("A", 1.0)], lot=lot, day=day, inputs=inputs, **described)
        with history_store(store) as stored:
            stored.add(stored_batch(out))
    trail = queried(
        store,
        "SELECT lot, orchard, operator, gripper, gripper_serial, sensor, calibration, calibrated_on, "
        "revision FROM result ORDER BY revision",
    )
    same = ("north", "Ada", "G1", "1", "gel", "C1", "2026-08-01")
    assert trail == [("wrong", *same, 0), ("right", *same, 1)]
    with history_store(store) as stored:
        (batch,) = stored.batches()
        assert (batch.lot, batch.calibrated_on) == ("right", date(2026, 8, 1))
        stored.forget("right")
    for table in TABLES:
        assert queried(store, f"SELECT count(*) FROM {table}") == [(0,)]


def test_a_changed_lot_is_noticed(tmp_path):
    store = tmp_path / "s"
    with history_store(store) as stored:
        stored.add(stored_batch(results_of(tmp_path / "b", [graded("A", 1.0)], lot="7")))
    queried(store, "UPDATE result SET lot = '8'")
    with pytest.raises(BatchRefused) as refused, history_store(store):
        pass
    assert "is damaged (its SHA-256 differs)" in str(refused.value.problems[0])
