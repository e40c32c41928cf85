"""Statistics of lots and readings of penetrometers, against other libraries, refits and closed forms."""

import csv
import math
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from unicodedata import normalize

import numpy as np
import pytest
from graded_results import graded, results_of
from scipy.stats import linregress
from scipy.stats import t as student
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW

from pipeline.history.appraisers import gauge_study
from pipeline.history.firmness_relation import NoReading, firmness_relation, firmness_relations, reading_of
from pipeline.history.lot_statistics import (
    class_ranges,
    lot_differences,
    lot_statistics,
    needed_fruit,
    out_of_control,
)
from pipeline.history.lots_softening import lots_softening
from pipeline.history.objective_test import objective_samples
from pipeline.history.softening import DAY_SD, reached, softening_of
from pipeline.history.stored_batch import StoredBatch, StoredFruit, StoredGrasp
from reports.charts import control_chart
from reports.entries import RatioPoint, ReferenceBodyEntry
from reports.words import lot_words

AIAG = """
 0.29 -0.56 1.34  0.47 -0.80  0.02  0.59 -0.31 2.26 -1.36
 0.41 -0.68 1.17  0.50 -0.92 -0.11  0.75 -0.20 1.99 -1.25
 0.64 -0.58 1.27  0.64 -0.84 -0.21  0.66 -0.17 2.01 -1.31
 0.08 -0.47 1.19  0.01 -0.56 -0.20  0.47 -0.63 1.80 -1.68
 0.25 -1.22 0.94  1.03 -1.20  0.22  0.55  0.08 2.12 -1.62
 0.07 -0.68 1.34  0.20 -1.28  0.06  0.83 -0.34 2.19 -1.50
 0.04 -1.38 0.88  0.14 -1.46 -0.29  0.02 -0.46 1.77 -1.49
-0.11 -1.13 1.09  0.20 -1.07 -0.67  0.01 -0.56 1.45 -1.77
-0.15 -0.96 0.67  0.11 -1.45 -0.49  0.21 -0.49 1.87 -2.16
"""
"""Readings of the manual's example: three appraisers, three trials each, of ten parts."""


def test_the_manuals_example_has_the_manuals_components():
    readings = np.array(AIAG.split(), dtype=float).reshape(3, 3, 10).transpose(2, 0, 1)
    study = gauge_study(readings)
    components = (study.repeatability, study.reproducibility, study.gauge, study.part)
    assert components == pytest.approx((0.199933, 0.226838, 0.302373, 1.042327), abs=1e-5)
    assert study.percent(study.gauge) == pytest.approx(27.9, abs=0.05)
    assert study.categories == 4
    assert study.words.endswith("27.9 % of the total variation; distinct categories: 4")


def test_readings_that_repeat_exactly_have_no_number_of_categories():
    study = gauge_study(np.arange(3.0)[:, None, None] + np.zeros((3, 2, 2)))
    assert study.words == "gauge R&R is 0.0 % of the total variation"


def test_an_interaction_that_is_simulated_is_its_own_component():
    rng = np.random.default_rng(3)
    part, both = rng.normal(0, 2, (400, 1, 1)), rng.normal(0, 0.7, (400, 3, 1))
    study = gauge_study(part + both + rng.normal(0, 0.3, (400, 3, 2)))
    assert (study.repeatability, study.interaction, study.part) == pytest.approx((0.3, 0.7, 2.0), rel=0.1)


def test_no_class_is_dropped_where_one_before_the_last_has_no_limit():
    with pytest.raises(ValueError, match="a class before the last has no upper limit"):
        class_ranges([("ready", None), ("firm", 0.5), ("hard", None)])
    assert class_ranges([]) == []


def test_one_fruit_has_no_spread():
    assert lot_statistics([0.7], precision=0.05).sd_MPa is None
    assert lot_statistics([0.7], precision=0.05).needed is None


def test_so_many_fruit_reach_the_precision_and_one_less_does_not():
    n = needed_fruit(0.8, 0.2, precision=0.1)
    half = {m: DescrStatsW(scaled(m)).tconfint_mean(alpha=0.1)[1] - 0.8 for m in (n - 1, n)}
    assert half[n] <= 0.08 < half[n - 1]
    assert needed_fruit(1.0, 50.0, precision=0.001) is None


