"""A pit in a gap: Lame's shell, the bonded pit under even pressure, and what looseness must do to work."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import coarse_fruit
import numpy as np
import pytest
from fem_shapes import ball
from pinched_case_model import as_case
from plain_model import screened_effects
from scipy.optimize import nnls

from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.mesh.surface_points import skin_quadrature
from fem.mismatch.effects import loose_pit
from fem.mismatch.effects.loose_pit import (
    EFFECT,
    GAPS_MM,
    MOST_FRAMES,
    LooseFlesh,
    at_gap,
    inner_faces,
    loose_flesh,
    loose_response,
)
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import plain_model
from fem.mismatch.selection.screening import LinearFit
from fem.mismatch.signature_variant import ONE_WAY
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.unilateral_contact import pressures
from samples.brick_flesh import HOLDING_N_PER_MM, flesh_of
from samples.hexahedra import Fineness, flesh_bricks, lagrange
from samples.mismatch.other_bodies import THREADS_N_PER_MM, loose_compliance, pit_contact
from samples.mismatch.skin_compliance import skin_compliance

NU = 0.45
INNER_MM, OUTER_MM = 10.0, 30.0
PRESSURE_MPA = 0.1
COMPLIANCE = 3.0


def lame(radius_mm: float, inside_MPa: float) -> float:
    """Radial displacement (E = 1) of a shell under PRESSURE_MPA from outside; Timoshenko and Goodier, 136."""
    a, b = INNER_MM**3, OUTER_MM**3
    stretch = (inside_MPa * a - PRESSURE_MPA * b) * (1 - 2 * NU)
    shear = (1 + NU) * a * b / (2 * radius_mm**3) * (inside_MPa - PRESSURE_MPA)
    return radius_mm * (stretch + shear) / (b - a)


def inside_pressure(gap: float) -> float:
    """At which the inner surface stops at the pit."""
    free, slope = lame(INNER_MM, 0.0), lame(INNER_MM, 1.0) - lame(INNER_MM, 0.0)
    return max((-gap - free) / slope, 0.0)


@pytest.fixture(scope="module")
def shell(cored_ball: FleshMesh) -> tuple[UnitModulusSolid, LooseFlesh, np.ndarray]:
    """Bonded and loose, and the load of an even pressure from outside."""
    nodes = np.sort(cored_ball.outer_nodes)
    bonded = UnitModulusSolid.factorise(cored_ball, poisson_ratio=NU, support="free", contact_nodes=nodes)
    points, area = skin_quadrature(cored_ball)
    push = -PRESSURE_MPA * area[:, None] * points.normal
    load = np.zeros((1, *cored_ball.nodes_mm.shape))
    load[0, nodes] = points.among(nodes).interpolation.T @ push
    return bonded, LooseFlesh.of(bonded), load


def pressed(
    flesh: LooseFlesh, load: np.ndarray, gap: float, *, pit_turns: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Pressures on the patches, and displacement of the skin."""
    moved = flesh.solid.displacement(load)
    opening = (flesh.load.T @ moved.reshape(1, -1).T).T + gap * flesh.area_mm2
    contact_pressure = pressures(flesh.compliance(pit_turns=pit_turns), opening)
    return contact_pressure[0], moved[0, flesh.solid.contact_nodes] + np.tensordot(
        contact_pressure[0], flesh.skin, axes=1
    )


def radial(flesh: LooseFlesh, moved: np.ndarray) -> float:
    """Mean over the skin's nodes."""
    x = flesh.solid.mesh.nodes_mm[flesh.solid.contact_nodes]
    return float(np.mean((moved * x).sum(axis=1) / np.linalg.norm(x, axis=1)))


@pytest.mark.parametrize("closed", [0.25, 0.5, 0.9])
def test_a_shell_closes_its_gap_as_lame_says(shell, closed):
    _, flesh, load = shell
    gap = -closed * lame(INNER_MM, 0.0)
    pressure, moved = pressed(flesh, load, gap)
    expected = inside_pressure(gap)
    mean = pressure @ flesh.area_mm2 / flesh.area_mm2.sum()
    assert mean == pytest.approx(expected, rel=0.02, abs=0.01 * PRESSURE_MPA)
    assert radial(flesh, moved) == pytest.approx(lame(OUTER_MM, expected), rel=0.01)


def test_a_gap_too_wide_to_close_is_an_empty_cavity(shell):
    _, flesh, load = shell
    pressure, moved = pressed(flesh, load, -1.2 * lame(INNER_MM, 0.0))
    assert (pressure == 0).all()
    assert radial(flesh, moved) == pytest.approx(lame(OUTER_MM, 0.0), rel=0.01)


