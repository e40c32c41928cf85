"""The model of a grasp and its sensitivities, against full solves on changed meshes and constants."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from coarse_fruit import NU, all_nodes, lowest_nodes, meshed, pinch_of, solid_of
from injected_mismatch import E_MPA, injected_case, linear_and_refitted
from plain_model import case_model

from fem.elements.assembly import assemble
from fem.estimation.compliance_fit import fit_compliance
from fem.estimation.grasp_model import grasp_model
from fem.estimation.joint_inference import joint_modulus
from fem.estimation.modulus import estimate_modulus
from fem.estimation.prepared_grasp import prepared_grasp
from fem.estimation.sensitivity import PIT, PIT_SIZE, POISSON_RATIO
from fem.estimation.unit_response import marker_tracks
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import FleshMesh
from fem.mesh.surface_points import skin_quadrature
from fem.mismatch.effect import Response
from fem.mismatch.effects import pit_size
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import plain_model
from fem.mismatch.procedure import as_graded
from fem.mismatch.result import Modulus
from fem.mismatch.selection.modulus_with import modulus_of, modulus_with
from fem.solid.closed_forms import cored_sphere_shrinkage_mm
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.moved_pit import with_pit_moved
from fem.solid.pad_link import contact_nodes, pad_link
from fem.solid.rigid_core import rigid_modes
from fem.solid.shape_derivative import pit_velocities, skin_velocities, stiffness_change, work_of_change


@cache
def fruit_mesh() -> FleshMesh:
    """On the mesh of coarse_fruit derivatives by moved nodes miss by up to 8 in 1000."""
    return meshed(1 / 8)


@cache
def pinch() -> GraspHistory:
    return pinch_of(fruit_mesh())


@cache
def fruit_solid(support: str) -> UnitModulusSolid:
    return solid_of(fruit_mesh(), pinch(), support)


SHIFT = np.array([0.6, -0.64, 0.48])
SHIFT_MM, SIZE, RATIO = 0.25, 0.02, 0.005
SUPPORTS = ("free", "base")


def moved(cause, sign):
    """The mesh with the pit shifted or grown, and its parts (None: unmoved, with another Poisson's ratio)."""
    if cause == POISSON_RATIO:
        return fruit_mesh(), None
    amounts = np.append(SHIFT_MM * SHIFT, 0) if cause == "pit shift" else np.array([0, 0, 0, SIZE])
    mesh = with_pit_moved(fruit_mesh(), sign * amounts)
    return mesh, assemble(mesh.nodes_mm, mesh.tets)


def response(cause, support, sign):
    """The markers' displacement with the pit moved or grown, or with another Poisson's ratio."""
    mesh, parts = moved(cause, sign)
    ratio = NU + sign * RATIO if cause == POISSON_RATIO else NU
    return solved(mesh, parts or fruit_solid(support).parts, support, ratio)


def solved(mesh, parts, support, poisson_ratio):
    """Full solves of the pinch's nodal loads; the skin under the pads is that of the unmoved mesh."""
    of_prior = fruit_solid(support)
    links = [pad_link(pad, of_prior) for pad in pinch().pads]
    nodal = sum(link.nodal_force(pad.force_N) for link, pad in zip(links, pinch().pads, strict=True))
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=poisson_ratio, support=support, parts=parts)
    moved = solid.displacement(all_nodes(nodal, of_prior))[:, of_prior.contact_nodes]
    return np.concatenate([link.at_markers(moved) for link in links], axis=1)


def sensitivity(support):
    model = grasp_model(pinch(), fruit_solid(support))
    columns = dict(zip(model.sensitivity.causes, model.sensitivity.values, strict=True))
    columns["pit shift"] = np.tensordot(SHIFT, [columns[name] for name in PIT[:3]], axes=1)
    return columns


def strained(field, support):
    """A free fruit's field without its best rigid motion; a based one's as it is."""
    if support == "base":
        return field
    place = np.vstack([pad.surface_mm for pad in pinch().pads])
    rigid = rigid_modes(place, centre_mm=place.mean(axis=0)).reshape(-1, 6)
    flat = field.reshape(len(field), -1).T
    return (flat - rigid @ np.linalg.lstsq(rigid, flat, rcond=None)[0]).T.reshape(field.shape)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "step", "support"),
    [
        ("pit shift", SHIFT_MM, "free"),
        pytest.param("pit shift", SHIFT_MM, "base", marks=pytest.mark.proof),
        pytest.param(PIT_SIZE, SIZE, "free", marks=pytest.mark.proof),
        (PIT_SIZE, SIZE, "base"),
        (POISSON_RATIO, RATIO, "free"),
        pytest.param(POISSON_RATIO, RATIO, "base", marks=pytest.mark.proof),
    ],
)
def test_inner_causes_change_the_response_as_a_second_solid_does(cause, step, support):
    """Every load on a base; on a free fruit those that balance (the last one does not)."""
    wanted = (response(cause, support, 1) - response(cause, support, -1)) / (2 * step)
    wanted, column = strained(wanted, support), strained(sensitivity(support)[cause], support)
    off = np.linalg.norm(column - wanted, axis=(1, 2)) / np.linalg.norm(wanted, axis=(1, 2))
    assert off[: 3 if support == "free" else 4].max() < 5e-3