def scaled(n):
    """n numbers with mean 0.8 and standard deviation 0.2."""
    x = np.arange(n, dtype=float)
    return 0.8 + 0.2 * (x - x.mean()) / x.std(ddof=1)


def test_lots_differ_as_another_library_says():
    rng = np.random.default_rng(5)
    E = {"A": rng.normal(1.0, 0.1, 10), "B": rng.normal(0.9, 0.3, 14), "C": rng.normal(0.7, 0.1, 9)}
    differences = lot_differences({**E, "single": [1.0]})
    assert [difference.first + difference.second for difference in differences] == ["AB", "AC", "BC"]
    raw = []
    for difference in differences:
        other = CompareMeans(DescrStatsW(E[difference.first]), DescrStatsW(E[difference.second]))
        interval = other.tconfint_diff(alpha=0.1, usevar="unequal")
        assert (difference.low_MPa, difference.high_MPa) == pytest.approx(interval)
        raw.append(other.ttest_ind(usevar="unequal")[1])
    least, middle, largest = sorted(raw)
    by_holm = [3 * least, max(3 * least, 2 * middle), max(3 * least, 2 * middle, largest)]
    assert sorted(difference.p for difference in differences) == pytest.approx(by_holm)
    assert np.argsort([difference.p for difference in differences]).tolist() == np.argsort(raw).tolist()


def test_a_tenth_of_the_fruit_is_there_as_many_spreads_before_the_mean():
    rng, k, spread = np.random.default_rng(2), 0.1, 0.15
    E = {float(t): list(1.2 * np.exp(-k * t + spread * rng.normal(size=4000))) for t in range(12)}
    law = softening_of(E, single_sd=spread)
    mean, tenth = math.log(1.2 / 0.5) / k, (math.log(1.2 / 0.5) - 1.2816 * spread) / k
    assert reached(law, 0.5)[1] == pytest.approx(mean, abs=0.1)
    assert reached(law, 0.5, share=0.1)[1] == pytest.approx(tenth, abs=0.1)


def simulated_lots(rng, *, lots, days=(0.0, 3.0, 6.0, 9.0), fruit=10):
    rates = rng.normal(0.10, 0.03, lots)
    return {
        f"{i}": {t: list(np.exp(-rate * t + rng.normal(0, 0.1, fruit))) for t in days}
        for i, rate in enumerate(rates)
    }


def test_the_rate_of_balanced_lots_is_the_mean_of_their_own_slopes():
    """Generalised and ordinary least squares agree, and the error is the slopes' spread."""
    lots = simulated_lots(np.random.default_rng(7), lots=8)
    slopes = [
        -np.polyfit(np.repeat(list(days), 10), np.log(np.concatenate(list(days.values()))), 1)[0]
        for days in lots.values()
    ]
    law = lots_softening(lots)
    assert law.rate == pytest.approx(np.mean(slopes), rel=1e-4)
    assert law.high - law.rate == pytest.approx(1.6449 * np.std(slopes, ddof=1) / math.sqrt(8), rel=0.02)
    assert np.std(list(law.rates.values())) < np.std(slopes)  # predictions shrink towards the mean


def test_two_lots_have_no_common_rate():
    assert lots_softening(simulated_lots(np.random.default_rng(1), lots=2)) is None


START = datetime(2026, 8, 14, 9, 30, tzinfo=UTC)


@pytest.mark.parametrize(
    ("z", "said"),
    [
        ([2.9], ""),
        ([-3.1], "more than 3"),
        ([3.5, 0.2], ""),  # said when it was the last
        ([2.1, 2.2], "two of the last three"),
        ([2.1, 0.0, 2.2], "two of the last three"),
        ([2.1, 0.0, 0.0, 2.2], ""),
        ([2.1, -2.2], ""),
    ],
)
def test_the_western_electric_rules(z, said):
    rules_broken = out_of_control(np.array(z))
    assert (said in rules_broken) if said else not rules_broken


