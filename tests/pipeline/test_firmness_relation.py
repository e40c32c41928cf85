"""Readings of penetrometers against E by other libraries and refits; samples for the test of firmness."""

import csv
import math
from datetime import date

import numpy as np
import pytest
from graded_results import graded, results_of
from scipy.stats import linregress
from scipy.stats import t as student

from pipeline.history.firmness_relation import NoReading, firmness_relation, firmness_relations, reading_of
from pipeline.history.objective_test import objective_samples
from pipeline.history.stored_batch import StoredBatch, StoredFruit, StoredGrasp


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
    assert [key for key, _, _ in relations] == [
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
    plain = drupe("history", out, "--export", tmp_path / "plain.csv")
    assert plain.status == 0
    assert "firmness" not in (tmp_path / "plain.csv").read_text()
    assert "no fruit has a reading" in drupe("history", out, "--firmness", "brix=N@8mm").err


def fruit_of(name, *E_MPa, size="A"):
    grasps = tuple(StoredGrasp(grasp=f"g{k}", E_MPa=E, E_sd_MPa=0.01) for k, E in enumerate(E_MPa))
    mean = float(np.mean(E_MPa))
    return StoredFruit(fruit_id=name, E_MPa=mean, E_sd_MPa=0.02, grasps=grasps, columns={"size": size})


def test_ten_fruit_of_each_size_with_two_cheeks_suffice():
    fruit = [fruit_of(f"N{k}", 0.5, 0.5 * math.exp(0.1)) for k in range(10)]
    fruit += [fruit_of("B1", 0.4, size="B"), fruit_of("B2", 0.4, 0.5, size="B")]
    large, small = objective_samples([stored(fruit)], 1, size_column="size")
    assert large.name == "peach A, lot 7, 2026-08-12, size A"
    assert (large.fruit, large.fruit_missing, large.cheeks_missing) == (10, 0, ())
    assert "with two recorded cheeks each, if the fruit was turned between them: the sample" in large.words
    assert "differs within a fruit by 7.1 % (sd)" in large.words  # 0.1 / sqrt(2) of ln E
    assert (small.fruit, small.fruit_missing, small.cheeks_missing) == (2, 8, ("B1 (1)",))
    (both,) = objective_samples([stored(fruit)], 2)
    assert (both.fruit, both.cheeks_missing) == (12, ())
    assert both.cheeks[0] == ("N0", ((0.5, 0.01), (0.5 * math.exp(0.1), 0.01)))


def test_the_command_names_what_is_missing(drupe, tmp_path):
    out = results_of(tmp_path / "out", [graded(f"N{k}", 0.5) for k in range(8)], lot="7")
    page = tmp_path / "h.html"
    ran = drupe("history", out, "--oecd", "1", "--html", page)
    assert "8 fruit, at least 10 are needed: grade 2 more; 8 cheeks of 8 fruit are missing." in ran.out
    assert "Samples for the OECD test of firmness" in page.read_text()
    assert "drupe counts each recording as another cheek" in page.read_text()
