"""With an effect that is known in the model, the modulus of a recording that shows it is right."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from injected_mismatch import E_MPA, injected_case, only_grasp
from pinched_case_model import as_case, long_pinch, model_of
from plain_model import kept_solid
from test_mismatch_core_viscoelastic import relaxed

from fem.estimation.grasp_model import grasp_model
from fem.estimation.modulus import estimate_modulus
from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch import displacement_correction
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.displacement_correction import KnownEffect, displacement_corrections
from fem.mismatch.effect_spec import Entry
from fem.mismatch.effects import skin, viscoelastic
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.signature_variant import ONE_WAY
from fem.solid.pad_link import contact_nodes

G, TAU_S = 0.35, 1.2
RELAXING = KnownEffect(effect=viscoelastic.EFFECT, parameters=lambda _: {"g": G, "tau_s": TAU_S})


@cache
def relaxed_case() -> MismatchCase:
    """A grasp of flesh that relaxes, by the convolution that defines it."""
    return only_grasp(injected_case(crept=partial(relaxed, g=G, tau_s=TAU_S)), 1)


@pytest.mark.slow
def test_relaxing_flesh_is_too_soft_without_its_law_and_right_with_it():
    case = relaxed_case()
    history = case.grasps[0].history
    solid = replace(
        kept_solid(case.mesh, case.poisson_ratio, "free"), contact_nodes=contact_nodes(case.mesh, [history])
    )
    model = grasp_model(history, solid)
    (beyond,) = displacement_corrections(case, [RELAXING], at_finite_strain=True)
    informed = replace(model, displacement_correction=beyond)
    without, with_law = (estimate_modulus(history, each, budget=case.budget) for each in (model, informed))
    assert without.E_MPa < 0.93 * E_MPA
    assert with_law.E_MPa == pytest.approx(E_MPA, rel=0.02)
    assert not beyond[:3].any()


def test_known_effects_whose_modulus_does_not_settle_say_so(monkeypatch):
    monkeypatch.setattr(displacement_correction, "STILL", -1.0)
    with pytest.raises(FemFailure, match="E with viscoelastic still changes") as failure:
        displacement_corrections(relaxed_case(), [RELAXING], at_finite_strain=True)
    assert failure.value.problem is FemProblem.NOT_CONVERGED


@pytest.mark.parametrize("at_finite_strain", [True, False])
def test_a_skin_of_so_many_newtons_per_millimetre_counts_in_the_modulus_that_comes_with_it(
    at_finite_strain: bool,
):
    E_MPa, Et_N_per_mm = 0.3, 1.5
    model = replace(model_of(), compliance=1 / E_MPa, beyond_small_strain=at_finite_strain)
    recording = model.grasps[0]
    (stiff,) = skin.EFFECT.respond(model, {"Et_over_E_mm": Et_N_per_mm / E_MPa}, ONE_WAY).unit
    history = long_pinch()
    ends = np.cumsum([len(pad.rest_mm) for pad in history.pads])[:-1]
    pads = tuple(
        replace(pad, position_mm=pad.surface_mm + displacement / E_MPa)
        for pad, displacement in zip(history.pads, np.split(stiff, ends, axis=1), strict=True)
    )
    known = KnownEffect(effect=skin.EFFECT, parameters=lambda E: {"Et_over_E_mm": Et_N_per_mm / E})
    (beyond,) = displacement_corrections(
        as_case(replace(history, pads=pads)), [known], at_finite_strain=at_finite_strain
    )
    wanted = stiff - recording.tracks.unit_displacement
    assert np.abs(beyond - wanted).max() < 0.01 * np.abs(wanted).max()


def test_known_effects_of_a_fruit_that_does_not_move_have_no_modulus():
    known = KnownEffect(effect=skin.EFFECT, parameters=lambda E: {"Et_over_E_mm": 1.5 / E})
    with pytest.raises(FemFailure, match="do not move the fruit") as failure:
        displacement_corrections(as_case(long_pinch()), [known], at_finite_strain=True)
    assert failure.value.problem is FemProblem.NO_MODULUS


VALUES = {"radius_mm": 5.0, "ratio": 0.5, "nu": 0.42, "scale": 0.95, "mu": 0.3, "gap_mm": 0.006}
"""Where a small share of the upper bound, as taken for the other parameters, is no effect that can be."""


@pytest.mark.parametrize(
    "effect",
    [effect for effect in EFFECTS if effect.spec.enters is Entry.RESPONSE],
    ids=lambda effect: effect.spec.name,
)
def test_every_effect_that_changes_the_response_has_a_correction(effect):
    """By its parameters alone: settings know no more of it."""
    model = model_of()
    values = {
        spec.name: VALUES.get(spec.name, 0.05 * spec.high if spec.low >= 0 else 0.01 * spec.high)
        for spec in effect.spec.searched
    }
    (correction,) = displacement_correction._corrections(
        model, [KnownEffect(effect=effect, parameters=lambda _: values)]
    )
    assert correction.shape == model.grasps[0].tracks.unit_displacement.shape
    assert np.isfinite(correction).all()
    if effect.spec.family == "object":  # a contact corrects what the recording shows of it, here nothing
        assert np.abs(correction).max() > 0