def test_without_a_gap_even_pressure_cannot_tell_loose_from_bonded(shell):
    bonded, flesh, load = shell
    moved = pressed(flesh, load, 0.0)[1]
    held = bonded.displacement(load)[0, bonded.contact_nodes]
    assert moved == pytest.approx(held, abs=0.01 * np.abs(held).max())


ASKEW = np.array([0.6, 0.55, 0.58]) / np.linalg.norm([0.6, 0.55, 0.58])
LOADED_COS, GAP = np.cos(np.radians(16)), 0.02


def pinch_at(points_mm: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Pressure, MPa, on a ball's skin, at both ends of an axis."""
    cos = np.abs(points_mm @ axis) / np.linalg.norm(points_mm, axis=1)
    return PRESSURE_MPA * np.clip((cos - LOADED_COS) / (1 - LOADED_COS), 0, None)


def flesh_about(pit_semi_axes_mm: tuple[float, float, float]) -> tuple[UnitModulusSolid, LooseFlesh]:
    """Bonded and loose flesh of a ball."""
    mesh = tetrahedralise(
        *ball(4000, semi_axes_mm=(26, 26, 26)), *ball(3000, semi_axes_mm=pit_semi_axes_mm), edge_mm=7.0
    )
    nodes = np.sort(mesh.outer_nodes)
    bonded = UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="free", contact_nodes=nodes)
    return bonded, LooseFlesh.of(bonded)


def softer(flesh: tuple[UnitModulusSolid, LooseFlesh], axis: np.ndarray, *, pit_turns: bool) -> float:
    """Work of a pinch along the axis, of what it does about a bonded pit."""
    bonded, loose = flesh
    nodes = bonded.contact_nodes
    points, area = skin_quadrature(bonded.mesh)
    push = -(pinch_at(points.point_mm, axis) * area)[:, None] * points.normal
    load = np.zeros((1, *bonded.mesh.nodes_mm.shape))
    load[0, nodes] = points.among(nodes).interpolation.T @ push
    moved = pressed(loose, load, GAP, pit_turns=pit_turns)[1]
    return float((moved * load[0, nodes]).sum() / (bonded.displacement(load) * load).sum())


def test_a_pit_that_is_almost_round_gives_way_as_much_pressed_askew():
    flesh = flesh_about((10.0, 9.8, 9.9))
    straight, *askew = (
        softer(flesh, axis, pit_turns=turns)
        for axis, turns in ((np.eye(3)[0], True), (ASKEW, True), (ASKEW, False))
    )
    assert straight == pytest.approx(1.1, abs=0.03)
    assert askew == pytest.approx([straight, straight], abs=0.01)


def softer_bricks(pit_semi_axes_mm: np.ndarray, axis: np.ndarray) -> float:
    """The same by hexahedra about a pit that is free to turn, its contact node by node."""

    class Ellipsoid:
        def __init__(self, semi_axes_mm: np.ndarray) -> None:
            self.semi_axes_mm = semi_axes_mm

        def points_mm(self, directions: np.ndarray) -> np.ndarray:
            return directions / np.linalg.norm(directions / self.semi_axes_mm, axis=1, keepdims=True)

    fruit = SimpleNamespace(skin=Ellipsoid(np.full(3, 26.0)), pit=Ellipsoid(pit_semi_axes_mm))
    bricks = flesh_bricks(
        fruit, axis, Fineness(degrees=(0, 5, 10, 15, 28, 45), along=2, depths=(0, 0.15, 0.5, 1))
    )
    flesh = flesh_of(bricks, E_MPa=1.0, poisson_ratio=NU)
    cells = bricks.nodes_mm[bricks.skin_cells.reshape(-1, 3, 3)]
    value, slope = lagrange(np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)]))
    weight = np.array([5, 8, 5]) / 9
    x = np.einsum("ia,jb,kabx->kijx", value, value, cells)
    across = np.einsum("ia,jb,kabx->kijx", slope, value, cells)
    along = np.einsum("ia,jb,kabx->kijx", value, slope, cells)
    area = np.linalg.norm(np.cross(across, along), axis=-1) * np.outer(weight, weight)
    inward = -x / np.linalg.norm(x, axis=-1, keepdims=True)
    push = (pinch_at(x.reshape(-1, 3), axis).reshape(area.shape) * area)[..., None] * inward
    load = np.zeros_like(bricks.nodes_mm)
    np.add.at(load, bricks.skin_cells.reshape(-1, 3, 3), np.einsum("ia,jb,kijx->kabx", value, value, push))
    unknown = np.concatenate([load[flesh.free_nodes].ravel(), np.zeros(6)])
    chosen = np.flatnonzero(unknown)
    force, skin = unknown[chosen], slice(0, len(chosen))
    compliance, inner = loose_compliance(flesh, chosen).dense(), pit_contact(flesh, gap_mm=GAP)
    pit = slice(len(chosen), None)
    opening = compliance[pit, skin] @ force + GAP
    pushed = pressures(compliance[pit, pit] + np.diag(1 / inner.N_per_mm), opening[None])[0]
    loose = force @ (compliance[skin, skin] @ force + compliance[skin, pit] @ pushed)
    return float(loose / (force @ skin_compliance(flesh.stiffness, chosen).dense() @ force))


