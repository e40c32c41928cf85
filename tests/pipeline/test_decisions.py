"""Ranking, classes, decisions and error bars from moduli."""

import numpy as np
import pytest
from graded_results import graded
from scipy.stats import norm

from fem.estimation.error_budget import DISCRETISATION, MODEL, PIT_PLACE, REGISTRATION, SCATTER, TACTILE
from pipeline.batch.fruits_table import Given
from pipeline.batch.records import DiagnosisRecord, ScreenRecord, SuspectedRecord
from pipeline.batch.settings import Grading, GradingClass
from pipeline.ranking.decisions import decide, ship_probability
from pipeline.ranking.error_parts import ADVICE, smaller_error
from pipeline.ranking.maturity import agreement, class_probabilities, maturity, standings
from reports.words import effect_name

CLASSES = (
    GradingClass(name="over", E_max_MPa=0.2),
    GradingClass(name="ripe", E_max_MPa=0.7),
    GradingClass(name="firm"),
)
DEFAULT = Grading(classes=CLASSES)


def said(**ship):
    """The classes, of which those named say whether they are shipped."""
    return Grading(classes=tuple(c.model_copy(update={"ship": ship.get(c.name)}) for c in CLASSES))


def decided(E_MPa, sd_MPa, grading=DEFAULT, *, mismatch=None, explained=None, **changes):
    moduli = np.array([E_MPa]), np.array([sd_MPa]), np.zeros(1)
    (place,) = standings(*moduli, classes=grading.classes, rng=np.random.default_rng(0))
    record = graded("A", E_MPa, sd=sd_MPa / E_MPa, changes=changes)
    return decide(record, place, grading, mismatch=mismatch, explained=explained)


def test_class_probabilities_are_shares_of_draws():
    draws = np.exp(np.random.default_rng(1).normal(np.log(0.6), 0.3, 400_000))
    counted = [(draws <= 0.2).mean(), ((draws > 0.2) & (draws <= 0.7)).mean(), (draws > 0.7).mean()]
    assert class_probabilities(np.log(0.6), 0.3, CLASSES) == pytest.approx(counted, abs=0.003)


@pytest.mark.parametrize(
    ("ship", "lists"),
    [
        ({}, ("ship", "ship", "hold")),
        ({"over": False}, ("hold", "ship", "hold")),
        ({"firm": True}, ("ship", "ship", "ship")),
        ({"ripe": True}, ("ship", "ship", "hold")),
        ({"over": False, "ripe": False}, ("hold", "hold", "hold")),
        ({"over": False, "firm": True}, ("hold", "ship", "ship")),
    ],
)
def test_what_a_class_says_is_done_to_its_own_fruit_alone(ship, lists):
    grading = said(**ship)
    assert tuple(decided(E, E / 50, grading).decision for E in (0.1, 0.4, 1.2)) == lists


def test_a_fruit_at_the_limit_is_borderline_and_its_other_class_is_named():
    decision = decided(0.69, 0.05)
    assert decision.decision == "inspect"
    assert decision.decision_reason.startswith("borderline: ship with probability")
    assert decision.other_class == "firm"
    firm = class_probabilities(np.log(0.69), 0.05 / 0.69, CLASSES)[2]
    assert decision.other_class_probability == pytest.approx(firm)


def test_a_limit_between_two_classes_that_are_shipped_alike_holds_no_fruit_back():
    decision = decided(0.2, 0.01)
    assert (decision.decision, decision.other_class) == ("ship", "ripe")


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"mismatch": "unknown"}, "no known effect explains its recordings"),
        ({"outcome": "never-touches"}, "not graded"),
        ({"doubts": ("grams",)}, "E is in doubt"),
        (
            {"screen": ScreenRecord(p_value=1e-4, names=("unknown",))},
            "no known effect explains its recordings",
        ),
    ],
)
def test_what_is_inspected_whatever_its_modulus(changes, why):
    assert decided(0.4, 0.001, **changes).decision_reason == why
    assert decided(0.4, 0.001, **changes).decision == "inspect"


SKIN = SuspectedRecord(effect="skin", E_ratio=0.513 / 0.416, added_sd=0.05)
CERTAIN_SHIP = Grading(
    classes=(GradingClass(name="ripe", E_max_MPa=0.6), GradingClass(name="firm")), certainty=0.9
)


def suspected(p_value, *moduli, names=("skin",)):
    return {"screen": ScreenRecord(p_value=p_value, names=names, suspected=moduli)}


