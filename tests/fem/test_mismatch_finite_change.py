"""Large deformation: against Newton and exact rotations, alone and under an effect of the flesh."""

from dataclasses import replace

import numpy as np
import pytest
from coarse_fruit import NU, fruit_mesh
from injected_mismatch import E_MPA, NOISE_MM, TIME_S, injected_case, only_grasp, pads_under
from pinched_case_model import model_of
from plain_model import case_model, screened_effects
from scipy.spatial.transform import Rotation

from fem.fem_failure import FemFailure
from fem.materials.fung_neo_hookean import fung_neo_hookean, neo_hookean_tangent
from fem.materials.neo_hookean import NeoHookean
from fem.materials.strain_path import linear_stress
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.effects import anisotropy, graded_modulus, poisson_ratio, skin, soft_spot, stiffening
from fem.mismatch.evidence import beyond_small_strain
from fem.mismatch.evidence.beyond_small_strain import (
    LARGE_DEFORMATION,
    TURNED_FRUIT,
    displacement_beyond,
    from_first_loading,
    large_deformation,
    turned_fruit,
)
from fem.mismatch.evidence.nuisances import common_nuisances
from fem.mismatch.kinds.linear_law import LinearLaw, matrix_operator, neo_hookean_operator
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.model import finite_change as module
from fem.mismatch.model import stress_history
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.finite_change import finite_change, in_proportion
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.model.reduced_law import Operator
from fem.mismatch.model.stress_history import HARDLY_ANY, path_state, stiffening_path
from fem.mismatch.model.warm_start import MOST, NEAR, WarmStarts, quadratic_surrogate
from fem.mismatch.selection import screening
from fem.mismatch.selection.refinement import refit
from fem.mismatch.selection.screening import LinearRound
from fem.solid.finite_strain import FiniteStrainSolid
from fem.solid.initial_stress import AddedStress
from fem.solid.membrane import membrane_forces


def by_newton(model: CaseModel, *, share: float = 1.0) -> np.ndarray:
    """The markers' displacement, mm, of Neo-Hookean flesh under this share of the loads, all frames."""
    recording = model.grasps[0]
    solid = recording.solid
    force = np.tensordot(recording.shares, recording.patterns, axes=1)
    load = share * model.compliance * recording.loads(force)
    newton = FiniteStrainSolid(solid=solid, law=NeoHookean(poisson_ratio=NU))
    return recording.at_markers(newton.displacement(load))


def large_deformation_column(model: CaseModel) -> Regressor:
    (column,) = (nuisance for nuisance in common_nuisances(model) if nuisance.name == LARGE_DEFORMATION)
    return column


@pytest.mark.slow
def test_its_column_is_what_newtons_method_makes_of_neo_hookean_flesh(monkeypatch):
    monkeypatch.setattr(stress_history, "CLOSE_MM", 2e-6)
    model = model_of()
    beyond = by_newton(model) - 1e3 * by_newton(model, share=1e-3)
    signature = large_deformation_column(model).fields[0].markers
    size = np.linalg.norm(signature), np.linalg.norm(beyond)
    assert (signature * beyond).sum() / np.prod(size) > 0.999
    assert size[0] / size[1] == pytest.approx(1.0, abs=0.03)


@pytest.fixture(scope="module")
def neo_hookean() -> tuple[CaseModel, LinearRound]:
    """Soft flesh that deforms largely and does nothing else, and its linear round."""
    softer = replace(model_of(), compliance=12.0)
    recording = softer.grasps[0]
    tracks = replace(recording.tracks, position_mm=recording.tracks.place_mm + by_newton(softer))
    injected = replace(softer, base=replace(softer.base, grasps=(replace(recording, tracks=tracks),)))
    return injected, screened_effects(injected, [stiffening.EFFECT])


@pytest.mark.slow
def test_neo_hookean_flesh_deforms_largely_and_does_not_stiffen(neo_hookean):
    """The amount is found by the data: its prior is a tenth wide."""
    _, linear = neo_hookean
    columns = [linear.products.columns[j] for j in linear.null.chosen]
    (place,) = (k for k, column in enumerate(columns) if column.name == LARGE_DEFORMATION)
    assert columns[place].mean + linear.null.amounts[place] == pytest.approx(1.0, abs=0.1)
    assert linear.null.sd[place] < 0.07
    assert linear.best[0].gain < 0


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.8, 1.25])
def test_large_deformation_grows_with_the_fitted_compliance(neo_hookean, share):
    """Its amount stays at its prior mean where the plain model starts from another 1/E, `share` of the
    true one.
    """
    injected, _ = neo_hookean
    other = replace(injected, compliance=share * injected.compliance)
    linear = screened_effects(other, [])
    columns = [linear.products.columns[j].name for j in linear.null.chosen]
    assert share * (1 + linear.null.amounts[0]) == pytest.approx(1.0, abs=0.01)
    assert linear.null.amounts[columns.index(LARGE_DEFORMATION)] == pytest.approx(0.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.6, 1.5])
