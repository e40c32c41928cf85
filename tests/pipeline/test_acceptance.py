"""Sampling plans against the published tables, exact probabilities in closed form, and decisions on lots."""

import csv
import hashlib
import itertools
import json
import math
from dataclasses import replace
from datetime import date
from unicodedata import normalize

import numpy as np
import pytest
from graded_results import graded, results_of
from scipy.integrate import quad
from scipy.stats import beta, chi2, norm

from pipeline.history.acceptance_plans import (
    AQLS,
    LETTERS,
    VARIABLES_AQLS,
    VARIABLES_SIZES,
    K,
    NoPlan,
    attributes_plan,
    operating_characteristic,
    share_accepted_with,
    variables_plan,
)
from pipeline.history.lot_acceptance import PlanWanted, acceptance_entries, plan_words, quality_index
from pipeline.history.lot_database import history_store
from pipeline.history.stored_batch import StoredBatch, StoredFruit
from reports.words import lot_words

CODE_LETTERS = """
8 A A A A A A B
15 A A A A A B C
25 A A B B B C D
50 A B B C C D E
90 B B C C C E F
150 B B C D D F G
280 B C D E E G H
500 B C D E F H J
1200 C C E F G J K
3200 C D E G H K L
10000 C D F G J L M
35000 C D F H K M N
150000 D E G J L N P
500000 D E G J M P Q
9999999 D E H K N Q R
"""
"""MIL-STD-105E, table I: largest lot, then the letter of S-1, S-2, S-3, S-4, I, II and III."""
COLUMNS = (0.65, 1.0, 1.5, 2.5, 4.0, 6.5, 10.0)
NORMAL = """
A 2 v v v v v 1 v
B 3 v v v v 1 ^ v
C 5 v v v 1 ^ v 2
D 8 v v 1 ^ v 2 3
E 13 v 1 ^ v 2 3 4
F 20 1 ^ v 2 3 4 6
G 32 ^ v 2 3 4 6 8
H 50 v 2 3 4 6 8 11
J 80 2 3 4 6 8 11 15
K 125 3 4 6 8 11 15 22
L 200 4 6 8 11 15 22 ^
M 315 6 8 11 15 22 ^ ^
N 500 8 11 15 22 ^ ^ ^
P 800 11 15 22 ^ ^ ^ ^
Q 1250 15 22 ^ ^ ^ ^ ^
"""
TIGHTENED = """
A 2 v v v v v v v
B 3 v v v v v 1 v
C 5 v v v v 1 v v
D 8 v v v 1 v v 2
E 13 v v 1 v v 2 3
F 20 v 1 v v 2 3 4
G 32 1 v v 2 3 4 6
H 50 v v 2 3 4 6 9
J 80 v 2 3 4 6 9 13
K 125 2 3 4 6 9 13 19
L 200 3 4 6 9 13 19 ^
"""
"""Tables II-A and II-B: letter, n, and the rejection number, or the arrow, by AQL in COLUMNS."""
LARGEST = {"A": 8, "B": 15, "C": 25, "D": 50, "E": 90, "F": 150, "G": 280, "H": 500, "J": 1200, "K": 3200}
LARGEST |= {"L": 10_000, "M": 35_000, "N": 150_000, "P": 500_000, "Q": 600_000}
"""Of lots with this letter at level II."""


def test_code_letters_are_those_of_the_table():
    smallest, rows = 2, [line.split() for line in NORMAL.strip().splitlines()]
    for row in CODE_LETTERS.strip().splitlines():
        largest, *letters = row.split()
        for size in (smallest, int(largest)):
            plans = [attributes_plan(size, 4.0, level=level) for level in LETTERS]
            wanted = [followed(rows, letter, COLUMNS.index(4.0)) for letter in letters]
            assert [(plan.letter, plan.re) for plan in plans] == [(used, re) for used, _, re in wanted]
        smallest = int(largest) + 1


def followed(rows, letter, column):
    """Letter, n and rejection number after the arrows of a typed table; R is its last row."""
    names = [row[0] for row in rows]
    at = names.index(letter) if letter in names else len(rows) - 1
    while (cell := rows[at][2 + column]) in "v^":
        at += 1 if cell == "v" else -1
    return rows[at][0], int(rows[at][1]), int(cell)


