"""What is shipped, held and inspected: probabilities against direct draws, and the reasons."""

import numpy as np
import pytest

from pipeline.batch.records import FruitRecord, Given, ModulusRecord, ScreenRecord
from pipeline.batch.settings import Grading, GradingClass
from pipeline.ranking.decisions import decide, ship_probability
from pipeline.ranking.maturity import class_probabilities, standings

CLASSES = (
    GradingClass(name="over", E_max_MPa=0.2),
    GradingClass(name="ripe", E_max_MPa=0.7),
    GradingClass(name="firm"),
)
DEFAULT = Grading(classes=CLASSES)


def ship_only(*names):
    return Grading(
        classes=tuple(c.model_copy(update={"ship": True if c.name in names else None}) for c in CLASSES)
    )


def decided(E_MPa, sd_MPa, grading=DEFAULT, *, mismatch=None, **changes):
    modulus = ModulusRecord(E_MPa=E_MPa, E_sd_MPa=sd_MPa)
    record = FruitRecord(fruit_id="A", outcome="graded", key="k", given=Given(), modulus=modulus)
    (place,) = standings(
        np.array([E_MPa]),
        np.array([sd_MPa]),
        np.zeros(1),
        classes=grading.classes,
        rng=np.random.default_rng(0),
    )
    return decide(record.model_copy(update=changes), place, grading, mismatch=mismatch)


def test_class_probabilities_are_shares_of_draws():
    draws = np.exp(np.random.default_rng(1).normal(np.log(0.6), 0.3, 400_000))
    counted = [(draws <= 0.2).mean(), ((draws > 0.2) & (draws <= 0.7)).mean(), (draws > 0.7).mean()]
    assert class_probabilities(np.log(0.6), 0.3, CLASSES) == pytest.approx(counted, abs=0.003)


def test_without_a_word_all_but_the_firmest_are_shipped():
    assert decided(0.4, 0.01).list_name == "ship"
    assert decided(0.1, 0.002).list_name == "ship"
    assert decided(1.2, 0.02).list_name == "hold"


def test_what_classes_say_is_done():
    assert decided(0.1, 0.002, ship_only("ripe")).list_name == "hold"
    assert decided(0.4, 0.01, ship_only("ripe")).list_name == "ship"
    assert decided(1.2, 0.02, ship_only("firm")).list_name == "ship"


def test_a_fruit_at_the_limit_is_borderline_and_its_other_class_is_named():
    found = decided(0.69, 0.05)
    assert found.list_name == "inspect"
    assert found.why.startswith("borderline: to be shipped with")
    assert found.other_class == "firm"
    firm = class_probabilities(np.log(0.69), 0.05 / 0.69, CLASSES)[2]
    assert found.other_probability == pytest.approx(firm)


def test_a_limit_between_two_classes_that_are_shipped_alike_holds_no_fruit_back():
    found = decided(0.2, 0.01)
    assert (found.list_name, found.other_class) == ("ship", "ripe")


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"outcome": "never-touches"}, "not graded"),
        ({"doubts": ("grams",)}, "E is in doubt"),
        ({"screen": ScreenRecord(p_value=1e-4, names=("unknown",))}, "nothing known explains its recordings"),
    ],
)
def test_what_is_inspected_whatever_its_modulus(changes, why):
    assert decided(0.4, 0.001, **changes).why == why
    assert decided(0.4, 0.001, **changes).list_name == "inspect"


def test_explained_by_nothing_is_inspected():
    assert decided(0.4, 0.001, mismatch="unknown").list_name == "inspect"


def test_without_classes_and_for_a_reference_body_there_is_no_list():
    assert decided(0.4, 0.01, Grading()).list_name == ""
    assert decided(0.4, 0.01, given=Given(reference=True)).list_name == ""


def test_one_class_parts_nothing_unless_it_says_so():
    one = Grading(classes=(GradingClass(name="all"),))
    assert one.shipped is None
    assert Grading(classes=(GradingClass(name="all", ship=True),)).shipped == (True,)
    assert ship_probability((0.25, 0.75), (False, True)) == 0.75