def test_an_oblong_pit_pressed_askew_turns_as_bricks_have_it_and_gives_way_more_than_one_that_is_held(
    monkeypatch,
):
    semi_axes = (12.0, 9.0, 15.0)
    radius = np.mean(semi_axes)
    spring = 400 * HOLDING_N_PER_MM + THREADS_N_PER_MM * 2 / 3 * radius**2  # of the bricks' pit, N mm per rad
    monkeypatch.setattr(loose_pit, "TURNING_SHARE", spring / radius**3)
    flesh = flesh_about(semi_axes)
    turned, held = (softer(flesh, ASKEW, pit_turns=turns) for turns in (True, False))
    assert turned - 1 == pytest.approx(softer_bricks(np.array(semi_axes), ASKEW) - 1, rel=0.1)
    assert turned - 1 > 2 * (held - 1)


def test_the_patches_cover_the_pit(shell, cored_ball):
    _, flesh, _ = shell
    assert flesh.area_mm2.sum() == pytest.approx(4 * np.pi * INNER_MM**2, rel=0.01)
    assert len(inner_faces(cored_ball)) > 50
    through = np.asarray(flesh.load.sum(axis=1)).reshape(-1, 3).sum(axis=0)
    assert np.abs(through).max() < 1e-9 * flesh.area_mm2.sum()


def test_the_contact_problem_agrees_with_least_squares_under_bounds():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(60, 60))
    compliance = root @ root.T + np.eye(60)
    opening = rng.normal(size=(5, 60))
    contact_pressures = pressures(compliance, opening)
    lower = np.linalg.cholesky(compliance)
    for pressure, q in zip(contact_pressures, opening, strict=True):
        assert pressure == pytest.approx(nnls(lower.T, -np.linalg.solve(lower, q))[0], abs=1e-9)
        assert ((compliance @ pressure + q) > -1e-9).all()


def grounded(history: GraspHistory) -> CaseModel:
    """The coarse fruit under a recording of the pinch."""
    return CaseModel(base=plain_model(as_case(history)), compliance=COMPLIANCE)


@cache
def pinched() -> CaseModel:
    """Nothing but forces."""
    return grounded(coarse_fruit.pinch())


def moved_by(unit: np.ndarray) -> CaseModel:
    """A recording in which the markers have moved so, times 1/E, in the frames that a model is fitted to."""
    history = coarse_fruit.pinch()
    split = np.cumsum([len(pad.rest_mm) for pad in history.pads])[:-1]
    whole = np.zeros((len(history.time_s), *unit.shape[1:]))
    whole[pinched().grasps[0].used] = COMPLIANCE * unit
    pads = tuple(
        replace(pad, position_mm=pad.position_mm + shift_mm)
        for pad, shift_mm in zip(history.pads, np.split(whole, split, axis=1), strict=True)
    )
    return grounded(replace(history, pads=pads))


def work(model: CaseModel, unit: np.ndarray) -> float:
    """Of the forces of the second frame, a symmetric pinch."""
    recording = model.grasps[0]
    return float((recording.over_time(recording.patterns)[1] * unit[1]).sum())


def test_the_looser_the_pit_the_more_the_pinch_works():
    model = pinched()
    recording = model.grasps[0]
    gaps = [0.0, 0.01, 0.02, 0.05, 10.0]
    done = [work(model, loose_response(model, recording, gap, pit_turns=True)) for gap in gaps]
    assert work(model, recording.tracks.unit_displacement) < done[0]
    assert (np.diff(done) > -1e-12).all()
    assert done[-1] > 1.02 * done[0]