@pytest.mark.parametrize(("inspection", "text"), [("normal", NORMAL), ("tightened", TIGHTENED)])
def test_plans_are_those_of_the_master_tables(inspection, text):
    rows = [line.split() for line in text.strip().splitlines()]
    for letter, *_ in rows:
        for column, aql in enumerate(COLUMNS):
            plan = attributes_plan(LARGEST[letter], aql, inspection=inspection)
            used, n, re = followed(rows, letter, column)
            assert (plan.letter, plan.re, plan.ac) == (used, re, re - 1)
            assert plan.n == min(n, LARGEST[letter])


@pytest.mark.parametrize(
    ("lot", "aql", "n", "ac", "re"),
    [
        *[(1200, 1.0, 32, 1, 3), (3200, 1.0, 50, 1, 4), (10_000, 1.0, 80, 2, 5), (500, 1.0, 20, 0, 2)],
        *[(1200, 6.5, 32, 5, 8), (3200, 6.5, 50, 7, 10), (10_000, 6.5, 80, 10, 13), (50, 10.0, 3, 1, 3)],
    ],
)
def test_reduced_plans_have_the_gap_of_table_two_c(lot, aql, n, ac, re):
    plan = attributes_plan(lot, aql, inspection="reduced")
    assert (plan.n, plan.ac, plan.re) == (n, ac, re)
    assert plan.acceptance(np.array([0.05])) == pytest.approx(beta.sf(0.05, re, n - re + 1))


def test_arrows_end_where_the_tables_end():
    assert attributes_plan(600_000, 0.010, level="III").n == 1250
    assert attributes_plan(600_000, 0.025, level="III", inspection="tightened").n == 3150
    for inspection in ("normal", "tightened", "reduced"):
        for lot in (2, 100, 5000, 10**6):
            plans = [attributes_plan(lot, aql, inspection=inspection) for aql in AQLS]
            assert all(plan.ac < plan.re and plan.n <= lot for plan in plans)


@pytest.mark.parametrize(("lot", "aql", "level"), [(100, 0.10, "II"), (5, 10.0, "III"), (3, 10.0, "III")])
def test_the_curve_of_a_whole_lot_ends_where_the_plan_rejects_it(lot, aql, level):
    plan = attributes_plan(lot, aql, level=level)
    assert plan.n == lot
    table = operating_characteristic(plan)
    assert table.nonconforming_percent.iloc[-1] == pytest.approx(100 * plan.re / lot)
    assert table.lot_acceptance_probability.tolist() == [1.0] * plan.re + [0.0]
    assert plan_words(plan)[1].startswith("The sample is the whole lot. The plan accepts it with at most ")


def test_the_operating_characteristic_is_the_published_one():
    plan = attributes_plan(1000, 1.0)  # table X-J-1: 95, 50 and 10 % at 1.03, 3.33 and 6.52 % nonconforming
    at = [100 * share_accepted_with(plan, p) for p in (0.95, 0.5, 0.1)]
    assert at == pytest.approx([1.03, 3.33, 6.52], abs=0.006)
    share = np.linspace(0.001, 0.2, 7)
    assert plan.acceptance(share) == pytest.approx(beta.sf(share, 3, 78))