@pytest.mark.parametrize("support", SUPPORTS)
def test_a_pad_that_presses_elsewhere_changes_the_response_as_locating_it_anew_does(support):
    """To the kinks of a coarse skin over a short way; without rigid motion they weigh more."""
    solid, step_mm = fruit_solid(support), 0.1
    force = np.concatenate([pad.force_N for pad in pinch().pads], axis=1)
    left, right = pinch().pads
    across = np.linalg.svd(pad_link(left, solid).place.normal.mean(axis=0)[None])[2][1]
    ends = []
    for sign in (1, -1):
        slid = replace(left, surface_mm=left.surface_mm + sign * step_mm * across)
        ends.append(grasp_model(replace(pinch(), pads=(slid, right)), solid).unit_displacement(force))
    wanted = strained((ends[0] - ends[1]) / (2 * step_mm), support)
    column = strained(sensitivity(support)["left across"], support)
    within = 0.05 if support == "base" else 0.2
    assert np.linalg.norm(column - wanted) < within * np.linalg.norm(wanted)


def test_a_fruit_without_a_pit_has_no_pit_among_its_causes():
    history = pinch()
    whole = replace(fruit_mesh(), pit_nodes=np.zeros(0, dtype=np.int64))
    solid = UnitModulusSolid.factorise(
        whole, poisson_ratio=NU, support="free", contact_nodes=fruit_solid("free").contact_nodes
    )
    causes = grasp_model(history, solid).sensitivity.causes
    assert not set(PIT) & set(causes)
    assert causes[6] == POISSON_RATIO
    assert causes[7:] == ("left across", "left along", "right across", "right along")


@pytest.fixture(params=["free", "base"])
def solid(request):
    return fruit_solid(request.param)


def test_compliance_at_the_contact_is_that_of_full_solves(solid):
    rng = np.random.default_rng(0)
    size = 3 * len(solid.contact_nodes)
    some = np.vstack([np.eye(size)[rng.choice(size, 6, replace=False)], rng.normal(size=(4, size))])
    loads = all_nodes(some.reshape(len(some), -1, 3), solid)
    moved = solid.displacement(loads)[:, solid.contact_nodes].reshape(len(some), -1)
    response = some @ solid.contact_compliance
    assert np.abs(response - moved).max() < 1e-9 * np.abs(moved).max()


def test_nodes_that_a_base_holds_neither_move_nor_push():
    solid = fruit_solid("base")
    held = np.isin(solid.contact_nodes, lowest_nodes(solid.mesh))
    assert held.sum() == 3
    rows = np.repeat(held, 3)
    assert not solid.contact_compliance[rows].any()
    assert not solid.contact_compliance[:, rows].any()
    assert (np.diag(solid.contact_compliance)[~rows] > 0).all()


def linked(solid):
    return [pad_link(pad, solid) for pad in pinch().pads]


def test_the_markers_displacement_is_that_of_a_full_solve_of_their_nodal_loads(solid):
    links = linked(solid)
    nodal = sum(link.nodal_force(pad.force_N) for link, pad in zip(links, pinch().pads, strict=True))
    moved = solid.displacement(all_nodes(nodal, solid))[:, solid.contact_nodes]
    wanted = np.concatenate([link.at_markers(moved) for link in links], axis=1)
    model = grasp_model(pinch(), solid)
    force = np.concatenate([pad.force_N for pad in pinch().pads], axis=1)
    assert np.abs(model.unit_displacement(force) - wanted).max() < 1e-9 * np.abs(wanted).max()
    assert np.abs(model.compliance - model.compliance.T).max() < 1e-12 * np.abs(model.compliance).max()
    assert model.fruit_moves is (solid.support == "free")


def test_nodal_loads_keep_the_markers_force_and_moment():
    solid = fruit_solid("free")
    nodes = solid.mesh.nodes_mm[solid.contact_nodes]
    for link in linked(solid):
        force = np.random.default_rng(1).normal(size=(3, len(link.place.point_mm), 3))
        origin = np.array([5.0, 0, -3])
        wanted = np.einsum("nxk,fnx->fk", rigid_modes(link.place.point_mm, centre_mm=origin), force)
        given = np.einsum("nxk,fnx->fk", rigid_modes(nodes, centre_mm=origin), link.nodal_force(force))
        assert np.abs(given - wanted).max() < 1e-9 * np.abs(wanted).max()


def test_reading_does_the_same_work_as_loading():
    solid = fruit_solid("free")
    rng = np.random.default_rng(3)
    moved = rng.normal(size=(1, len(solid.contact_nodes), 3))
    for link in linked(solid):
        force = rng.normal(size=(1, len(link.place.point_mm), 3))
        assert np.vdot(link.nodal_force(force), moved) == pytest.approx(
            np.vdot(force, link.at_markers(moved))
        )