def test_a_gripper_in_control_is_seldom_called_out_of_it():
    """Rule 1 alone has 0.0027; rule 2 adds about 2 (2 Phi(-2)^2) = 0.002: one batch in two hundred."""
    z = np.random.default_rng(3).standard_normal((20_000, 3))
    assert np.mean([bool(out_of_control(deviations)) for deviations in z]) == pytest.approx(
        0.0047, abs=0.0015
    )


@pytest.mark.parametrize("count", [1, 80])
def test_the_chart_draws_a_mark_a_batch_and_four_limits(count):
    history = tuple(
        RatioPoint(time_utc=START + timedelta(days=k), lot="<A>", ratio=1.0 + 0.001 * k, sd=0.02)
        for k in range(count)
    )
    body = ReferenceBodyEntry(
        fruit_id="ball", E_known_MPa=0.5, E_known_sd_MPa=0.01, E_found_MPa=0.5, E_found_sd_MPa=0.01,
        ratio=1.0, ratio_sd=0.02, history=history,
    )  # fmt: skip
    layers = control_chart(body)["layers"]
    assert sum(len(each["x"]) for each in layers if each["kind"] == "marks") == min(count, 60)
    lines = [each["y"] for each in layers if each["kind"] == "line"]
    sd = 0.02 / history[-60:][0].ratio
    assert [line[0] for line in lines] == pytest.approx(np.exp(sd * np.array([-3, -2, 2, 3])), rel=1e-4)


def lot(rng, *, days, k, fruit=12, spread=0.15, day_sd=0.0, E0=1.2):
    return {
        float(day): list(E0 * np.exp(-k * day + day_sd * rng.normal() + spread * rng.normal(size=fruit)))
        for day in days
    }


def test_fruit_without_spread_give_the_law_back():
    law = softening_of({t: [1.2 * math.exp(-0.1 * t)] * 3 for t in (0.0, 2.0, 5.0, 9.0)}, single_sd=0.05)
    assert law.rate() == pytest.approx(0.1, rel=1e-6)
    assert reached(law, 0.6)[1] == pytest.approx(math.log(2) / 0.1, abs=0.01)


def test_equal_days_are_least_squares_by_another_library():
    E = lot(np.random.default_rng(3), days=(0, 2, 4, 7), k=0.08, day_sd=0.1)
    days = np.array(sorted(E))
    other = linregress(days, [np.log(E[day]).mean() for day in days])
    assert softening_of(E, single_sd=0.1).rate() == pytest.approx(-other.slope, rel=1e-6)


def test_one_tau_is_fieller():
    law = softening_of(lot(np.random.default_rng(8), days=(0, 2, 5), k=0.1), single_sd=0.1)
    single_tau = replace(
        law, weights=np.ones(1), a=law.a[:1], k=law.k[:1], covariance=law.covariance[:1], last=20.0
    )
    (a,), (k,), ((Vaa, Vak), (_, Vkk)) = single_tau.a, single_tau.k, single_tau.covariance[0]
    away, q = a - math.log(0.5), 1.6448536
    ends = np.roots([k**2 - q**2 * Vkk, -2 * (away * k - q**2 * Vak), away**2 - q**2 * Vaa])
    earliest, _, latest = reached(single_tau, 0.5)
    assert [earliest, latest] == pytest.approx(sorted(ends), abs=0.01)


@pytest.mark.parametrize("days", [(0, 3), (0, 2, 4), (0, 1, 2, 4, 7)])
def test_nine_intervals_in_ten_hold_the_rate_and_the_day(days):
    rng = np.random.default_rng(11)
    k, held, on_day, known = 0.12, 0, 0, 0
    true_day = math.log(1.2 / 0.5) / k
    for _ in range(300):
        drawn = lot(rng, days=days, k=k, day_sd=abs(rng.normal(scale=DAY_SD)))
        law = softening_of(drawn, single_sd=0.15)
        held += law.rate(0.05) <= k <= law.rate(0.95)
        earliest, _, latest = reached(law, 0.5)
        known += latest is not None
        low, high = (np.inf if day is None else day for day in (earliest, latest))
        on_day += min(low, law.farthest_day) <= true_day <= high
    assert 0.85 <= held / 300 <= 0.95
    assert on_day / 300 >= 0.85
    assert known >= (0 if len(days) == 2 else 60)