def test_a_small_lot_is_counted_out():
    plan = attributes_plan(60, 4.0)
    assert (plan.n, plan.ac) == (13, 1)
    bad = np.arange(0, 30, 4)
    ways = [sum(math.comb(int(d), k) * math.comb(60 - int(d), 13 - k) for k in (0, 1)) for d in bad]
    assert plan.lot_acceptance(bad.astype(float)) == pytest.approx(np.array(ways) / math.comb(60, 13))
    table = operating_characteristic(plan)
    assert table.acceptance_probability.is_monotonic_decreasing
    assert table.acceptance_probability.iloc[-1] <= 0.005 < table.acceptance_probability.iloc[-2]
    assert table.nonconforming_percent.to_numpy() * 60 / 100 == pytest.approx(np.arange(len(table)), abs=1e-4)
    by_variables = operating_characteristic(variables_plan(300, 1.0))
    assert by_variables.acceptance_probability.iloc[-1] == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("lot", "aql", "inspection", "n", "k"),
    [
        *[(8, 6.5, "normal", 3, 0.765), (40, 1.0, "normal", 5, 1.53), (40, 1.0, "tightened", 5, 1.65)],
        *[(8, 1.0, "normal", 4, 1.45), (8, 0.25, "normal", 7, 2.0), (300, 2.5, "normal", 20, 1.51)],
        *[(1000, 4.0, "normal", 35, 1.39), (10_000, 0.10, "tightened", 75, 2.77)],
    ],
)
def test_plans_by_variables_are_those_of_table_b_one(lot, aql, inspection, n, k):
    plan = variables_plan(lot, aql, inspection=inspection)
    assert (plan.n, plan.k) == (n, k)


@pytest.mark.parametrize(
    ("lot", "aql", "n", "M"),
    [
        *[(8, 10.0, 3, 40.47), (90, 1.5, 3, 7.59), (150, 0.65, 4, 1.49), (280, 0.10, 7, 0.087)],
        *[(1000, 4.0, 15, 13.74), (3200, 1.0, 20, 4.10), (35_000, 0.25, 30, 1.32)],
        *[(500_000, 6.5, 75, 15.07), (8, 0.65, 4, 1.49), (16, 0.25, 5, 0.041)],
    ],
)
def test_reduced_plans_by_variables_accept_the_estimated_share_of_table_b_four(lot, aql, n, M):
    """The estimate is the share of (1 - t²)^(n/2 - 2) above t = Q sqrt(n) / (n - 1); k has three digits."""
    plan = variables_plan(lot, aql, inspection="reduced")
    assert plan.n == n
    density = lambda t: (1 - t * t) ** (n / 2 - 2)  # noqa: E731
    beyond = [quad(density, (plan.k + by) * math.sqrt(n) / (n - 1), 1)[0] for by in (-0.005, 0.005)]
    most, least = 100 * np.array(beyond) / quad(density, -1, 1)[0]
    assert least <= M <= most


def test_reduced_plans_by_variables_are_normal_ones_of_fewer_fruit_and_the_next_aql():
    """Cells that tables B-1 and B-4 share. Both are rounded: they differ by a hundredth at most."""
    lots = (8, 90, 150, 280, 400, 500, 1200, 3200, 10_000, 35_000, 150_000, 500_000)
    compared = 0
    for lot in lots:
        for aql, next_aql in itertools.pairwise(VARIABLES_AQLS):
            reduced = variables_plan(lot, aql, inspection="reduced")
            for row, n in enumerate(VARIABLES_SIZES):
                cell = K.strip().splitlines()[row].split()[1 + VARIABLES_AQLS.index(next_aql)]
                if n == reduced.n and cell != "-":
                    assert reduced.k == pytest.approx(float(cell), abs=0.011)
                    compared += 1
    assert compared > 90


def test_acceptance_by_variables_is_the_integral_over_the_standard_deviation():
    plan = variables_plan(300, 1.0)
    for share in (0.005, 0.03, 0.1):
        z, n = norm.isf(share), plan.n
        inside = lambda w: norm.cdf(math.sqrt(n) * (z - plan.k * math.sqrt(w / (n - 1))))  # noqa: B023, E731
        wanted, _ = quad(lambda w: chi2.pdf(w, n - 1) * inside(w), 0, 120)  # noqa: B023
        assert plan.acceptance(np.array([share])) == pytest.approx(wanted, abs=1e-7)


@pytest.mark.parametrize("lot", [500, 1000, 3000])
def test_both_kinds_of_plan_protect_the_buyer_alike(lot):
    """Z1.9 was matched to MIL-STD-105: the lots that are accepted in 10 % of cases are alike."""
    attributes, variables = (make(lot, 4.0) for make in (attributes_plan, variables_plan))
    assert share_accepted_with(attributes, 0.1) == pytest.approx(share_accepted_with(variables, 0.1), rel=0.1)
    assert variables.n < attributes.n


