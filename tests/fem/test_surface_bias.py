"""The error of a scanned surface is no skin: what it adds to the products with the data is taken out."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from injected_mismatch import finders_mesh, injected_case
from plain_model import case_model

from fem.estimation.sensitivity import mean_normal
from fem.mesh.boundary_fit import t10_jacobians
from fem.mismatch.effects.skin import EFFECT as SKIN
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.linear_evidence import GramMatrix, plain_data
from fem.mismatch.evidence.surface_bias import surface_products, with_drawn_surface
from fem.mismatch.model.case_model import CaseModel
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.shape_derivative import WAVE_MM, with_surface_error

ERROR_MM = 0.2
SEEDS = (11, 12, 13)


@cache
def forward_with(error_mm: float, seed: int) -> CaseModel:
    """The finder's model of a fruit without a skin, almost without noise; its mesh has a drawn error."""
    case = injected_case(noise=0.02)
    if error_mm:
        pads = [
            (pad.surface_mm, -mean_normal(pad.force_N[8]))
            for grasp in case.grasps
            for pad in grasp.history.pads
        ]
        rng = np.random.default_rng(seed)
        case = replace(case, mesh=with_surface_error(case.mesh, pads, sd_mm=error_mm, rng=rng))
    case = replace(case, budget=replace(case.budget, surface_sd_mm=ERROR_MM))
    return case_model(case)[0]


def equations_of(model: CaseModel) -> list[GraspEquations]:
    return [GraspEquations.of(model, recording) for recording in model.grasps]


def product_of_skin(model: CaseModel) -> float:
    """phi . W y of a skin, the sum over recordings."""
    (column,) = SKIN.signatures(model)[0].columns
    total = 0.0
    for equations, field in zip(equations_of(model), column.fields, strict=True):
        plain, weighed = equations.rows([plain_data(model, equations), field])
        total += float(weighed[1] @ plain[0])
    return total


def expected_product(model: CaseModel) -> float:
    signature = SKIN.signatures(model)[0]
    return float(surface_products(model, equations_of(model), [(SKIN, signature, (1,))], columns=2).sum())


def test_the_expected_product_is_the_mean_over_surface_errors_and_their_opposites() -> None:
    """Of errors that other seeds draw; pairs of opposite errors leave no first order."""
    exact = product_of_skin(forward_with(0.0, 0))
    pairs = [
        np.mean([product_of_skin(forward_with(sign * ERROR_MM, seed)) for sign in (1, -1)]) for seed in SEEDS
    ]
    expected = np.mean([expected_product(forward_with(ERROR_MM, seed)) for seed in SEEDS])
    assert expected > 0
    assert np.mean(pairs) - exact == pytest.approx(expected, rel=0.5)


def test_columns_of_other_effects_and_of_the_plain_model_stay() -> None:
    model = forward_with(0.0, 0)
    equations = equations_of(model)
    signature = SKIN.signatures(model)[0]
    surface = surface_products(model, equations, [(SKIN, signature, (2,))], columns=3)
    assert not surface[:, :2].any()
    columns = [replace(signature.columns[0], name="another"), *signature.columns]
    before = GramMatrix(model, equations, columns).products
    after = GramMatrix(model, equations, columns, surface=surface).products
    for k, (a, b) in enumerate(zip(before, after, strict=True)):
        change = np.zeros_like(a)
        change[0, 3] = change[3, 0] = -surface[k, 2]
        np.testing.assert_allclose(b - a, change, atol=1e-9 * np.abs(a).max())


def test_the_drawn_error_has_the_size_that_is_asked_for_and_turns_no_element() -> None:
    mesh = finders_mesh()
    size_mm = []
    for seed in range(8):
        moved = with_surface_error(mesh, [], sd_mm=ERROR_MM, rng=np.random.default_rng(seed))
        assert t10_jacobians(moved.nodes_mm, moved.tets).min() > 0
        np.testing.assert_array_equal(moved.nodes_mm[mesh.pit_nodes], mesh.nodes_mm[mesh.pit_nodes])
        off = np.linalg.norm((moved.nodes_mm - mesh.nodes_mm)[mesh.outer_nodes], axis=1)
        size_mm.append(np.sqrt(np.mean(off**2)))
    assert np.sqrt(np.mean(np.square(size_mm))) == pytest.approx(ERROR_MM, rel=0.15)
    assert WAVE_MM > 4 * ERROR_MM


def test_the_nearby_solid_is_the_factorised_one_to_first_order() -> None:
    model = forward_with(0.0, 0)
    (solid,) = model.base.solids.values()
    nearby = with_drawn_surface(model)
    (moved,) = nearby.base.solids.values()
    exact = UnitModulusSolid.factorise(nearby.mesh, poisson_ratio=solid.poisson_ratio, support=solid.support)
    field = np.random.default_rng(3).normal(size=3 * len(solid.mesh.nodes_mm))
    load = (solid.stiffness @ field).reshape(1, -1, 3)  # balanced
    before, expected = solid.displacement(load), exact.displacement(load)
    change, off = (expected - before).ravel(), (moved.displacement(load) - expected).ravel()
    assert 0 < off @ solid.stiffness @ off < 1e-3 * (change @ solid.stiffness @ change)