def test_a_refit_follows_the_fitted_compliance(neo_hookean, share):
    """A refit without a law that depends on 1/E ends at the true one, with large deformation of its size."""
    injected, _ = neo_hookean
    other = replace(injected, compliance=share * injected.compliance)
    linear = screened_effects(other, [poisson_ratio.EFFECT])
    again = refit(other, linear, (linear.best[0],))
    columns = [again.products.columns[j].name for j in again.fit.chosen]
    at = columns.index(LARGE_DEFORMATION)
    assert again.model.compliance == pytest.approx(injected.compliance, rel=0.03)
    assert again.fit.amounts[0] == pytest.approx(0.0, abs=0.01)
    assert again.fit.amounts[at] == pytest.approx(0.0, abs=0.1)
    assert again.products.columns[again.fit.chosen[at]].mean == pytest.approx(
        (again.model.compliance / other.compliance) ** 2
    )


@pytest.mark.slow
def test_stiffening_holds_large_deformation_itself(neo_hookean):
    """Its refit goes without the plain model's, and finds no more b than it starts from."""
    injected, linear = neo_hookean
    again = refit(injected, linear, (linear.best[0],))
    columns = [linear.products.columns[j].name for j in linear.nuisances]
    assert LARGE_DEFORMATION in columns
    assert LARGE_DEFORMATION not in [again.products.columns[j].name for j in again.fit.chosen]
    assert again.parameters[0]["b"] <= 1.0


def test_a_plain_model_that_holds_it_has_no_column_of_it():
    model = replace(model_of(), beyond_small_strain=False)
    assert LARGE_DEFORMATION not in [nuisance.name for nuisance in common_nuisances(model)]


@pytest.mark.parametrize("compliance", [28.0, 60.0])
def test_large_deformation_that_is_not_found_is_no_column_and_says_why(compliance):
    """Rounds that have not settled, and rounds that ran away."""
    soft = replace(model_of(), compliance=compliance)
    failure = large_deformation(soft)
    assert isinstance(failure, FemFailure)
    assert "moves by this law" in failure.detail
    assert LARGE_DEFORMATION not in [nuisance.name for nuisance in common_nuisances(soft)]


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
    expected = np.einsum("qijkl,qkl->qij", NeoHookean(poisson_ratio=NU).tangent(F), by_points(change))
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


POSE_ERROR = next(turning for turning in EFFECTS if turning.spec.name == "pose_error")
TURN_RAD = np.interp(TIME_S, [2.0, 3.0], [0.0, np.radians(4.0)])[:, None] * np.array([0.0, 0.8, 0.6])
"""From the greatest load on, about an axis across the jaws."""


def turned_case(turn_rad: np.ndarray) -> MismatchCase:
    """One grasp, y = Q (X + C Q'f / E), forces as recorded."""
    turn = Rotation.from_rotvec(turn_rad)

    def turned_back(force: np.ndarray) -> np.ndarray:
        return np.stack([q.inv().apply(frame_force) for q, frame_force in zip(turn, force, strict=True)])

    case = only_grasp(injected_case(), 0)
    grasp, rng = case.grasps[0], np.random.default_rng(1)
    pads = []
    for pad, true in zip(grasp.history.pads, pads_under(turned_back)[0], strict=True):
        body = true.place_mm + true.unit / E_MPA
        position = np.stack([q.apply(frame_body) for q, frame_body in zip(turn, body, strict=True)])
        noise = NOISE_MM * rng.normal(size=position.shape)
        pads.append(replace(pad, position_mm=position + noise))
    return replace(case, grasps=(replace(grasp, history=replace(grasp.history, pads=tuple(pads))),))


def looked_at(case: MismatchCase) -> LinearRound:
    """The linear round with pose errors alone; flesh that moves little."""
    model, _ = case_model(case)
    with pytest.MonkeyPatch.context() as patch:  # the forces are exact: no model error stands for the turn
        patch.setattr(screening, "model_error_columns", lambda *_, **__: [])
        for module in (screening, beyond_small_strain):
            patch.setattr(module, "large_deformation", lambda _: [])
        return screened_effects(model, [POSE_ERROR])


