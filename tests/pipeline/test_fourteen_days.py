"""Fourteen days, two grippers, ten fruit each: a day graded again, a new calibration, a lot corrected.

The truth is a table of pandas that is made beside the results, never from the store.
"""

from datetime import UTC, date, datetime, timedelta
from functools import partial
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from graded_results import graded as graded_fruit
from graded_results import queried, results_of
from scipy.stats import ttest_1samp
from statsmodels.stats.proportion import proportion_confint

from pipeline.history.keeping import HistoryWanted, make_history
from pipeline.history.lot_database import history_store
from pipeline.history.lot_history import history_entry
from reports.grasp_record import GraspRecord
from reports.history_charts import lots_chart
from reports.palette import class_marks

NOW = datetime(2026, 8, 30, 12, tzinfo=UTC)
CLASSES = {
    "classes": [{"name": "ready", "E_max_MPa": 0.5}, {"name": "turning", "E_max_MPa": 0.7}, {"name": "firm"}]
}
DAYS, GRIPPERS, FRUIT = 14, ("G1", "G2"), 10
FIRST = date(2026, 8, 1)
NEW_SENSOR = 8
"""Day from which the sensor of G1 has its second calibration."""


class Season:
    """Writes results of batches, and keeps in `rows` what counts."""

    def __init__(self, root):
        self.root, self.rng, self.rows = root, np.random.default_rng(59), {}
        self.outs = []

    def grade(self, day, gripper, *, lot=None, factor=None, scale="a", calibration=None, graded=0):
        """One batch; without `factor` with fruit drawn anew, else with E by that factor."""
        lot = lot or "ABC"[day % 3]
        calibration = calibration or ("C2" if gripper == "G1" and day >= NEW_SENSOR else "C1")
        name, measured = f"{day:02d}-{gripper}", FIRST + timedelta(days=day)
        bias = 1.03 if gripper == "G2" else 1.0
        records, inputs = [], {}
        for k in range(FRUIT):
            key = (day, gripper, f"F{k}")
            fresh = bias * 0.9 * np.exp(-0.04 * day + self.rng.normal(0, 0.12))
            E = float(fresh if factor is None else factor * self.rows[key]["E"])
            self.rows[key] = {
                "day": day, "gripper": gripper, "fruit_id": f"F{k}", "measured_on": f"{measured}", "lot": lot,
                "E": E, "calibration": calibration,
            }  # fmt: skip
            grasps = tuple(
                GraspRecord(grasp=grasp, E_MPa=E * by) for grasp, by in (("g1", 0.99), ("g2", 1.01))
            )
            records.append(graded_fruit(f"F{k}", E, changes={"grasps": grasps}))
            inputs |= {f"fruits/F{k}/grasps/g{n}.h5": f"{name} F{k} {n} {scale}" for n in (1, 2)}
        out = self.root / name / f"results-{len(self.outs)}"
        self.outs.append(
            results_of(
                out,
                records,
                day=f"{measured + timedelta(days=graded)}",
                measured_on=f"{measured}",
                lot=lot,
                cultivar="Big Top",
                operator="Ada",
                orchard="north",
                inputs=inputs,
                grading=CLASSES,
                gripper={"name": gripper},
                sensor={"name": f"gel of {gripper}", "calibration": calibration},
            )
        )
        return self.outs[-1]

    @property
    def truth(self):
        """What counts, as a table."""
        return pd.DataFrame(self.rows.values())


@pytest.fixture(scope="module")
def season(tmp_path_factory):
    """The store after all that happened, the last history made of it, the truth, and tables."""
    root = tmp_path_factory.mktemp("season")
    store, harvest = root / "lots.sqlite", Season(root)
    made = {ending: root / f"fruit{ending}" for ending in (".csv", ".xlsx", ".parquet", ".json")}
    for days in (range(7), range(7, DAYS)):
        outs = []
        for day in days:
            lot = "X" if day == 9 else None  # the label of G2 on this day was wrong
            outs += [harvest.grade(day, "G1"), harvest.grade(day, "G2", lot=lot)]
        make_history(outs, HistoryWanted(store=store), now=NOW)
    again = [harvest.grade(5, gripper, factor=1.1, graded=15) for gripper in GRIPPERS]
    again += [harvest.grade(7, "G1", factor=0.95, scale="b", calibration="C2", graded=16)]
    again += [harvest.grade(9, "G2", factor=1.0, graded=17)]
    last = make_history(again, HistoryWanted(store=store, gauge=("gripper",)), now=NOW)
    for path in made.values():
        wanted = HistoryWanted(
            store=store, export=path, statistics=root / f"lots{path.suffix}", precision=0.1
        )
        make_history((), wanted, now=NOW)
    return SimpleNamespace(root=root, store=store, last=last, truth=harvest.truth, made=made)


def test_every_count_is_right(season):
    assert (season.last.new, season.last.entry.batches) == (0, DAYS * len(GRIPPERS))
    assert len(season.truth) == 280
    by_lot = season.truth.groupby("lot").size()
    counts = {lot.lot: sum(day.fruit for day in lot.days) for lot in season.last.entry.series}
    assert counts == by_lot.to_dict()
    assert queried(season.store, "SELECT count(*) FROM result") == [(28 + 4,)]
    assert queried(season.store, "SELECT count(*) FROM grasp") == [(2 * 10 * 32,)]
    assert queried(season.store, "SELECT count(DISTINCT gripper) FROM result") == [(2,)]
    assert queried(
        season.store, "SELECT count(*) FROM (SELECT DISTINCT sensor, calibration FROM result)"
    ) == [(3,)]


