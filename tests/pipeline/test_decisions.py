"""What is shipped, held and inspected: probabilities against direct draws, and the reasons."""

import numpy as np
import pytest
from graded_results import graded

from pipeline.batch.fruits_table import Given
from pipeline.batch.records import DiagnosisRecord, ScreenRecord, SuspectedRecord
from pipeline.batch.settings import Grading, GradingClass
from pipeline.ranking.decisions import decide, ship_probability
from pipeline.ranking.maturity import class_probabilities, standings
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
    grading = CERTAIN_SHIP.model_copy(update={"certainty": certainty})
    decision = decided(0.55, 0.55 * 0.08, grading)
    assert decision.decision == list_name
    assert (decision.other_class is None) == (certainty < 0.86)


def test_without_classes_and_for_a_reference_body_there_is_no_list():
    assert decided(0.4, 0.01, Grading()).decision == ""
    assert decided(0.4, 0.01, given=Given(reference=True)).decision == ""


def test_one_class_parts_nothing_unless_it_says_so():
    grading = Grading(classes=(GradingClass(name="all"),))
    assert grading.shipped is None
    assert Grading(classes=(GradingClass(name="all", ship=True),)).shipped == (True,)
    assert ship_probability((0.25, 0.75), (False, True)) == 0.75