@pytest.mark.parametrize(
    ("make", "lot", "aql", "more", "said"),
    [
        (attributes_plan, 1, 4.0, {}, "lot of 1 fruit"),
        (attributes_plan, 500, 3.0, {}, "found AQL 3 %"),
        (attributes_plan, 500, 4.0, {"inspection": "strict"}, 'inspection "strict"'),
        (variables_plan, 500, 4.0, {"level": "S-1"}, 'level "S-1"'),
        (variables_plan, 5, 0.10, {}, "the plan needs 15 fruit, but the lot has 5"),
    ],
)
def test_what_has_no_plan_is_said(make, lot, aql, more, said):
    with pytest.raises(NoPlan, match=said):
        make(lot, aql, **more)


def batch(E_MPa, *, limits=(("ready", 0.5), ("firm", None)), lot="7", day=12, key="b"):
    fruit = tuple(
        StoredFruit(fruit_id=f"N{k}", E_MPa=float(E), E_sd_MPa=0.02, doubted=E > 10)
        for k, E in enumerate(E_MPa)
    )
    return StoredBatch(
        key=key,
        folder="f",
        measured=date(2026, 8, day),
        graded_utc=f"2026-08-{day}T12:00:00Z",
        category="nectarine",
        lot=lot,
        limits=limits,
        fruit=fruit,
    )


def decision(E_MPa, class_name="ready", limits=(("ready", 0.5), ("firm", None)), **how):
    wanted = PlanWanted(**{"lot_size": ("150",), "aql": 4.0, **how})  # F: n = 20, Ac = 2
    (entry,) = acceptance_entries([batch(E_MPa, limits=limits)], class_name, wanted)
    (lot,) = entry.decisions
    return lot.verdict, lot.words


def test_fruit_outside_the_class_decide_by_attributes():
    assert decision([0.4] * 18 + [0.6] * 2) == ("accept", "2 of 20 fruit are outside the class")
    assert decision([0.4] * 17 + [0.6] * 3)[0] == "reject"
    assert decision([0.4] * 17 + [0.6] * 3, "firm")[0] == "reject"
    assert decision([0.6] * 20, "firm")[0] == "accept"


def test_a_small_sample_needs_more_fruit_unless_it_is_rejected_already():
    verdict, words = decision([0.4] * 14 + [50.0])  # one in doubt
    assert verdict == "more fruit needed"
    assert "the plan needs 20 fruit: grade 6 more. drupe left out 1 fruit in doubt" in words
    assert decision([0.6] * 3 + [0.4])[0] == "reject"


def test_between_the_numbers_of_reduced_inspection_the_lot_is_accepted():
    verdict, words = decision([0.4] * 7 + [0.6], inspection="reduced")  # F: n = 8, Ac = 1, Re = 3
    assert (verdict, "Ac and Re" in words) == ("accept", False)
    verdict, words = decision([0.4] * 6 + [0.6] * 2, inspection="reduced")
    assert verdict == "accept"
    assert "return to normal inspection" in words


def test_the_example_of_the_standard_is_accepted_by_variables():
    """MIL-STD-414, example B-1: lot of 40, AQL 1 %, limit 209: Q = 1.59 against k = 1.53."""
    values = np.array([197.0, 188, 184, 205, 201])
    assert quality_index(values, limit=209.0, upper=True) == pytest.approx(1.59, abs=0.005)
    assert quality_index(-values, limit=-209.0, upper=False) == pytest.approx(1.59, abs=0.005)
    E = np.exp(values / 100)
    limits = (("ready", math.exp(2.09)), ("firm", None))
    how = {"lot_size": ("40",), "aql": 1.0, "variables": True}
    assert decision(E, limits=limits, **how) == ("accept", "Q = 1.59 of ln E is at least k = 1.53")
    assert decision(E, limits=(("ready", math.exp(2.08)), ("firm", None)), **how)[0] == "reject"
    assert decision(E[:4], limits=limits, **how)[0] == "more fruit needed"