def test_the_page_says_that_both_grippers_measured_the_same_ids(season):
    for lot in season.last.entry.series:
        first, *_, last = sorted(season.truth.loc[season.truth["lot"] == lot.lot, "measured_on"].unique())
        (said,) = (note for note in lot.notes if "the same fruit ids" in note)
        assert said.startswith(f"several batches contain the same fruit ids on each of {first}, ")
        assert last in said


def test_what_was_replaced_stays(season):
    by_revision = queried(
        season.store, "SELECT revision, lot FROM result WHERE measured = '2026-08-10' AND gripper = 'G2'"
    )
    assert sorted(by_revision) == [(0, "X"), (1, "A")]
    E = queried(
        season.store,
        "SELECT revision, avg(E_MPa) FROM fruit JOIN result ON result.id = fruit.result "
        "WHERE measured = '2026-08-06' GROUP BY revision ORDER BY revision",
    )
    assert E[1][1] == pytest.approx(1.1 * E[0][1])
    calibrations = queried(
        season.store,
        "SELECT revision, calibration FROM result "
        "WHERE measured = '2026-08-08' AND sensor = 'gel of G1' ORDER BY revision",
    )
    assert calibrations == [(0, "C1"), (1, "C2")]


@pytest.mark.parametrize(
    ("ending", "read"),
    [
        (".csv", pd.read_csv),
        (".xlsx", partial(pd.read_excel, engine="openpyxl")),
        (".parquet", pd.read_parquet),
        (".json", pd.read_json),
    ],
)
def test_every_format_has_every_fruit_with_lot_dates_and_gripper(season, ending, read):
    table = read(season.made[ending])
    key = ["measured_on", "gripper", "fruit_id", "lot", "calibration"]
    table["measured_on"] = table["measured_on"].astype(str).str[:10]
    both = season.truth.merge(table, on=key, how="outer", validate="one_to_one", indicator=True)
    assert (both["_merge"] == "both").all()
    assert both["E_MPa"].to_numpy() == pytest.approx(both["E"].to_numpy(), rel=5e-4)  # four figures
    assert (both["grasps"] == 2).all()
    assert (
        both["maturity"].tolist()
        == pd.cut(both["E"], [0, 0.5, 0.7, 99], labels=["ready", "turning", "firm"]).tolist()
    )
    assert not table[["graded_utc", "orchard", "operator", "sensor", "batch"]].isna().any().any()
    assert set(table["revision"]) == {0, 1}


def test_statistics_of_every_lot_and_day_are_those_of_pandas(season):
    table = pd.read_json(season.root / "lots.json")
    table["measured_on"] = table["measured_on"].astype(str).str[:10]
    assert len(table) == 3 * 14
    days = season.truth.groupby(["lot", "measured_on"])["E"]
    for row in table.itertuples():
        E = days.get_group((row.lot, row.measured_on))
        assert row.n == len(E)
        assert (row.mean_E_MPa, row.sd_E_MPa) == pytest.approx((E.mean(), E.std()))
        shares = [row.p10_E_MPa, row.p25_E_MPa, row.p50_E_MPa, row.p75_E_MPa, row.p90_E_MPa]
        assert shares == pytest.approx(E.quantile([0.1, 0.25, 0.5, 0.75, 0.9]).tolist())
        low, high = {"ready": (0, 0.5), "turning": (0.5, 0.7), "firm": (0.7, 99)}[row.maturity]
        outside = int((~E.between(low, high, inclusive="right")).sum())
        interval = np.nan_to_num(proportion_confint(outside, len(E), alpha=0.1, method="beta"), nan=0.0)
        assert row.share_outside == pytest.approx(outside / len(E))
        assert [row.share_outside_low, row.share_outside_high] == pytest.approx(list(interval))
        assert row.grippers == "G1; G2"


def test_the_second_gripper_reads_more_by_the_paired_test_of_another_library(season):
    ln_E = season.truth.assign(ln_E=np.log(season.truth["E"])).pivot_table(
        index=["lot", "measured_on"], columns="gripper", values="ln_E"
    )
    test = ttest_1samp(ln_E["G2"] - ln_E["G1"], 0)
    low, high = (100 * np.expm1(x) for x in test.confidence_interval(0.9))
    mean = 100 * np.expm1((ln_E["G2"] - ln_E["G1"]).mean())
    said = (
        f"gripper G2 reads {mean:+.1f} % ({low:+.1f} to {high:+.1f} %, 90 %; p = {test.pvalue:.2g}) against"
    )
    assert any(comparison.startswith(said) for comparison in season.last.entry.comparisons)


def test_the_page_has_a_line_and_a_mark_per_day_for_every_lot_in_colours_of_the_palette(season):
    (group,) = season.last.entry.groups
    layers = lots_chart(group)["layers"]
    days = season.truth.groupby("lot")["measured_on"].nunique()
    marks = class_marks(("A", "B", "C")).values()
    for k, (count, (colour, shape)) in enumerate(zip(days, marks, strict=True)):
        line, means = layers[2 * k : 2 * k + 2]
        assert (line["kind"], line["colour"], len(line["x"])) == ("line", colour, count)
        assert (means["kind"], means["colour"], means["shape"]) == ("marks", colour, shape)
        assert (means["x"], means["y"]) == (line["x"], line["y"])


def test_the_order_of_days_in_the_store_changes_nothing(season):
    with history_store(season.store) as stored:
        batches = stored.batches()
    forth, back = (history_entry(order, now=NOW) for order in (batches, batches[::-1]))
    assert [lot.softening_words for lot in forth.series] == [lot.softening_words for lot in back.series]
    assert sorted(forth.groups[0].rates) == ["A", "B", "C"]
    assert forth.groups[0].rates == pytest.approx(back.groups[0].rates, rel=1e-4)
