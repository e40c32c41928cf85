"""E with an effect, by grading's models of two grasps: the same inference as E without one."""

from dataclasses import replace

import pytest
from injected_mismatch import E_MPA, injected_case, linear_and_refitted
from plain_model import plain_forward_model

from fem.elements.assembly import assemble
from fem.estimation.grasp_model import grasp_model
from fem.estimation.joint_inference import joint_modulus
from fem.estimation.modulus import estimate_modulus
from fem.estimation.prepared_grasp import prepared_grasp
from fem.mismatch.effect import Response
from fem.mismatch.effects import pit_size
from fem.mismatch.evidence.large_deformation import leave_large_deformation
from fem.mismatch.procedure import as_graded
from fem.mismatch.result import Modulus
from fem.mismatch.selection.modulus_with import modulus_of, modulus_with
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes


@pytest.fixture(scope="module")
def case():
    return injected_case()


@pytest.fixture(scope="module")
def histories(case):
    return [prepared_grasp(grasp.history, grasp.turns).history for grasp in case.grasps]


@pytest.fixture(scope="module")
def models(case, histories):
    solid = UnitModulusSolid.factorise(
        case.mesh,
        poisson_ratio=case.poisson_ratio,
        support=case.grasps[0].support,
        parts=assemble(case.mesh.nodes_mm, case.mesh.tets),
        contact_nodes=contact_nodes(case.mesh, histories),
    )
    return tuple(grasp_model(history, solid) for history in histories)


@pytest.fixture(scope="module")
def graded(case, histories, models):
    """What grading makes of each grasp."""
    return [estimate_modulus(*pair, budget=case.budget) for pair in zip(histories, models, strict=True)]


@pytest.fixture(scope="module")
def forward(case, models):
    forward = replace(plain_forward_model(case)[0], graded=models)
    leave_large_deformation(forward)  # flesh here moves by small strain
    return forward


def test_without_an_effect_it_is_what_grading_infers_of_all_grasps(case, graded, forward):
    together = joint_modulus([one.evidence for one in graded], budget=case.budget, infer_pit=True)
    found = modulus_of(forward)
    assert found.value == pytest.approx(together.E_MPa, rel=2e-3)
    assert found.sd == pytest.approx(together.E_sd_MPa, rel=0.05)
    assert found.value == pytest.approx(E_MPA, rel=0.01)


def test_a_recording_that_grading_has_no_modulus_of_has_no_part_in_it(case, graded, forward, models):
    alone = joint_modulus([graded[0].evidence], budget=case.budget, infer_pit=False)
    lost = replace(forward, graded=(models[0], None))
    against_itself = Response(
        unit=[
            sign * one.tracks.unit_displacement
            for sign, one in zip((1, -1), forward.base.grasps, strict=True)
        ]
    )
    for found in (modulus_of(lost), modulus_of(lost, against_itself)):
        assert found.value == pytest.approx(alone.E_MPa, rel=2e-3)
        assert found.sd == pytest.approx(alone.E_sd_MPa, rel=0.05)


def test_E_is_in_proportion_to_the_graded_one(forward):
    half = Response(unit=[one.tracks.unit_displacement / 2 for one in forward.base.grasps])
    graded = as_graded(forward, Modulus(value=0.3, sd=0.01))
    assert modulus_of(graded).value == pytest.approx(0.3)
    ratio = modulus_of(forward, half).value / modulus_of(forward).value
    assert modulus_of(graded, half).value == pytest.approx(0.3 * ratio)


def test_where_grading_has_none_it_is_the_mean_of_the_recordings_own_fits(forward):
    plain = modulus_of(replace(forward, graded=()))
    assert modulus_of(replace(forward, graded=(None, None))) == plain
    assert plain.value == pytest.approx(E_MPA, rel=0.02)


def test_what_an_effect_searches_for_no_longer_counts_with_its_prior(case, models):
    again = linear_and_refitted(case, pit_size.EFFECT)[2]
    again = replace(again, forward=replace(again.forward, graded=models))
    found = modulus_with(again)
    assert found.at.sd < 0.97 * modulus_of(again.forward, again.response).sd
    assert found.known.sd > found.at.sd