@pytest.mark.parametrize("turns", [True, False])
def test_the_pit_is_in_equilibrium_and_pulls_at_nothing(turns):
    model = pinched()
    recording = model.grasps[0]
    flesh = loose_flesh(model, recording)
    opening = recording.shares @ flesh.marker_response(recording)[1]
    pressure = pressures(flesh.compliance(pit_turns=turns), opening)[1]
    assert pressure.min() >= 0
    assert pressure.max() > 0
    total = np.asarray(flesh.load @ pressure).reshape(-1, 3).sum(axis=0)
    assert np.linalg.norm(total) < 1e-3 * float(pressure @ flesh.area_mm2)


def test_between_the_frames_solved_for_contact_follows_the_load_not_the_clock():
    model, gap = pinched(), 0.002
    recording = model.grasps[0]
    rise = [np.linspace(0, 0.5, 10), np.linspace(0.5, 0.52, 60), np.linspace(0.52, 1, 4)]
    load = np.concatenate([*rise, np.ones(9), np.linspace(1, 0.9, 40), np.linspace(0.9, 0, 4), np.zeros(3)])
    shares = load[:, None] * recording.shares[1]
    of_finer_mesh = 1e-3 * load[:, None, None] * np.ones_like(recording.response[:1])
    unit = np.tensordot(shares, recording.response, axes=1) + of_finer_mesh
    tracks, first = recording.tracks, np.zeros(len(load), dtype=np.int64)
    held = replace(
        recording,
        tracks=replace(
            tracks,
            position_mm=tracks.position_mm[first],
            unit_displacement=unit,
            gel_displacement_mm=tracks.gel_displacement_mm[first],
            episode=tracks.episode[first],
        ),
        shares=shares,
        force_N=load[:, None, None] * recording.force_N[1],
        pose=np.repeat(recording.pose[:, 1:2], len(load), axis=1),
        load=load,
    )
    response = loose_response(model, held, gap, pit_turns=True)
    flesh = loose_flesh(model, recording)
    free, opening, pushed = flesh.marker_response(recording)
    each = pressures(flesh.compliance(pit_turns=True), held.shares @ opening + gap * flesh.area_mm2)
    assert (each.max(axis=1) > 0).sum() > MOST_FRAMES
    exact = held.over_time(free) + of_finer_mesh + np.tensordot(each, pushed, axes=1)
    assert response == pytest.approx(exact, abs=1e-3 * np.abs(exact).max())


def test_a_loose_pit_shows_as_its_own_model_less_the_bonded_answer():
    unit = EFFECT.respond(pinched(), {"gap_mm": GAPS_MM[0]}, at_gap(GAPS_MM[0], pit_turns=True)).unit[0]
    model = moved_by(unit)
    recording = model.grasps[0]
    first = EFFECT.signatures(model)[0]
    assert EFFECT.start(model, first, np.ones(1)) == {"gap_mm": GAPS_MM[0]}
    softer = moved_by(1.2 * unit)
    start = EFFECT.start(softer, EFFECT.signatures(softer)[0], np.ones(1))
    assert start["gap_mm"] == pytest.approx(1.2 * GAPS_MM[0], rel=5e-3)
    field = first.columns[0].fields[0].markers
    expected = COMPLIANCE * (unit - recording.tracks.unit_displacement)
    assert field == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def best_loose(model: CaseModel) -> LinearFit:
    """The markers have moved as the same mesh says."""
    return screened_effects(model, [EFFECT]).best[0]


def test_a_bonded_pit_shows_no_looseness():
    best = best_loose(moved_by(pinched().grasps[0].tracks.unit_displacement))
    assert best.gain <= 0
    assert best.amounts == pytest.approx([0], abs=0.05)


@pytest.mark.parametrize("turns", [True, False])
def test_of_a_gap_alone_the_way_that_fits_is_taken(turns):
    gap = {"gap_mm": 0.002 * COMPLIANCE}  # the pinch closes it
    true_way, other = (at_gap(gap["gap_mm"], pit_turns=pit_turns) for pit_turns in (turns, not turns))
    bare = pinched()
    model = moved_by(loose_response(bare, bare.grasps[0], 0.002, pit_turns=turns))
    ways = [EFFECT.respond(model, gap, way).unit[0] for way in (true_way, other)]
    response = EFFECT.respond(model, gap, ONE_WAY).unit[0]
    assert np.abs(ways[0] - ways[1]).max() > 1e-3 * np.abs(ways[0]).max()
    np.testing.assert_array_equal(response, ways[0])