@pytest.mark.parametrize(
    ("p_value", "moduli", "names", "limits"),
    [
        (6e-41, (SKIN,), ("skin",), {}),
        (0.009, (SKIN,), ("skin",), {"inspect_below_p": 0.01}),
        (1e-9, (), (), {}),
    ],
)
def test_a_fruit_whose_screen_is_improbable_is_inspected(p_value, moduli, names, limits):
    grading = CERTAIN_SHIP.model_copy(update=limits)
    decision = decided(0.416, 0.04, grading, **suspected(p_value, *moduli, names=names))
    assert decision.decision == "inspect"
    assert decision.decision_reason.startswith("missing physics suspected: ")
    assert decided(0.416, 0.04, Grading(**limits), **suspected(p_value)).decision == "inspect"


def test_the_reason_names_the_effect_p_and_both_moduli():
    why = decided(0.416, 0.04, CERTAIN_SHIP, **suspected(6e-41, SKIN)).decision_reason.replace("\u00a0", " ")
    # sd with it: 0.513 * hypot(0.04 / 0.416, 0.05) = 0.0556
    assert why == (
        "missing physics suspected: skin (p = 6.0e-41), E is 0.416 ± 0.040 MPa (ripe) without it and "
        "0.513 ± 0.056 MPa (ripe) with it"
    )


@pytest.mark.parametrize("p_value", [0.001, 0.5])
def test_a_fruit_is_not_inspected_for_a_likely_screen_that_leaves_its_class(p_value):
    assert decided(0.416, 0.02, CERTAIN_SHIP, **suspected(p_value, SKIN)).decision == "ship"
    never = CERTAIN_SHIP.model_copy(update={"inspect_below_p": 0.0})
    assert decided(0.416, 0.02, never, **suspected(1e-30, SKIN)).decision == "ship"


@pytest.mark.parametrize(
    ("E_MPa", "ratio", "effect"), [(0.416, 1.5, "skin"), (0.95, 0.6, "slip"), (0.42, 1.45, "pit_size+skin")]
)
def test_a_fruit_whose_class_the_suspected_effect_changes_is_inspected(E_MPa, ratio, effect):
    other = SuspectedRecord(effect=effect, E_ratio=ratio)
    same = SuspectedRecord(effect="drainage", E_ratio=1.01)
    decision = decided(E_MPa, E_MPa / 50, CERTAIN_SHIP, **suspected(0.03, same, other))
    assert decision.decision == "inspect"
    assert decision.decision_reason.startswith(
        f"the suspected effect changes its class: {effect_name(effect)} (p = 0.030)"
    )
    assert {decision.suspicion.maturity, decision.suspicion.maturity_with} == {"ripe", "firm"}


def explanation(after, verdict="skin"):
    E_MPa = {"before": {"value": 0.4, "sd": 0.02}, "after": {"value": after, "sd": 0.03}}
    return DiagnosisRecord(key="k", verdict=verdict, ranking=(), E_MPa=E_MPa)


@pytest.mark.parametrize(
    ("explained", "list_name"),
    [(explanation(0.7), "inspect"), (explanation(0.41), "ship"), (explanation(0.4, "none"), "ship")],
)
def test_what_explain_found_counts_instead_of_what_the_screen_suspects(explained, list_name):
    changes = suspected(0.02, SuspectedRecord(effect="slip", E_ratio=2.0))
    decision = decided(0.4, 0.01, CERTAIN_SHIP, explained=explained, **changes)
    assert decision.decision == list_name


@pytest.mark.parametrize(("certainty", "list_name"), [(0.5, "ship"), (0.8, "ship"), (0.9, "inspect")])
def test_the_certainty_that_a_decision_needs_is_a_setting(certainty, list_name):
    """ln(0.6 / 0.55) / 0.08 = 1.088 sd below the limit: 86 % certain."""
    decision = decided(0.55, 0.55 * 0.08, CERTAIN_SHIP.model_copy(update={"certainty": certainty}))
    assert decision.decision == list_name
    assert (decision.other_class is None) == (certainty < 0.86)


def test_without_classes_and_for_a_reference_body_there_is_no_list():
    assert decided(0.4, 0.01, Grading()).decision == ""
    assert decided(0.4, 0.01, given=Given(reference=True)).decision == ""


def test_one_class_parts_nothing_unless_it_says_so():
    assert Grading(classes=(GradingClass(name="all"),)).shipped is None
    assert Grading(classes=(GradingClass(name="all", ship=True),)).shipped == (True,)
    assert ship_probability((0.25, 0.75), (False, True)) == 0.75


SOFT_TO_FIRM = (
    GradingClass(name="soft", E_max_MPa=0.3),
    GradingClass(name="ripe", E_max_MPa=0.7),
    GradingClass(name="firm"),
)


