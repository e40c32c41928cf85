"""Large deformation under an effect of the flesh: its forces at finite strain, and how it changes."""

from dataclasses import replace

import numpy as np
import pytest
from coarse_fruit import NU, fruit_mesh
from pinched_case_model import model_of
from scipy.spatial.transform import Rotation
from test_mismatch_large_deformation import by_newton

from fem.materials.fung_neo_hookean import fung_neo_hookean, neo_hookean_tangent
from fem.materials.neo_hookean import NeoHookean
from fem.materials.strain_path import linear_stress
from fem.mismatch.effects import anisotropy, graded_modulus, poisson_ratio, skin, soft_spot
from fem.mismatch.kinds.linear_law import LinearLaw, matrix_operator, neo_hookean_operator
from fem.mismatch.model import finite_change as module
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.finite_change import finite_change, in_proportion
from fem.mismatch.model.reduced_law import Operator
from fem.mismatch.model.stress_history import HARDLY_ANY, path_state, stiffening_path
from fem.solid.initial_stress import AddedStress
from fem.solid.membrane import membrane_forces

LAWS = [effect.EFFECT for effect in (anisotropy, graded_modulus, poisson_ratio, skin)]
OF_LAWS = pytest.mark.parametrize("effect", LAWS, ids=[effect.spec.name for effect in LAWS])


@OF_LAWS
def test_forces_at_finite_strain_are_the_linear_ones_where_strains_are_small(effect: LinearLaw):
    model = model_of()
    moved = 1e-3 * model.grasps[0].moved[:2]
    finite, linear = effect.finite(model)(moved), effect.derivative(model)(moved)
    assert np.linalg.norm(finite - linear) < 0.02 * np.linalg.norm(linear)


@OF_LAWS
def test_a_fruit_that_only_turns_has_no_forces(effect: LinearLaw):
    """Under the same turn the linear law has some."""
    model = model_of()
    places = model.mesh.nodes_mm
    turned = (Rotation.from_rotvec([0.2, 0.1, 0.3]).apply(places) - places)[None]
    finite, linear = effect.finite(model)(turned), effect.derivative(model)(turned)
    assert np.abs(finite).max() < 1e-4 * np.abs(linear).max()


def test_a_skin_stretched_equally_has_the_energy_of_the_closed_form():
    """x to L x: the sum of f . x is 2 S L^2 times the area, S = (L^2 - 1) / 2 / (1 - nu)."""
    mesh, stretch = fruit_mesh(), 1.1
    places = mesh.nodes_mm
    force = membrane_forces(mesh, ((stretch - 1) * places)[None], poisson_ratio=NU)[0]
    corners = places[mesh.outer_faces[:, :3]]
    flat = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    stress = (stretch**2 - 1) / 2 / (1 - NU)
    expected = 2 * stress * stretch**2 * flat.sum() / 2
    assert (force * stretch * places).sum() == pytest.approx(expected, rel=0.05)  # faces are curved


def test_the_tangent_is_that_of_the_neo_hookean_law():
    rng = np.random.default_rng(2)
    gradient, change = 0.1 * rng.normal(size=(2, 4, 3, 3, 5)), rng.normal(size=(2, 4, 3, 3, 5))
    added = neo_hookean_tangent(poisson_ratio=NU)(gradient)(change)

    def by_points(tensors: np.ndarray) -> np.ndarray:  # [j, i] to [i, j]
        return np.moveaxis(tensors, -1, 2).reshape(-1, 3, 3).swapaxes(1, 2)

    F = np.eye(3) + by_points(gradient)
    tangent = NeoHookean(poisson_ratio=NU).tangent(F)
    expected = np.einsum("qijkl,qkl->qij", tangent, by_points(change))
    expected -= by_points(linear_stress(change, poisson_ratio=NU))
    np.testing.assert_allclose(by_points(added), expected, atol=1e-10)


@pytest.mark.slow
def test_flesh_that_is_stiffer_as_a_whole_moves_as_under_a_smaller_load(monkeypatch):
    """(1 + a) F(w) = f: dw/da is minus the derivative to the load, here by Newton's method."""
    monkeypatch.setattr(module, "CLOSE_MM", 1e-5)
    model = replace(model_of(), compliance=8.0)
    uniform = np.ones(model.points.point_mm.shape[:2])
    operators = neo_hookean_operator(model, uniform), matrix_operator(model.stiffness)
    changed = finite_change(model, "uniform", lambda: operators, amount=1.0)[0]
    step = 0.02
    slope = (by_newton(model, share=1 + step) - by_newton(model, share=1 - step)) / (2 * step)
    expected = 1e3 * by_newton(model, share=1e-3) - slope
    size = np.linalg.norm(model.compliance * changed), np.linalg.norm(expected)
    assert model.compliance * (changed * expected).sum() / np.prod(size) > 0.998
    assert size[0] / size[1] == pytest.approx(1.0, abs=0.03)