@pytest.mark.slow
def test_what_a_turn_adds_is_there_in_full_and_is_no_pose_error(monkeypatch):
    case = turned_case(TURN_RAD)
    linear = looked_at(case)
    columns = [linear.products.columns[j] for j in linear.null.chosen]
    (place,) = (k for k, column in enumerate(columns) if column.name == TURNED_FRUIT)
    share = columns[place].mean + linear.null.amounts[place]
    monkeypatch.setattr(beyond_small_strain, "turned_fruit", lambda *_: None)
    without = looked_at(case)
    assert share == pytest.approx(1.0, abs=0.1)
    assert linear.best[0].gain < 3
    assert without.best[0].gain > 100


def test_markers_move_by_large_deformation_and_by_the_turn():
    model, _ = case_model(turned_case(TURN_RAD))
    columns = beyond_small_strain.beyond_small_strain(model)
    assert [column.name for column in columns] == [LARGE_DEFORMATION, TURNED_FRUIT]
    (flesh,), turn = large_deformation(model), turned_fruit(model, model.grasps[0])
    (both,) = displacement_beyond(model)
    (alone,) = displacement_beyond(model, large_deformation=False)
    np.testing.assert_allclose(both, model.compliance * flesh + turn, rtol=1e-12)
    np.testing.assert_array_equal(alone, turn)


def test_nothing_is_added_where_the_fruit_does_not_turn():
    model, _ = case_model(only_grasp(injected_case(), 0))
    assert turned_fruit(model, model.grasps[0]) is None


def test_a_held_fruit_does_not_turn():
    case = turned_case(TURN_RAD)
    held = replace(case, grasps=(replace(case.grasps[0], support="base"),))
    model, _ = case_model(held)
    assert turned_fruit(model, model.grasps[0]) is None


def test_turns_count_from_the_first_loading_of_each_contact():
    # as they are seen: about the mean of each contact
    contact = np.repeat([0, -1, 1], [4, 1, 4])
    load = np.array([0.3, 0.6, 1.0, 0.5, 0.0, 0.2, 0.5, 0.9, 0.4])
    true = np.array([0.0, 0.0, 0.02, 0.02, 0.0, 0.01, 0.01, 0.05, 0.05])
    seen = true.copy()
    for number in (0, 1):
        seen[contact == number] -= true[contact == number].mean()
    turns = from_first_loading(seen[:, None] * np.eye(3)[0], load, contact)
    np.testing.assert_allclose(turns[:, 0], [0.0, 0.0, 0.02, 0.02, 0.0, 0.0, 0.0, 0.04, 0.04], atol=1e-12)


def curved(calls: list[np.ndarray], bend: float = 0.7):
    def first_order(theta):
        return [[np.array([2.0 * theta[0] - theta[1]])]]

    def exact(theta):
        calls.append(theta)
        return [[np.array([2.0 * theta[0] - theta[1] + bend * theta[0] ** 2])]]

    return first_order, exact


def asked(search, theta, calls, **options) -> float:
    first_order, exact = curved(calls, **options)
    return float(
        quadratic_surrogate(search, "pit", np.array(theta), first_order=first_order, exact=exact)[0][0][0]
    )


def test_along_the_anchor_a_square_law_is_exact_without_another_solve():
    search, calls = WarmStarts(), []
    assert asked(search, [1.0, 0.0], calls) == pytest.approx(2.7)
    assert asked(search, [1.3, 0.0], calls) == pytest.approx(2.6 + 0.7 * 1.69)
    assert len(calls) == 1


def test_parameters_next_to_none_leave_no_anchor_behind():
    search, calls = WarmStarts(), []
    assert asked(search, [0.5 * NEAR, 0.0], calls) == pytest.approx(NEAR)
    assert not calls
    assert asked(search, [2.0, 0.0], calls) == pytest.approx(4.0 + 2.8)
    assert len(calls) == 1


def test_far_from_every_anchor_the_model_is_computed_anew():
    search, calls = WarmStarts(), []
    asked(search, [0.4, 0.0], calls)
    assert asked(search, [2.0, 0.5], calls) == pytest.approx(3.5 + 2.8)
    assert len(calls) == 2
    assert asked(search, [0.4, 0.0], calls) == pytest.approx(0.8 + 0.7 * 0.16)
    assert len(calls) == 2


def test_a_search_starts_from_the_nearest_of_its_last_solutions():
    search = WarmStarts()
    assert search.nearest("law", np.zeros(1)) is None
    for k in range(MOST + 2):
        search.keep("law", np.array([float(k)]), k)
    assert search.nearest("law", np.array([4.2])) == (np.array([4.0]), 4)
    assert search.nearest("law", np.zeros(1)) == (np.array([2.0]), 2)
    assert search.nearest("other", np.zeros(1)) is None