def test_contact_nodes_are_the_faces_under_the_pads_sorted_and_once():
    nodes = contact_nodes(fruit_mesh(), [pinch(), pinch()])
    np.testing.assert_array_equal(nodes, contact_nodes(fruit_mesh(), [pinch()]))
    assert np.isin(nodes, fruit_mesh().outer_nodes).all()
    assert (np.diff(nodes) > 0).all()
    assert len(contact_nodes(fruit_mesh(), [])) == 0


def smooth_fields(mesh):
    """Two displacement fields that strain the flesh everywhere."""
    x = mesh.nodes_mm / 10
    return np.stack([np.sin(x @ np.diag([1.0, 2, 0.5]) + [0, 1, 2]), np.cos(x[:, [1, 2, 0]]) * x])


def change_of_energy(mesh, velocity):
    """u' (dK/de) v for all pairs of the smooth fields."""
    fields = smooth_fields(mesh)
    return np.einsum("fnx,gnx->fg", fields, stiffness_change(mesh, NU, fields, velocity[None])[0])


@pytest.mark.parametrize("which", ["pit y", "pit size", "wave along x", "wave along z"])
def test_energy_changes_as_on_moved_nodes(which):
    mesh = fruit_mesh()
    velocity = {
        "pit y": pit_velocities(mesh)[1],
        "pit size": pit_velocities(mesh)[3],
        "wave along x": skin_velocities(mesh)[0],
        "wave along z": skin_velocities(mesh)[5],
    }[which]
    step = 1e-3
    flat = smooth_fields(mesh).reshape(2, -1)
    ends = []
    for sign in (1, -1):
        moved = replace(mesh, nodes_mm=mesh.nodes_mm + sign * step * velocity)
        ends.append(flat @ (assemble(moved.nodes_mm, moved.tets).for_unit_modulus(poisson_ratio=NU) @ flat.T))
    wanted = (ends[0] - ends[1]) / (2 * step)
    change = change_of_energy(mesh, velocity)
    assert np.abs(change - wanted).max() < 1e-3 * np.abs(wanted).max()
    assert np.abs(change - change.T).max() < 1e-9 * np.abs(change).max()


def test_work_of_pairs_of_fields_is_that_of_the_changed_forces():
    mesh = fruit_mesh()
    velocities = np.concatenate([pit_velocities(mesh), skin_velocities(mesh)])
    u, v = smooth_fields(mesh), smooth_fields(mesh)[::-1]
    wanted = np.einsum("pfnx,fnx->pf", stiffness_change(mesh, NU, u, velocities), v)
    work_of_pairs = work_of_change(mesh, NU, u, v, velocities)
    np.testing.assert_allclose(work_of_pairs, wanted, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.45])
def test_a_larger_core_stiffens_a_ball_under_pressure_as_lame_says(cored_ball, poisson_ratio):
    """J = p 4 pi b^2 u(b) is the work of pressure p; dJ / d ln a = -U' (dK / d ln a) U."""
    pressure_MPa, radius_mm, core_mm = 0.1, 30.0, 10.0

    def work(ln_size):
        shrunk_mm = cored_sphere_shrinkage_mm(
            E_MPa=1.0,
            poisson_ratio=poisson_ratio,
            core_radius_mm=core_mm * np.exp(ln_size),
            radius_mm=radius_mm,
            pressure_MPa=pressure_MPa,
        )
        return 4 * np.pi * radius_mm**2 * pressure_MPa * shrunk_mm

    points, area_mm2 = skin_quadrature(cored_ball)
    load = points.point_load((-pressure_MPa * area_mm2[:, None] * points.normal)[None])
    solid = UnitModulusSolid.factorise(cored_ball, poisson_ratio=poisson_ratio, support="free")
    moved = solid.displacement(load)
    growth = pit_velocities(cored_ball)[3:]
    rise = -np.vdot(moved, stiffness_change(cored_ball, poisson_ratio, moved, growth))
    assert rise == pytest.approx((work(1e-4) - work(-1e-4)) / 2e-4, rel=0.01)


def test_the_pit_moves_whole_and_the_skin_stays():
    mesh = fruit_mesh()
    velocities = pit_velocities(mesh)
    middle = mesh.nodes_mm[mesh.pit_nodes].mean(axis=0)
    shift = np.broadcast_to(np.eye(3)[:, None], (3, len(mesh.pit_nodes), 3))
    np.testing.assert_allclose(velocities[:3, mesh.pit_nodes], shift)
    np.testing.assert_allclose(velocities[3, mesh.pit_nodes], mesh.nodes_mm[mesh.pit_nodes] - middle)
    assert not velocities[:, mesh.outer_nodes].any()
    assert not skin_velocities(mesh)[:, mesh.pit_nodes].any()


def test_waves_of_a_skin_add_up_to_the_same_spread_everywhere():
    """Six independent amounts of variance sd^2 / 3, as the budget has them."""
    mesh = fruit_mesh()
    waves = skin_velocities(mesh)[:, mesh.outer_nodes]
    np.testing.assert_allclose((waves**2).sum(axis=(0, 2)) / 3, 1.0, rtol=1e-12)


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
    return replace(case_model(case, beyond_small_strain=False)[0], graded=models)


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