def marker_change(model: CaseModel, force: Operator) -> np.ndarray:
    """The markers' motion beyond the linear one under a law that adds these forces (E = 1 MPa)."""
    state = stiffening_path(model)
    problem = AddedStress(
        linear=state.linear,
        added_force=force,
        response=state.response,
        compliance=model.compliance,
        stiffer=np.ones(len(state.linear)),
        skin=model.mesh.outer_nodes,
    )
    return state.at_markers(problem.beyond_linear(start=None, together=False, tolerance_mm=1e-5, rounds=60))[
        0
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "share"), [(anisotropy.EFFECT, 0.05), (skin.EFFECT, 0.01)])
def test_the_change_is_that_of_flesh_solved_with_a_little_of_the_effect(
    monkeypatch, effect: LinearLaw, share: float
):
    """The share of the usual amount is small enough for a derivative, large enough above rounding."""
    monkeypatch.setattr(module, "CLOSE_MM", 1e-5)
    model = replace(model_of(), compliance=8.0)
    finite, linear = effect.finite(model), effect.derivative(model)
    flesh = fung_neo_hookean(HARDLY_ANY, poisson_ratio=NU)
    amount = share * effect.sd

    def slope(of_flesh: Operator, of_effect: Operator) -> np.ndarray:
        ahead, back = (
            marker_change(model, lambda moved, way=way: of_flesh(moved) + way * amount * of_effect(moved))
            for way in (1, -1)
        )
        return (ahead - back) / (2 * amount)

    large = slope(lambda moved: model.pieces.forces(moved, flesh), finite)
    small = slope(np.zeros_like, linear)
    (changed,) = finite_change(model, effect.spec.name, lambda: (finite, linear), amount=effect.sd)
    expected = large - small
    assert np.linalg.norm(changed - expected) < 0.02 * np.linalg.norm(expected)


@pytest.mark.slow
def test_half_of_the_frames_give_nearly_the_same_change(monkeypatch):
    model = replace(model_of(), compliance=8.0)
    operators = lambda: (skin.EFFECT.finite(model), skin.EFFECT.derivative(model))  # noqa: E731
    (expected,) = finite_change(model, "all", operators, amount=skin.EFFECT.sd)
    monkeypatch.setattr(module, "FRAMES", 4)
    (changed,) = finite_change(model, "half", operators, amount=skin.EFFECT.sd)
    assert 0 < np.linalg.norm(changed - expected) < 0.05 * np.linalg.norm(expected)


def test_fewer_frames_are_found_among_more_and_missing_ones_are_refused():
    model = model_of()
    few, more = (path_state(model, frames=count, remembers=False) for count in (4, 7))
    np.testing.assert_array_equal(more.linear[few.among(more)], few.linear)
    with pytest.raises(ValueError, match="lacks frames"):
        more.among(few)


@pytest.mark.parametrize("amount", [-0.3, 0.3])
def test_a_response_has_the_share_of_the_finite_change_that_it_has_of_the_first(amount: float):
    rng = np.random.default_rng(5)
    plain, first, finite = (rng.normal(size=(4, 3, 3)) for _ in range(3))
    (whole,) = in_proportion([plain + amount * first], [plain], [first], [finite])
    np.testing.assert_allclose(whole, plain + amount * (first + finite))


def changes_of(model: CaseModel) -> list[np.ndarray]:
    """What large deformation adds to the depth-dependent modulus and to a soft spot."""
    effect = graded_modulus.EFFECT
    assert isinstance(effect, LinearLaw)
    spot = soft_spot._changes(model, np.array([0.0, 20.0, 0.0]), 6.0)[1]
    operators = effect.finite(model), effect.derivative(model)
    return [finite_change(model, "graded", lambda: operators, amount=0.4)[0], spot[0]]


@pytest.mark.parametrize(("compliance", "beyond_small_strain"), [(60.0, True), (4.0, False)])
def test_nothing_changes_where_large_deformation_is_not_part_of_the_model(
    compliance: float, beyond_small_strain: bool
):
    """Not found for flesh so soft, or held by the response already; elsewhere something does."""
    model = replace(model_of(), compliance=compliance, beyond_small_strain=beyond_small_strain)
    assert not any(change.any() for change in changes_of(model))
    assert all(change.any() for change in changes_of(replace(model_of(), compliance=4.0)))


@pytest.mark.slow
def test_at_another_modulus_the_change_is_nearly_that_solved_there():
    model = replace(model_of(), compliance=3.0)
    softer = replace(model_of(), compliance=3.6)
    changes_of(model)
    solved = changes_of(softer)[0]
    scaled = changes_of(replace(model, compliance=3.6))[0]
    assert np.linalg.norm(scaled - solved) < 0.06 * np.linalg.norm(solved)
