"""The catalogue: every effect states of itself what other rooms need, once."""

import pytest

from fem.mismatch.catalogue import EFFECTS, SPECS
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Entry, Scope
from fem.mismatch.procedure import TURNED, next_grasp


def test_ranks_and_names_are_each_effects_own():
    assert len({effect.spec.rank for effect in EFFECTS}) == len(EFFECTS) == len(SPECS)


@pytest.mark.parametrize("effect", EFFECTS, ids=list(SPECS))
def test_every_effect_can_be_read_by_people(effect: Effect):
    words = effect.spec.words
    assert words.short[0].islower()
    assert not words.short.endswith(".")
    assert words.meaning.endswith(".")
    assert words.advice.endswith(".")
    assert all(parameter.words for parameter in effect.spec.parameters)


@pytest.mark.parametrize("effect", EFFECTS, ids=list(SPECS))
def test_what_is_searched_lies_within_what_settings_may_hold(effect: Effect):
    """At the modulus of soft and of firm flesh."""
    for parameter in effect.spec.parameters:
        low, high = parameter.limits
        for spec in parameter.searched:
            for E_MPa in (0.05, 2.0):
                ends = [end * E_MPa**parameter.modulus_power for end in (spec.low, spec.high)]
                assert low <= ends[0] < ends[1] <= high, spec.name


@pytest.mark.parametrize("effect", EFFECTS, ids=list(SPECS))
def test_an_effect_whose_start_is_not_its_amounts_states_its_priors(effect: Effect):
    if type(effect).start is not Effect.start:
        assert type(effect).prior is not Effect.prior


def test_every_effect_of_the_jaws_is_told_from_every_effect_of_the_fruit_by_turning_it():
    jaws = [name for name, spec in SPECS.items() if spec.scope in (Scope.SENSOR, Scope.GRIPPER)]
    fruit = [name for name, spec in SPECS.items() if spec.scope in (Scope.FRUIT, Scope.LOT)]
    assert len(jaws) + len(fruit) == len(SPECS)
    for jaw in jaws:
        for other in fruit:
            assert next_grasp((jaw, other), grasps=4) == TURNED


def test_what_is_wrong_with_the_jaws_is_put_right_in_the_recordings_and_nothing_else_is():
    assert all((spec.enters is Entry.RECORDING) == spec.of_the_jaws for spec in SPECS.values())
