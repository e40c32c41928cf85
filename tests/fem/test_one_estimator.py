"""Grading and explaining drive their models with the same forces, fit the same markers and infer one E."""

from dataclasses import replace

import pytest
from injected_mismatch import E_MPA, injected_case, linear_and_refitted
from plain_model import case_model

from fem.elements.assembly import assemble
from fem.estimation.compliance_fit import fit_compliance
from fem.estimation.grasp_model import grasp_model
from fem.estimation.joint_inference import joint_modulus
from fem.estimation.modulus import estimate_modulus
from fem.estimation.prepared_grasp import prepared_grasp
from fem.estimation.unit_response import marker_tracks
from fem.mismatch.effect import Response
from fem.mismatch.effects import pit_size
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import plain_model
from fem.mismatch.procedure import as_graded
from fem.mismatch.result import Modulus
from fem.mismatch.selection.modulus_with import modulus_of, modulus_with
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes

SAME = 5e-4
"""Relative difference of two 1/E that count as the same number: a twentieth of the least error bar."""


@pytest.fixture(scope="module")
def case():
    return injected_case()


@pytest.fixture(scope="module")
def prepared(case):
    return [prepared_grasp(grasp.history, grasp.turns) for grasp in case.grasps]


@pytest.fixture(scope="module")
def models(case, prepared):
    histories = [grasp.history for grasp in prepared]
    solid = UnitModulusSolid.factorise(
        case.mesh,
        poisson_ratio=case.poisson_ratio,
        support=case.grasps[0].support,
        parts=assemble(case.mesh.nodes_mm, case.mesh.tets),
        contact_nodes=contact_nodes(case.mesh, histories),
    )
    return tuple(grasp_model(history, solid) for history in histories)


@pytest.fixture(scope="module")
def graded(case, prepared, models):
    """What grading makes of each grasp."""
    return [
        estimate_modulus(grasp.history, model, budget=case.budget)
        for grasp, model in zip(prepared, models, strict=True)
    ]


@pytest.fixture(scope="module")
def base(case):
    return plain_model(case)


@pytest.fixture(scope="module")
def compliances(case, base):
    """1/E of the models that explaining starts from, one recording after the other."""
    scale_sd = case.budget.gel_scale_sd
    return [
        fit_compliance(grasp.tracks, scale_sd=scale_sd, fruit_moves=True).compliance for grasp in base.grasps
    ]


@pytest.fixture(scope="module")
def model(case, models):
    # flesh here moves by small strain
    return replace(case_model(case)[0], graded=models, beyond_small_strain=False)


def test_the_plain_model_of_explain_has_the_compliance_of_grading(
    case, prepared, models, graded, compliances
):
    """By the same fit, and by the estimate that weighs the pads."""
    for grasp, model, estimate, plain in zip(prepared, models, graded, compliances, strict=True):
        tracks, _ = marker_tracks(grasp.history, model, grasp.used)
        fit = fit_compliance(tracks, scale_sd=case.budget.gel_scale_sd, fruit_moves=model.fruit_moves)
        assert plain == pytest.approx(fit.compliance, rel=SAME)
        assert plain == pytest.approx(1 / estimate.E_MPa, rel=SAME)


def test_of_one_recording_explaining_infers_the_modulus_and_its_error_bar_as_grading_does(
    case, models, graded, base, compliances
):
    single = replace(base, grasps=base.grasps[:1])
    # flesh here moves by small strain
    model = CaseModel(base=single, compliance=compliances[0], graded=models[:1], beyond_small_strain=False)
    unit = base.grasps[0].tracks.unit_displacement
    alone = joint_modulus([graded[0].evidence], budget=case.budget, infer_pit=False)
    for modulus in (modulus_of(model), modulus_of(model, Response(unit=(unit,)))):
        assert modulus.value == pytest.approx(alone.E_MPa, rel=SAME)
        assert modulus.sd == pytest.approx(alone.E_sd_MPa, rel=0.02)
    half = modulus_of(model, Response(unit=[unit / 2])).value
    assert half == pytest.approx(modulus_of(model).value / 2, rel=SAME)


def test_without_an_effect_it_is_what_grading_infers_of_all_grasps(case, graded, model):
    together = joint_modulus([estimate.evidence for estimate in graded], budget=case.budget, infer_pit=True)
    modulus = modulus_of(model)
    assert modulus.value == pytest.approx(together.E_MPa, rel=2e-3)
    assert modulus.sd == pytest.approx(together.E_sd_MPa, rel=0.05)
    assert modulus.value == pytest.approx(E_MPA, rel=0.01)


def test_a_recording_that_grading_has_no_modulus_of_has_no_part_in_it(case, graded, model, models):
    alone = joint_modulus([graded[0].evidence], budget=case.budget, infer_pit=False)
    lost = replace(model, graded=(models[0], None))
    first, second = (grasp.tracks.unit_displacement for grasp in model.grasps)
    for modulus in (modulus_of(lost), modulus_of(lost, Response(unit=[first, -second]))):
        assert modulus.value == pytest.approx(alone.E_MPa, rel=2e-3)
        assert modulus.sd == pytest.approx(alone.E_sd_MPa, rel=0.05)


def test_E_is_in_proportion_to_the_graded_one(model):
    half = Response(unit=[grasp.tracks.unit_displacement / 2 for grasp in model.grasps])
    graded = as_graded(model, Modulus(value=0.3, sd=0.01))
    assert modulus_of(graded).value == pytest.approx(0.3)
    ratio = modulus_of(model, half).value / modulus_of(model).value
    assert modulus_of(graded, half).value == pytest.approx(0.3 * ratio)


def test_where_grading_has_none_it_is_the_mean_of_the_recordings_own_fits(model):
    plain = modulus_of(replace(model, graded=()))
    assert modulus_of(replace(model, graded=(None, None))) == plain
    assert plain.value == pytest.approx(E_MPA, rel=0.02)


def test_what_an_effect_searches_for_no_longer_counts_with_its_prior(case, models):
    again = linear_and_refitted(case, pit_size.EFFECT)[2]
    again = replace(again, model=replace(again.model, graded=models))
    modulus = modulus_with(again)
    assert modulus.at.sd < 0.97 * modulus_of(again.model, again.response).sd
    assert modulus.known.sd > modulus.at.sd