def test_a_lot_that_does_not_soften_has_no_day():
    law = softening_of(lot(np.random.default_rng(5), days=(0, 2, 5), k=0.0), single_sd=0.1)
    assert not law.softens
    assert reached(law, 0.5)[1] is None
    assert softening_of({0.0: [1.0, 1.1]}, single_sd=0.1) is None  # one day


@pytest.mark.parametrize(
    ("text", "column", "newtons", "plunger_mm"),
    [
        ("mt=N@8mm", "mt", 1.0, 8.0),
        ("cheek 1=kgf@11.1 mm", "cheek 1", 9.80665, 11.1),
        ("cheek 1 = lbf @ 7/16 in", "cheek 1", 4.4482216152605, 11.1),
        ("a=b=lbf@5/16in", "a=b", 4.4482216152605, 8.0),
    ],
)
def test_units_and_plungers_are_those_of_the_trade(text, column, newtons, plunger_mm):
    reading = reading_of(text)
    assert (reading.column, reading.plunger_mm) == (column, plunger_mm)
    assert reading.newtons == pytest.approx(newtons, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mt", "expected COLUMN=UNIT@PLUNGER"),
        ("mt=kg@8mm", 'found the unit "kg", expected a force: N, kgf, lbf'),
        ("mt=kgf@9mm", 'found a plunger of "9mm"'),
        ("penetrometer_N = lbf@7/16 in", 'write "penetrometer_N=N@7/16 in"'),
    ],
)
def test_what_is_no_reading_is_refused(text, said):
    with pytest.raises(NoReading, match=said):
        reading_of(text)


def fruit_and_readings(rng, n=25, power=False):
    E = np.exp(rng.uniform(-1.2, 0.4, n))
    return E, 60 * E**1.8 * np.exp(rng.normal(0, 0.06, n)) if power else 20 + 45 * E + rng.normal(0, 3, n)


@pytest.mark.parametrize("power", [False, True])
def test_the_error_is_that_of_refits_without_each_fruit(power):
    E, F = fruit_and_readings(np.random.default_rng(3), power=power)
    errors = {}
    for law in (False, True):
        x, y = (np.log(E), np.log(F)) if law else (E, F)
        left_out = []
        for k in range(len(E)):
            slope, intercept = np.polyfit(np.delete(x, k), np.delete(y, k), 1)
            predicted = intercept + slope * x[k]
            left_out.append(F[k] - (math.exp(predicted) if law else predicted))
        errors[law] = np.array(left_out)
    relation = firmness_relation(E, F)
    rms = {law: math.sqrt(np.mean(error**2)) for law, error in errors.items()}
    assert relation.power == min(rms, key=rms.get)
    assert relation.power == power
    assert relation.error_N == pytest.approx(rms[power], rel=1e-9)
    spread = [F[k] - np.delete(F, k).mean() for k in range(len(F))]
    assert relation.explained == pytest.approx(1 - np.sum(errors[power] ** 2) / np.sum(np.square(spread)))


def test_the_interval_is_the_textbooks():
    E, F = fruit_and_readings(np.random.default_rng(5))
    relation, line = firmness_relation(E, F), linregress(E, F)
    at = np.array([0.5, 1.0])
    residual_sd = line.stderr * math.sqrt(np.sum((E - E.mean()) ** 2))
    sd = residual_sd * np.sqrt(1 + 1 / len(E) + (at - E.mean()) ** 2 / np.sum((E - E.mean()) ** 2))
    half = student.ppf(0.95, len(E) - 2) * sd
    middle = line.intercept + line.slope * at
    assert not relation.power
    assert relation.predicted(at) == pytest.approx(np.stack([middle, middle - half, middle + half], axis=1))


def test_nine_of_ten_further_fruit_lie_in_the_band():
    rng = np.random.default_rng(7)
    inside = []
    for k in range(60):
        E, F = fruit_and_readings(rng, n=15, power=bool(k % 2))
        further, reading = fruit_and_readings(rng, n=40, power=bool(k % 2))
        predicted = firmness_relation(E, F).predicted(further)
        inside += [*(predicted[:, 1] <= reading) & (reading <= predicted[:, 2])]
    assert 0.86 <= np.mean(inside) <= 0.94