def test_a_class_with_two_limits_has_no_plan_by_variables():
    with pytest.raises(NoPlan, match="needs a class with one limit, and this one has two limits"):
        decision([0.4] * 30, "mid", (("soft", 0.3), ("mid", 0.5), ("firm", None)), variables=True)
    with pytest.raises(NoPlan, match='no class "ripe"; its classes: ready, firm'):
        decision([0.4] * 30, "ripe")


def test_each_lot_has_its_size_and_its_last_day():
    batches = [batch([0.6] * 20, day=10), batch([0.4] * 20, key="c"), batch([0.4] * 20, lot="8", key="d")]
    batches.append(batch([0.4] * 20, lot="9", key="e"))
    wanted = PlanWanted(lot_size=("7=150", "8=1200"))
    first, second = acceptance_entries(batches, "ready", wanted)
    assert [(lot_words(lot_decision.name), lot_decision.verdict) for lot_decision in first.decisions] == [
        ("nectarine, lot 7, 2026-08-12", "accept")
    ]
    assert [lot_decision.verdict for lot_decision in second.decisions] == ["more fruit needed"]
    assert [name.lot for name, _ in first.refusals] == ["9"]
    assert second.refusals == ()


def accepted(batches, *sizes):
    (entry,) = acceptance_entries(batches, "ready", PlanWanted(lot_size=sizes or ("150",)))
    (lot,) = entry.decisions
    return lot.verdict, lot.words


def test_a_fruit_in_two_batches_of_a_day_counts_once():
    """10 fruit with two grippers are no 20 fruit; each has the geometric mean of both."""
    verdict, words = accepted([batch([0.4] * 10), batch([0.4] * 10, key="c")])
    assert verdict == "more fruit needed"
    assert "0 of 10 fruit" in words
    low, high = [0.4] * 20, [0.6] * 20  # mean 0.490, limit 0.5
    assert accepted([batch(low), batch(high, key="c")]) == ("accept", "0 of 20 fruit are outside the class")
    high[:3] = [0.7] * 3  # mean 0.529
    assert accepted([batch(low), batch(high, key="c")]) == ("reject", "3 of 20 fruit are outside the class")
    assert accepted([batch(low), batch([50.0] * 20, key="c")])[0] == "accept"  # in doubt in one batch alone


def test_the_draw_of_fruit_in_two_batches_does_not_prefer_soft_ones():
    E = np.where(np.arange(40) % 2 == 0, 0.3, 0.6)
    names = sorted(range(40), key=lambda k: hashlib.sha256(f"7\n2026-08-12\nN{k}".encode()).hexdigest())
    outside = sum(k % 2 for k in names[:20])
    words = accepted([batch(E), batch(E, key="c")])[1]
    assert words.startswith(f"{outside} of 20 fruit are outside the class. The sample is 20 of the 40 fruit")


def test_a_last_day_without_a_fruit_that_counts_decides_nothing_by_an_older_day():
    older = batch([0.4] * 20, day=10)
    verdict, words = accepted([older, batch([50.0] * 3, key="c")])
    assert verdict == "more fruit needed"
    assert words.startswith("0 of 0 fruit are outside the class; the plan needs 20 fruit: grade 20 more")
    assert words.endswith(". drupe left out 3 fruit in doubt")
    failed = replace(batch([50.0], key="c"), lost=("N7", "N8"))
    assert accepted([older, failed])[1].endswith(
        "left out 1 fruit in doubt. drupe left out 2 fruit without a grade"
    )
    body = StoredFruit(fruit_id="ball", E_MPa=0.8, E_sd_MPa=0.02, E_known_MPa=0.8)
    assert accepted([older, replace(batch([], key="c"), fruit=(body,))])[0] == "accept"


def test_a_size_of_no_lot_or_stated_twice_is_refused():
    with pytest.raises(NoPlan, match='--lot-size names lot "77", which no batch has'):
        accepted([batch([0.4] * 20)], "150", "77=900")
    with pytest.raises(NoPlan, match='two sizes of lot "7"'):
        accepted([batch([0.4] * 20)], "7=150", "7 =900")
    with pytest.raises(NoPlan, match="two sizes of lots without a size of their own"):
        accepted([batch([0.4] * 20)], "150", "900")


