"""The finder's searches: each reaches its tolerance or says so; none depends on what was asked before."""

import numpy as np
import pytest
from pinched_case_model import model_of
from plain_model import screened_effects

from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.effects import damage, loose_pit, pit_size, plastic_set, pose_error, slip, stiffening
from fem.mismatch.model import stress_history
from fem.mismatch.selection import model_selection
from fem.mismatch.signature_variant import ONE_WAY, of_pad

LAWS = [
    (damage.EFFECT, {"dmax": 0.35, "W0_over_E": 0.004}, {"dmax": 0.3, "W0_over_E": 0.003}),
    (plastic_set.EFFECT, {"yield_over_E": 0.05}, {"yield_over_E": 0.06}),
    (stiffening.EFFECT, {"b": 30.0}, {"b": 25.0}),
]


@pytest.mark.parametrize(
    ("effect", "values", "_"), LAWS, ids=lambda x: x.spec.name if hasattr(x, "spec") else ""
)
def test_a_law_that_is_not_solved_in_its_rounds_says_so(monkeypatch, effect, values, _):
    monkeypatch.setattr(stress_history, "MOST_ROUNDS", 2)
    with pytest.raises(FemFailure, match="after 2 rounds") as failure:
        effect.respond(model_of(), values, ONE_WAY)
    assert failure.value.problem is FemProblem.NOT_CONVERGED


@pytest.mark.parametrize(
    ("effect", "values", "others", "variant"),
    [
        *((effect, values, others, ONE_WAY) for effect, values, others in LAWS),
        pytest.param(pit_size.EFFECT, {"scale": 0.8}, {"scale": 0.75}, ONE_WAY, marks=pytest.mark.proof),
        (
            pose_error.EFFECT,
            {"dx_mm": 1.5, "dy_mm": 1.0, "tilt_deg": 2.0},
            {"dx_mm": 1.8, "dy_mm": 1.2, "tilt_deg": 2.2},
            of_pad("left"),
        ),
    ],
    ids=lambda x: x.spec.name if hasattr(x, "spec") else "",
)
def test_the_same_call_gives_the_same_answer_whatever_was_asked_before(effect, values, others, variant):
    model = model_of()
    names = dict(zip([spec.name for spec in effect.spec.searched], values.values(), strict=True))
    before = effect.respond(model, names, variant).unit[0]
    effect.respond(model, dict(zip(names, others.values(), strict=True)), variant)
    np.testing.assert_array_equal(effect.respond(model, names, variant).unit[0], before)


def test_an_effect_whose_model_is_not_found_is_reported_as_not_tried(monkeypatch):
    model = model_of()
    linear = screened_effects(model, [damage.EFFECT])
    monkeypatch.setattr(stress_history, "MOST_ROUNDS", 1)
    monkeypatch.setattr(stress_history, "CLOSE_MM", 1e-12)
    monkeypatch.setattr(model_selection, "verdict_of", lambda probability, p_value: tuple(probability))
    selection = model_selection.select_model(model, linear, p_value=0.0)
    assert "after 1 rounds" in selection.without["damage"]


def test_a_slid_path_that_does_not_settle_is_a_signature_that_says_why(monkeypatch):
    monkeypatch.setattr(slip, "WHOLE_STEPS", 1)
    monkeypatch.setattr(slip, "HALF_STEPS", 0)
    monkeypatch.setattr(slip, "STILL_MM", -1.0)
    signatures = slip.EFFECT.signatures(model_of())
    assert signatures
    assert all("slid path" in signature.untried and not signature.columns for signature in signatures)


def test_a_loose_pit_whose_gap_does_not_settle_says_so(monkeypatch):
    monkeypatch.setattr(loose_pit, "STILL", 0.0)
    with pytest.raises(FemFailure, match="gap") as failure:
        loose_pit.EFFECT.respond(model_of(), {"gap_mm": 0.1}, loose_pit.at_gap(0.1, pit_turns=True))
    assert failure.value.problem is FemProblem.NOT_CONVERGED