def test_where_E_says_nothing_there_is_no_relation():
    rng = np.random.default_rng(2)
    E = np.exp(rng.uniform(-1, 0.4, 30))
    assert "no better than their mean" in firmness_relation(E, rng.permutation(np.linspace(30, 60, 30)))
    assert "7 fruit have both E and a reading" in firmness_relation(E[:7], E[:7])
    assert "spans a factor of 1.01" in firmness_relation(np.linspace(1, 1.01, 9), E[:9])


def stored(fruit, *, lot="7", cultivar="A"):
    return StoredBatch(
        key=lot + cultivar,
        folder="f",
        measured=date(2026, 8, 12),
        graded_utc="2026-08-12T12:00:00Z",
        category="peach",
        cultivar=cultivar,
        lot=lot,
        fruit=tuple(fruit),
    )


def test_cheeks_are_averaged_and_plungers_and_cultivars_kept_apart():
    E, F = fruit_and_readings(np.random.default_rng(1), n=12)
    columns = [{"c1": f / 9.80665 - 0.2, "c2": f / 9.80665 + 0.2, "wide": 2 * f, "note": "x"} for f in F]
    fruit = [
        StoredFruit(fruit_id=f"N{k}", E_MPa=float(e), E_sd_MPa=0.02, columns=columns[k])
        for k, e in enumerate(E)
    ]
    readings = [reading_of(text) for text in ("c1=kgf@8mm", "c2=kgf@8mm", "wide=N@11.1mm")]
    relations = list(firmness_relations([stored(fruit), stored(fruit[:3], cultivar="B")], readings))
    assert [(lot_words(group), plunger_mm) for (group, plunger_mm), _, _ in relations] == [
        *[("peach A", 8.0), ("peach A", 11.1)],
        *[("peach B", 8.0), ("peach B", 11.1)],
    ]
    assert relations[0][1].reading_N == pytest.approx(F)
    assert relations[1][1].reading_N == pytest.approx(2 * F)
    assert relations[2][2] is None
    assert "not fitted: 3 fruit" in relations[2][1].words
    with pytest.raises(
        NoReading, match='"note" of --firmness; its 12 cells have text or a number not above 0'
    ):
        list(firmness_relations([stored(fruit)], [*readings, reading_of("note=N@8mm")]))


def test_a_fruit_in_two_batches_of_one_day_is_one_fruit():
    """One batch per gripper: E is the geometric mean, readings are averaged, recordings are cheeks."""
    E, F = fruit_and_readings(np.random.default_rng(8), n=10)
    batches = [
        stored(
            StoredFruit(
                fruit_id=f"N{k}",
                E_MPa=float(E[k] * factor),
                E_sd_MPa=0.02,
                columns={"mt": float(F[k] + more)},
                grasps=(StoredGrasp(recording=f"{more} {k}", E_MPa=float(E[k] * factor)),),
            )
            for k in range(10)
        )
        for factor, more in ((1.25, -1.0), (0.8, 1.0))
    ]
    ((_, entry, relation),) = firmness_relations(batches, [reading_of("mt=N@8mm")])
    assert entry.E_MPa == pytest.approx(E)
    assert entry.reading_N == pytest.approx(F)
    assert relation.fit.nobs == 10
    (sample,) = objective_samples(batches, 1)
    assert (sample.fruit, sample.cheeks_missing) == (10, ())
    assert [both for both, _ in sample.cheeks[0][1]] == pytest.approx([1.25 * E[0], 0.8 * E[0]])
    (again,) = objective_samples([batches[0], batches[0]], 1)
    assert (again.fruit, len(again.cheeks_missing)) == (10, 10)  # the same recordings are no second cheek