def test_a_lot_of_an_earlier_store_with_separate_accents_is_the_same_lot(drupe, tmp_path):
    """Python's own normalisation writes the earlier names; the later day has composed ones."""
    store, page = tmp_path / "s", tmp_path / "h.html"
    apart = normalize("NFD", "SÜD")
    limits = ((normalize("NFD", "für jetzt"), 0.5), ("firm", None))
    with history_store(store) as stored:
        stored.add(batch([0.6] * 20, limits=limits, lot=apart))
    grading = {"classes": [{"name": name, "E_max_MPa": E} for name, E in limits]}
    later = results_of(
        tmp_path / "out",
        [graded(f"N{k}", 0.4) for k in range(20)],
        day="2026-08-14",
        lot="SÜD",
        grading=grading,
    )
    plan = ("--accept", "für jetzt", "--lot-size", f"{apart}=150")
    ran = drupe("history", later, "--store", store, *plan, "--html", page, status=0)
    assert "nectarine, lot S\u00dcD, 2026-08-14: accept: 0 of 20 fruit are outside" in ran.out
    with history_store(store) as stored:
        assert {entry.series for entry in stored.batches()} == {("nectarine", "", "S\u00dcD")}
    assert apart not in page.read_text("utf-8")


def test_earlier_results_with_separate_accents_are_the_same_lot(drupe, tmp_path):
    grading = {"classes": [{"name": "ready", "E_max_MPa": 0.5}, {"name": "firm", "E_max_MPa": None}]}
    fruit, lot = [graded(f"N{k}", 0.4) for k in range(20)], normalize("NFD", "SÜD")
    out = results_of(tmp_path / "out", fruit, lot=lot, grading=grading)
    ran = drupe("history", out, "--accept", "ready", "--lot-size", "SÜD=150", status=0)
    assert "lot S\u00dcD, 2026-08-10: accept" in ran.out


@pytest.fixture
def results(tmp_path):
    grading = {"classes": [{"name": "ready", "E_max_MPa": 0.5}, {"name": "firm", "E_max_MPa": None}]}
    fruit = [graded(f"N{k}", 0.4 + 0.01 * k) for k in range(20)]
    return results_of(tmp_path / "out", fruit, lot="<b>7", grading=grading)


def test_the_command_prints_draws_and_writes(drupe, results, tmp_path):
    page, curve = tmp_path / "h.html", tmp_path / "oc.csv"
    ran = drupe(
        *("history", results, "--accept", "ready", "--lot-size", "150", "--html", page, "--oc", curve),
        status=0,
    )
    assert "code letter F: n = 20, Ac = 2, Re = 3" in ran.out
    assert "lot <b>7, 2026-08-10: reject: 9 of 20 fruit are outside the class." in ran.out
    said = page.read_text()
    assert "Operating characteristic" in said
    assert "<b>7" not in said
    rows = list(csv.DictReader(curve.read_text().splitlines()))
    assert float(rows[0]["acceptance_probability"]) == 1
    assert float(rows[0]["lot_acceptance_probability"]) == 1
    drupe("history", results, "--accept", "ready", "--lot-size", "150", "--oc", page, status=2)
    alone = drupe("plan", "--lot-size", "150", "--oc", tmp_path / "p.json")
    assert "n = 20, Ac = 2, Re = 3" in alone.out
    assert "Change to tightened inspection after 2 rejected lots among 5 in a row" in alone.out
    assert 2 < len(json.loads((tmp_path / "p.json").read_text())) <= 101


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("plan",), "needs --lot-size"),
        (("plan", "--lot-size", "many"), 'found "many", expected a number of fruit'),
        (("history", "OUT", "--accept", "ready"), 'the size of lot "<b>7" is not stated'),
        (("history", "OUT", "--lot-size", "500"), "--lot-size needs --accept"),
        (("history", "OUT", "--oc", "c.csv"), "add --accept CLASS"),
        (("history", "OUT", "--size-column", "size"), "--size-column needs --oecd"),
    ],
)
def test_what_cannot_be_planned_is_refused(drupe, results, arguments, said):
    ran = drupe(*[results if argument == "OUT" else argument for argument in arguments], status=2)
    assert said in ran.err