def stand(E, sd, common=0.0, seed=1):
    E, sd = np.array(E), np.array(sd)
    return standings(E, sd, common * np.ones_like(E), classes=SOFT_TO_FIRM, rng=np.random.default_rng(seed))


def test_a_common_scale_counts_for_the_class_and_not_for_the_order():
    E, sd = np.array([0.29, 0.31]), np.array([0.003, 0.003])
    plain = standings(E, sd, np.zeros(2), classes=SOFT_TO_FIRM, rng=np.random.default_rng(1))
    wide = standings(
        E, sd, np.zeros(2), scale_sd_MPa=0.1 * E, classes=SOFT_TO_FIRM, rng=np.random.default_rng(1)
    )
    assert [s.p_softer_than_next for s in wide] == [s.p_softer_than_next for s in plain]
    assert [s.rank_probability for s in wide] == [s.rank_probability for s in plain]
    assert plain[0].maturity_probability > 0.99
    expected = norm.cdf((np.log(0.3) - np.log(0.29)) / np.hypot(0.1, 0.003 / 0.29))
    assert wide[0].maturity_probability == pytest.approx(expected)


def test_far_apart_fruit_have_certain_ranks_the_softest_first():
    standings = stand([10.0, 0.1, 1.0], [0.5, 0.005, 0.05])
    assert [s.rank for s in standings] == [3, 1, 2]
    for s in standings:
        assert s.rank_probability == 1.0
        assert s.rank_low == s.rank_high == s.rank


def test_probability_of_being_softer_agrees_with_direct_sampling():
    E, sd = np.array([0.50, 0.55]), np.array([0.05, 0.04])
    softer = stand(E, sd)[0].p_softer_than_next
    draws = np.exp(np.random.default_rng(3).normal(np.log(E), sd / E, (400_000, 2)))
    assert softer == pytest.approx((draws[:, 0] < draws[:, 1]).mean(), abs=0.003)


def test_rank_probability_of_two_equals_probability_of_being_softer():
    first, second = stand([0.50, 0.52], [0.05, 0.05])
    assert first.rank_probability == pytest.approx(first.p_softer_than_next, abs=0.03)
    assert second.p_softer_than_next is None


def test_equal_fruit_get_distinct_ranks_and_even_odds():
    first, second = stand([0.5, 0.5], [0.05, 0.05])
    assert {first.rank, second.rank} == {1, 2}
    assert first.p_softer_than_next == pytest.approx(0.5)


def test_an_error_that_all_fruit_share_leaves_the_order_sure_and_the_class_unsure():
    alone = stand([0.29, 0.31], [0.05, 0.05])
    shared = stand([0.29, 0.31], [0.05, 0.05], common=0.0499)
    assert shared[0].p_softer_than_next > 0.99 > alone[0].p_softer_than_next
    assert shared[0].maturity_probability == pytest.approx(alone[0].maturity_probability)


def test_without_classes_there_is_no_maturity():
    assert maturity(0.0, 0.1, ()) == (None, None)


def test_no_fruit_gives_no_standing():
    assert stand([], []) == []


def test_correlation_with_shore_is_one_for_the_same_order():
    correlation = agreement(np.array([0.1, 0.4, 0.9, 1.5]), np.array([20.0, 35.0, 60.0, 61.0]))
    assert correlation.spearman == pytest.approx(1.0)
    assert correlation.n == 4
    # Two of the 24 orders agree as well: this one and its reverse
    assert correlation.p == pytest.approx(2 / 24)


def test_two_fruit_or_a_constant_reference_have_no_correlation():
    assert agreement(np.array([0.1, 0.4]), np.array([1.0, 2.0])) is None
    assert agreement(np.array([0.1, 0.4, 0.5]), np.array([2.0, 2.0, 2.0])) is None


@pytest.mark.parametrize("part", [TACTILE, REGISTRATION, PIT_PLACE, MODEL, SCATTER])
def test_the_largest_part_is_named_with_what_to_do(part):
    said = smaller_error({part: 3.0, DISCRETISATION: 1.0})
    assert (
        said.replace("\u00a0", " ")
        == f"90 % of its variance comes from: {part}; smaller with {ADVICE[part]}."
    )


def test_two_parts_are_named_where_none_is_half_and_none_where_none_is_known():
    said = smaller_error({TACTILE: 1.0, MODEL: 1.1, SCATTER: 0.9})
    assert said.index(MODEL) < said.index(TACTILE)
    assert SCATTER not in said
    assert smaller_error({DISCRETISATION: 1.0}).endswith("comes from: discretisation.")
    assert smaller_error({}) == ""