def test_the_command_fits_and_predicts_within_the_range_alone(drupe, tmp_path):
    E, F = fruit_and_readings(np.random.default_rng(4), n=20)
    fruit = [graded(f"N{k}", float(E[k]), columns={"mt": float(F[k] / 4.4482216)}) for k in range(20)]
    body = graded("ball", 0.8, reference=True, reference_E_MPa=0.8, penetrometer_N=40.0)
    out = results_of(tmp_path / "out", [*fruit, graded("new", 0.7), graded("hard", 9.0), body], lot="7")
    page, table = tmp_path / "h.html", tmp_path / "t.csv"
    ran = drupe("history", out, "--firmness", "mt=lbf@5/16in", "--html", page, "--export", table)
    assert "nectarine, plunger of 8 mm: F = " in ran.out
    assert "Readings against E" in page.read_text()
    rows = {row["fruit_id"]: row for row in csv.DictReader(table.read_text().splitlines())}
    low, middle, high = (
        float(rows["new"][f"firmness_8mm_N_{column}"]) for column in ("low", "predicted", "high")
    )
    assert low < 20 + 45 * 0.7 < high
    assert low < middle < high
    assert rows["hard"]["firmness_8mm_N_predicted"] == rows["ball"]["firmness_8mm_N_predicted"] == ""
    assert drupe("history", out, "--export", tmp_path / "plain.csv").status == 0
    assert "firmness" not in (tmp_path / "plain.csv").read_text()
    assert "no fruit has a reading" in drupe("history", out, "--firmness", "brix=N@8mm").err


def test_options_name_columns_with_separate_accents(drupe, tmp_path):
    E, F = fruit_and_readings(np.random.default_rng(4), n=20)
    fruit = [
        graded(f"N{k}", float(E[k]), columns={"Härte": float(F[k]), "Größe": "A" if k < 10 else "B"})
        for k in range(20)
    ]
    out = results_of(tmp_path / "out", fruit, lot="7")
    names = ("--firmness", normalize("NFD", "Härte=N@8mm"), "--oecd", "1", "--size-column")
    ran = drupe("history", out, *names, normalize("NFD", "Größe"), status=0)
    assert "nectarine, plunger of 8 mm: F = " in ran.out
    assert "size A: 10 fruit" in ran.out


def fruit_of(name, *E_MPa, size="A"):
    grasps = tuple(StoredGrasp(grasp=f"g{k}", E_MPa=E, E_sd_MPa=0.01) for k, E in enumerate(E_MPa))
    mean = float(np.mean(E_MPa))
    return StoredFruit(fruit_id=name, E_MPa=mean, E_sd_MPa=0.02, grasps=grasps, columns={"size": size})


def test_ten_fruit_of_each_size_with_two_cheeks_suffice():
    fruit = [fruit_of(f"N{k}", 0.5, 0.5 * math.exp(0.1)) for k in range(10)]
    fruit += [fruit_of("B1", 0.4, size="B"), fruit_of("B2", 0.4, 0.5, size="B")]
    large, small = objective_samples([stored(fruit)], 1, size_column="size")
    assert lot_words(large.name) == "peach A, lot 7, 2026-08-12, size A"
    assert (large.fruit, large.fruit_missing, large.cheeks_missing) == (10, 0, ())
    assert "If each fruit was turned between two recordings, the sample suffices" in large.words
    assert "differs within a fruit by 7.1 % (sd)" in large.words  # 0.1 / sqrt(2) of ln E
    assert (small.fruit, small.fruit_missing, small.cheeks_missing) == (2, 8, ("B1 (1)",))
    (both,) = objective_samples([stored(fruit)], 2)
    assert (both.fruit, both.cheeks_missing) == (12, ())
    assert both.cheeks[0] == ("N0", ((0.5, 0.01), (0.5 * math.exp(0.1), 0.01)))


def test_the_command_names_what_is_missing(drupe, tmp_path):
    out = results_of(tmp_path / "out", [graded(f"N{k}", 0.5) for k in range(8)], lot="7")
    page = tmp_path / "h.html"
    ran = drupe("history", out, "--oecd", "1", "--html", page)
    assert "8 fruit, at least 10 are needed. Grade 2 more fruit. 8 cheeks of 8 fruit are missing." in ran.out
    assert "Samples for the OECD test of firmness" in page.read_text()
    assert "drupe counts each recording as another cheek" in page.read_text()
