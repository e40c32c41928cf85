"""Effects of a bare ball's trace: each is one of the effects between pads, and one file."""

import numpy as np
import pytest
from press_trace import ball_trace

from fem.indentation.trace_catalogue import OF_THE_MACHINE, TRACE_EFFECTS
from fem.indentation.trace_effect import TraceEffect, unknown
from fem.mismatch.catalogue import SPECS

TIME_S = np.linspace(0.0, 20.0, 60)
TRACE = ball_trace(TIME_S, 0.1 * TIME_S, np.minimum(TIME_S / 5, 2.0))


def changes(effect: TraceEffect) -> bool:
    hooks = (
        effect.give_mm, effect.stress_factor, effect.slack_mm, effect.relaxation, effect.force_factor,
        effect.added_N,
    )  # fmt: skip
    return any(hook is not None for hook in hooks)


def test_each_is_an_effect_of_the_catalogue_and_no_two_are_the_same():
    names = [effect.spec.name for effect in TRACE_EFFECTS]
    assert len(set(names)) == len(names)
    assert all(SPECS[effect.spec.name] is effect.spec for effect in TRACE_EFFECTS)
    assert len({effect.rank for effect in TRACE_EFFECTS}) == len(names)


@pytest.mark.parametrize("kind", TRACE_EFFECTS, ids=lambda kind: kind.spec.name)
def test_every_form_bears_its_effects_name_and_changes_the_force(kind):
    forms = kind.forms(TRACE)
    assert forms
    for form in forms:
        assert form.name == kind.spec.name
        assert form.unknowns
        assert changes(form)


def test_parameters_that_are_searched_for_have_the_names_and_units_that_settings_know():
    for kind in TRACE_EFFECTS:
        for form in kind.forms(TRACE):
            if form.parameters is None:
                for one in form.unknowns:
                    parameter = kind.spec.parameter(one.name)
                    assert parameter is not None, one.name
                    assert one.unit == parameter.unit


def test_a_parameter_that_the_effect_does_not_have_is_refused():
    with pytest.raises(KeyError, match="mu"):
        unknown(SPECS["damage"], "mu", scale="log", mean=0.0, sd=1.0)


def test_of_the_machine_are_its_give_and_its_load_cells_drift():
    assert {"gripper_compliance", "sensor_drift"} == OF_THE_MACHINE
