"""Grading and explaining drive their models with the same forces and fit the same markers."""

import pytest
from injected_mismatch import injected_case, only_grasp

from fem.elements.assembly import assemble
from fem.estimation.compliance_fit import fit_compliance
from fem.estimation.grasp_model import grasp_model
from fem.estimation.joint_inference import joint_modulus
from fem.estimation.modulus import estimate_modulus
from fem.estimation.prepared_grasp import prepared_grasp
from fem.estimation.unit_response import marker_tracks
from fem.mismatch.effect import Response
from fem.mismatch.evidence.large_deformation import leave_large_deformation
from fem.mismatch.model.baseline import baseline
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.selection.modulus_with import modulus_of
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes

SAME = 5e-4
"""Relative difference of two 1/E that count as the same number: a twentieth of the least error bar."""


@pytest.fixture(scope="module")
def case():
    return only_grasp(injected_case(), 0)


@pytest.fixture(scope="module")
def graded(case):
    """Model and recording as grading has them."""
    (grasp,) = case.grasps
    prepared = prepared_grasp(grasp.history, grasp.turns)
    solid = UnitModulusSolid.factorise(
        case.mesh,
        poisson_ratio=case.poisson_ratio,
        support=grasp.support,
        parts=assemble(case.mesh.nodes_mm, case.mesh.tets),
        contact_nodes=contact_nodes(case.mesh, [prepared.history]),
    )
    return prepared.history, grasp_model(prepared.history, solid), prepared.used


@pytest.fixture(scope="module")
def estimate(case, graded):
    """What grading makes of the recording."""
    history, model, _ = graded
    return estimate_modulus(history, model, budget=case.budget)


@pytest.fixture(scope="module")
def plain(case):
    """1/E of the model that explaining starts from."""
    (recording,) = baseline(case).grasps
    free = recording.case.support == "free"
    return fit_compliance(recording.tracks, scale_sd=case.budget.gel_scale_sd, fruit_moves=free).compliance


def test_the_plain_model_of_explain_has_the_compliance_of_grading(case, graded, plain):
    history, model, used = graded
    tracks, _ = marker_tracks(history, model, used)
    fit = fit_compliance(tracks, scale_sd=case.budget.gel_scale_sd, fruit_moves=model.fruit_moves)
    assert plain == pytest.approx(fit.compliance, rel=SAME)


def test_grading_weighs_the_pads_of_one_recording_to_the_same_modulus(estimate, plain):
    assert plain == pytest.approx(1 / estimate.E_MPa, rel=SAME)


def test_explaining_infers_the_modulus_and_its_error_bar_as_grading_does(case, graded, estimate, plain):
    _, model, _ = graded
    base = baseline(case)
    own = tuple(one.tracks.unit_displacement for one in base.grasps)
    forward = ForwardModel(base=base, compliance=plain, graded=(model,))
    leave_large_deformation(forward)  # flesh here moves by small strain
    alone = joint_modulus([estimate.evidence], budget=case.budget, infer_pit=False)
    for found in (modulus_of(forward), modulus_of(forward, Response(unit=own))):
        assert found.value == pytest.approx(alone.E_MPa, rel=SAME)
        assert found.sd == pytest.approx(alone.E_sd_MPa, rel=0.02)


def test_a_response_half_as_large_halves_the_modulus(case, graded, plain):
    _, model, _ = graded
    base = baseline(case)
    half = Response(unit=[one.tracks.unit_displacement / 2 for one in base.grasps])
    forward = ForwardModel(base=base, compliance=plain, graded=(model,))
    leave_large_deformation(forward)  # flesh here moves by small strain
    assert modulus_of(forward, half).value == pytest.approx(modulus_of(forward).value / 2, rel=SAME)
