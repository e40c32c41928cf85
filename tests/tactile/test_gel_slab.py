"""How a gel's face gives way, its fields, and forces from displacement: closed forms and finite elements."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from periodic_slab import traction_response
from scipy.sparse.linalg import splu
from skfem import Basis, BilinearForm, ElementHex2, ElementVector, FacetBasis, LinearForm, MeshHex
from skfem.helpers import ddot, eye, sym_grad, trace
from turned_camera import turned_camera

from samples.gel_images import seen_at
from samples.gel_press import GelBlock, gel_block
from tactile.gel.fields import GelFields, fields_of, frame_noise, slab_of
from tactile.gel.force_inverse import DRAGGED, InvertedForce, most_likely_hyperparameters, one_way_share
from tactile.gel.gel_sides import GelOutline, side_response
from tactile.gel.grid import GelGrid, PriorHyperparameters, gel_grid
from tactile.gel.normal_equations import NormalEquations
from tactile.gel.slab import GelSlab, tent_compliance
from tactile.markers.tracking import TrackedMarkers
from tactile.sensors import GelCamera, Sensor, marker_grid
from tactile.tactile_failure import TactileFailure

SOFT = GelSlab(thickness_mm=4.0, E_MPa=0.2, nu=0.48)


def test_even_pressure_meets_the_oedometric_modulus_and_even_shear_the_shear_modulus() -> None:
    moved = traction_response(SOFT, np.broadcast_to([0.01, 0.02, -0.05], (8, 8, 3)), spacing_mm=1.0)
    mu = 0.2 / (2 * 1.48)
    oedometric = 0.2 * 0.52 / (1.48 * 0.04)
    expected = [0.01 * 4 / mu, 0.02 * 4 / mu, -0.05 * 4 / oedometric]
    np.testing.assert_allclose(moved, np.broadcast_to(expected, moved.shape), rtol=1e-6)


@pytest.mark.parametrize("nu", [0.2, 0.35, 0.499])
def test_a_thick_slab_is_the_half_space_of_boussinesq_and_cerruti(nu: float) -> None:
    """The transforms of 1/r and of its gradients: with k h of 40 to 2e6 the back is out of reach."""
    E, k = 0.3, np.array([2.0, 5.0, 1e5])
    spectrum = GelSlab(thickness_mm=20.0, E_MPa=E, nu=nu).spectrum(k) * k[:, None]
    boussinesq, drawn = 2 * (1 - nu**2) / E, (1 + nu) * (1 - 2 * nu) / E
    across = 2 * (1 + nu) / E
    np.testing.assert_allclose(spectrum, np.tile([boussinesq, drawn, boussinesq, across], (3, 1)), rtol=1e-7)


def test_one_tents_table_is_what_the_grid_of_wave_vectors_gives() -> None:
    """All nine components at points off every axis, through the complex transforms of the whole plane."""
    slab, pitch, fine = GelSlab(thickness_mm=1.5, E_MPa=0.3, nu=0.46), 0.8, 0.1
    tent = np.maximum(1 - np.abs(fine * np.arange(-200, 200)) / pitch, 0) / pitch
    at = np.array([[0.3, 1.1], [-0.7, 0.4], [1.9, -0.2], [-1.2, -2.3]])
    C = tent_compliance(slab, at, np.zeros((1, 2)), pitch_mm=pitch)
    rows, columns = (np.rint(at / fine).astype(int) + 200).T
    for force in range(3):
        traction = np.zeros((400, 400, 3))
        traction[..., force] = tent[:, None] * tent
        moved = traction_response(slab, traction, spacing_mm=fine)
        np.testing.assert_allclose(C[:, :, 0, force], moved[rows, columns], atol=2e-4 * np.abs(C).max())


E_MPA, NU, THICKNESS_MM, PITCH_MM = 0.2, 0.45, 3.0, 1.0
SIZE_MM = (12.0, 9.0)
AT_MM = np.array([[-3.0, 0.0], [-5.0, 3.5], [5.5, 0.0], [0.0, -4.0], [4.5, 4.0], [-2.0, -4.4]])
UNDER_LOAD_MM = np.array([[1.5, 0.5]])
LOADED_MM = np.array([[1.0, 0.0], [2.0, 0.0], [1.0, 1.0], [2.0, 1.0]])


DOME = (40.0, 30.0)
"""Radii of a face that falls by 0.45 and 0.34 mm to the sides: a quarter of the thickness in the corners."""


@lru_cache
def by_elements(*, bonded: bool, domed: bool = False) -> dict[int, np.ndarray]:
    """Displacement (mm) at AT_MM and UNDER_LOAD_MM under a newton on each tent, by the axis it acts along.

    A domed gel's bricks are straight (the face is bilinear between nodes 0.5 mm apart).
    """
    per_mm = 2 if domed else 1
    x, y = (np.linspace(-size / 2, size / 2, per_mm * round(size) + 1) for size in SIZE_MM)
    mesh = MeshHex.init_tensor(x, y, np.linspace(-THICKNESS_MM, 0, 4))

    def face_mm(place):
        return -sum(place[k] ** 2 / (2 * DOME[k]) for k in (0, 1)) if domed else 0.0 * place[0]

    flat = mesh.p
    lifted = flat[2] + face_mm(flat) * (flat[2] + THICKNESS_MM) / THICKNESS_MM
    mesh = MeshHex(np.vstack([flat[:2], lifted]), mesh.t)
    element = ElementVector(ElementHex2())
    basis = Basis(mesh, element, intorder=4)
    lame, mu = E_MPA * NU / ((1 + NU) * (1 - 2 * NU)), E_MPA / (2 * (1 + NU))

    @BilinearForm
    def stiffness(u, v, _):
        strain = sym_grad(u)
        return ddot(lame * eye(trace(strain), 3) + 2 * mu * strain, sym_grad(v))

    def load(way: int) -> np.ndarray:
        @LinearForm
        def tents(v, w):
            along = [
                np.maximum(1 - np.abs(w.x[k] - LOADED_MM[:, k, None, None]) / PITCH_MM, 0) for k in (0, 1)
            ]
            return (along[0] * along[1]).sum(axis=0) / PITCH_MM**2 * v[way]

        return np.asarray(tents.assemble(top))

    on_top = mesh.facets_satisfying(lambda p: p[2] > face_mm(p) - 0.02, boundaries_only=True)
    top = FacetBasis(mesh, element, facets=on_top, intorder=12)
    held = basis.get_dofs(lambda p: p[2] < -THICKNESS_MM + 1e-9).all()
    if bonded:
        at_side = lambda p: (np.abs(p[0]) > SIZE_MM[0] / 2 - 1e-9) | (np.abs(p[1]) > SIZE_MM[1] / 2 - 1e-9)  # noqa: E731
        held = np.union1d(held, basis.get_dofs(at_side).all())
    free = basis.complement_dofs(held)
    stiff = stiffness.assemble(basis).tocsr()[free][:, free].tocsc()
    solver = splu(stiff, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    at = np.vstack([AT_MM, UNDER_LOAD_MM])
    points = np.vstack([at.T, face_mm(at.T) - (0.02 if domed else 1e-9)])
    read = basis.probes(points).tocsr()[:, free]
    return {way: (read @ solver.solve(load(way)[free])).reshape(3, -1).T for way in (0, 2)}


@pytest.mark.parametrize(
    ("outline", "simpler", "most"),
    [
        (GelOutline(SIZE_MM), None, 0.01),
        (GelOutline(SIZE_MM, sides="bonded"), None, 0.01),
        pytest.param(
            GelOutline(SIZE_MM, face_radius_mm=DOME), GelOutline(SIZE_MM), 0.004, marks=pytest.mark.proof
        ),
    ],
    ids=["free", "bonded", "domed"],
)
@pytest.mark.parametrize("way", [0, 2])
def test_a_gel_with_sides_moves_as_another_librarys_elements_say(
    way: int, outline: GelOutline, simpler: GelOutline | None, most: float
) -> None:
    *truth, under_load = by_elements(bonded=outline.sides == "bonded", domed=outline.domed)[way]
    misses = []
    for described in (outline, simpler):
        slab = GelSlab(thickness_mm=THICKNESS_MM, E_MPa=E_MPA, nu=NU, outline=described)
        response = tent_compliance(slab, AT_MM, LOADED_MM, pitch_mm=PITCH_MM)[..., way].sum(axis=2)
        misses.append(np.abs(response - truth).max() / np.abs(under_load).max())
    assert misses[0] < most
    assert misses[1] > 5 * misses[0]


def test_far_sides_change_nothing() -> None:
    wide = side_response(THICKNESS_MM, NU, GelOutline((40.0, 40.0)))
    change = wide.between(np.zeros((1, 2)), np.zeros((1, 2)), pitch_mm=1.0) / E_MPA
    slab = GelSlab(thickness_mm=THICKNESS_MM, E_MPa=E_MPA, nu=NU)
    compliance = tent_compliance(slab, np.zeros((1, 2)), np.zeros((1, 2)), pitch_mm=1.0)
    assert np.abs(change).max() < 1e-3 * np.abs(compliance).max()


REST = marker_grid(11, 13, pitch_mm=(1.0, 1.0), first_mm=None)
DEPTHS = np.concatenate([np.zeros(6), np.linspace(0.05, 0.6, 8)])

SENSOR = Sensor(
    kind="markers-stereo",
    name="stereo gel",
    camera=turned_camera(0.35),
    second_camera=turned_camera(-0.35),
    thickness_mm=4.0,
    E_MPa=0.2,
    nu=0.48,
)


def motion(depth_mm: float) -> np.ndarray:
    """A face pressed by a paraboloid and dragged along x."""
    r = np.minimum(np.linalg.norm(REST[:, :2], axis=1) / 3.6, 1.0)
    return np.outer(1 - r**2, [0.3 * depth_mm, 0.0, -depth_mm])


def tracked(camera: GelCamera, seed: int) -> TrackedMarkers:
    rng = np.random.default_rng(seed)
    pixels = np.stack([seen_at(camera, REST + motion(d)) for d in DEPTHS])
    return TrackedMarkers(
        time_s=np.arange(len(DEPTHS)) / 30,
        reference_px=seen_at(camera, REST),
        position_px=pixels + rng.normal(scale=0.03, size=pixels.shape),
        rest_mm=REST,
    )


@pytest.fixture(scope="module")
def fields() -> GelFields:
    return fields_of(SENSOR, tracked(turned_camera(0.35), 1), second=tracked(turned_camera(-0.35), 2))


def test_displacement_is_seen_to_micrometres(fields: GelFields) -> None:
    truth = np.stack([motion(d) for d in DEPTHS])
    error = fields.displacement_mm - truth
    assert np.sqrt((error[..., :2] ** 2).mean()) < 0.002
    assert np.sqrt((error[..., 2] ** 2).mean()) < 0.005


def test_the_air_has_noise_and_no_force(fields: GelFields) -> None:
    air = DEPTHS == 0
    assert 0 < fields.displacement_mm[air].std() < 0.005
    assert not fields.force_N[air].any()
    assert not fields.touching[air].any()


def test_a_press_pushes_back_along_both_axes(fields: GelFields) -> None:
    total = fields.force_N[-1].sum(axis=0)
    assert total[2] > 0
    assert total[0] < 0
    assert abs(total[1]) < 0.05 * total[2]


def test_a_dome_is_refused_with_what_to_do() -> None:
    dome = replace(
        tracked(turned_camera(0.0), 1), rest_mm=REST - np.outer((REST**2).sum(axis=1), [0, 0, 0.03])
    )
    mono = replace(SENSOR, kind="markers-mono", camera=turned_camera(0.0), second_camera=None)
    with pytest.raises(TactileFailure, match=r"stereo gel: its gel is a dome .*Give face_radius_mm"):
        fields_of(mono, dome)


def test_markers_beyond_the_gels_outline_are_refused() -> None:
    outline = GelOutline((2.6, 2.2))
    mono = replace(
        SENSOR, kind="markers-mono", camera=turned_camera(0.0), second_camera=None, outline=outline
    )
    with pytest.raises(TactileFailure, match=r"markers outside the gel .* size_mm \[2.6, 2.2\]"):
        fields_of(mono, tracked(turned_camera(0.0), 1))


def test_stereo_without_the_second_camera_is_refused() -> None:
    with pytest.raises(TactileFailure, match="the second camera's markers are missing"):
        fields_of(SENSOR, tracked(turned_camera(0.35), 1))


def test_a_gel_without_its_law_is_refused() -> None:
    assert slab_of(SENSOR) == GelSlab(thickness_mm=4.0, E_MPa=0.2, nu=0.48)
    with pytest.raises(TactileFailure, match=r"forces need the gel: .* nu None, expected all three"):
        slab_of(replace(SENSOR, nu=None))


def test_noise_is_told_from_motion() -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0, 1, 60)[:, None, None]
    moving = np.concatenate([np.zeros((20, 1, 1)), 5 * t**2]) * np.ones((1, 200, 2))
    noisy = moving + rng.normal(scale=0.03, size=moving.shape)
    assert frame_noise(noisy) == pytest.approx(0.03, rel=0.1)


SLAB = GelSlab(thickness_mm=2.0, E_MPa=0.2, nu=0.45)
MARKERS = marker_grid(13, 13, pitch_mm=(0.6, 0.6), first_mm=None)
NOISE_MM = np.array([0.001, 0.001, 0.004])
INFORMATION = np.tile(np.diag(1 / NOISE_MM**2), (len(MARKERS), 1, 1))
HYPERPARAMETERS = PriorHyperparameters(pressure_MPa=0.04, shear_MPa=0.01, roughness=1.0, noise=1.0)
SIDES = (-8, -5, -3.4, -2.4, -1.6, -0.8, 0, 0.8, 1.6, 2.4, 3.4, 5, 8)


@pytest.fixture(scope="module")
def block() -> GelBlock:
    return gel_block(
        thickness_mm=2.0, E_MPa=0.2, nu=0.45, reach_mm=1.9, x_mm=SIDES, y_mm=SIDES, depths=(0, 0.25, 0.6, 1)
    )


@pytest.fixture(scope="module")
def grid() -> GelGrid:
    return gel_grid(SLAB, MARKERS)


@pytest.fixture(scope="module")
def solver(grid: GelGrid) -> InvertedForce:
    return InvertedForce(grid, INFORMATION, HYPERPARAMETERS)


def bump(at_mm: np.ndarray) -> np.ndarray:
    """Traction on the fruit, MPa: pressure and shear within 1.9 mm."""
    r = np.minimum(np.linalg.norm(at_mm, axis=1) / 1.9, 1.0)
    return np.outer((1 - r**2) ** 1.5, [0.012, -0.006, 0.05])


def elements_say(block: GelBlock) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacement and force at the markers, and the sum of forces, by finite elements."""
    nodal = bump(block.face_mm) * block.weights_mm2[:, None]
    moved = (block.compliance @ -nodal[block.reach].ravel()).reshape(-1, 3)
    return block.at(moved, MARKERS[:, :2]), bump(MARKERS[:, :2]) * 0.36, nodal.sum(axis=0)


def noise(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=MARKERS.shape) * NOISE_MM


def test_forces_are_recovered_from_finite_elements_and_noise(block: GelBlock, grid: GelGrid) -> None:
    displacement, force, total = elements_say(block)
    seen = displacement + noise(np.random.default_rng(1))
    hyperparameters = most_likely_hyperparameters(grid, INFORMATION, [seen])
    contact = InvertedForce(grid, INFORMATION, hyperparameters).solve(seen)
    assert np.linalg.norm(contact.force_N.sum(axis=0) - total) < 0.03 * np.linalg.norm(total)
    assert np.corrcoef(contact.force_N.ravel(), force.ravel())[0, 1] > 0.97
    outside = np.linalg.norm(MARKERS[:, :2], axis=1) > 2.7
    assert np.abs(contact.force_N[outside]).max() < 0.03 * force.max()


def test_without_depth_the_force_is_still_told(block: GelBlock, grid: GelGrid) -> None:
    displacement, _, total = elements_say(block)
    flat = INFORMATION.copy()
    flat[:, 2, 2] = 0.0
    seen = displacement + noise(np.random.default_rng(1))
    seen[:, 2] = 0.0
    hyperparameters = PriorHyperparameters(pressure_MPa=0.06, shear_MPa=0.02, roughness=2.0, noise=4.0)
    contact = InvertedForce(grid, flat, hyperparameters).solve(seen)
    assert contact.force_N.sum(axis=0)[2] == pytest.approx(total[2], rel=0.2)


def test_a_gel_that_touches_nothing_has_no_force(solver: InvertedForce) -> None:
    rng = np.random.default_rng(2)
    assert not any(solver.solve(noise(rng)).touching.any() for _ in range(200))


def test_a_lost_marker_says_as_little_as_one_that_knows_nothing(block: GelBlock, grid: GelGrid) -> None:
    """Half of the markers gone, in the press too: as if their information had been zero from the start."""
    displacement, _, total = elements_say(block)
    solver = InvertedForce(grid, INFORMATION, HYPERPARAMETERS)
    for seed, share in enumerate((0.1, 0.3, 0.5)):
        rng = np.random.default_rng(seed)
        seen = displacement + noise(rng)
        lost = rng.random(len(MARKERS)) < share
        known = INFORMATION.copy()
        known[lost] = 0.0
        expected = InvertedForce(grid, known, HYPERPARAMETERS).active_set(np.where(lost[:, None], 0.0, seen))
        active_set = solver.active_set(np.where(lost[:, None], np.nan, seen))
        assert (active_set.touching == expected.touching).all()
        np.testing.assert_allclose(active_set.unknowns, expected.unknowns, atol=1e-7)
        force = solver.solve(np.where(lost[:, None], np.nan, seen)).force_N.sum(axis=0)
        assert np.linalg.norm(force - total) < 0.06 * np.linalg.norm(total)


def test_inside_nothing_pulls_and_outside_nothing_wants_to_push(
    block: GelBlock, solver: InvertedForce
) -> None:
    """Complementarity, before anything could hide that the contact did not settle."""
    displacement, _, _ = elements_say(block)
    rng = np.random.default_rng(9)
    for scale in (0.05, 0.1, 0.3, 0.5, 1.0, 2.0):
        for lost in (0.0, 0.3):
            seen = scale * displacement + 3 * noise(rng)
            seen[rng.random(len(seen)) < lost] = np.nan
            active_set = solver.active_set(seen)
            pressure = active_set.unknowns[2 : 3 * len(active_set.touching) : 3]
            assert pressure.min() >= 0
            assert (pressure[~active_set.touching] == 0).all()
            assert active_set.push_sd.max() < 6


def test_markers_get_the_nodes_sum_and_moment() -> None:
    rng = np.random.default_rng(8)
    scattered = MARKERS + np.column_stack(
        [rng.uniform(-0.15, 0.15, (len(MARKERS), 2)), np.zeros(len(MARKERS))]
    )
    grid = gel_grid(SLAB, scattered)
    nodal = rng.normal(size=(len(grid.nodes_mm), 3))
    given = grid.to_markers @ nodal
    np.testing.assert_allclose(given.sum(axis=0), nodal.sum(axis=0), atol=1e-9)
    np.testing.assert_allclose(scattered[:, :2].T @ given, grid.nodes_mm.T @ nodal, atol=1e-9)


def test_too_few_markers_are_refused() -> None:
    with pytest.raises(ValueError, match="nine markers; there are 4"):
        gel_grid(SLAB, MARKERS[:4])


def test_a_contact_that_drags_more_than_it_presses_is_not_taken_for_noise() -> None:
    """Dots alone 2 mm apart, dragged by 1.4 mm under a patch smaller than their pitch."""
    slab = GelSlab(thickness_mm=4.0, E_MPa=0.3, nu=0.48)
    markers = marker_grid(6, 8, pitch_mm=(2.0, 2.0), first_mm=None)
    line = 0.9 * np.arange(16)
    nodes = np.stack(np.meshgrid(line - 6.75, line[:12] - 4.95), axis=-1).reshape(-1, 2)
    touched = np.linalg.norm((nodes - [-1.0, 5.1]) / [1.0, 1.3], axis=1) < 1.7
    force = np.outer(touched, [-0.2, -0.98, 0.3])
    compliance = -tent_compliance(slab, markers[:, :2], nodes, pitch_mm=0.9)
    moved = np.tensordot(compliance, force, axes=2)
    scale = 1.4 / np.abs(moved).max()
    rng = np.random.default_rng(19)
    frames = [part * scale * moved + 0.002 * rng.normal(size=moved.shape) for part in (1.0, 0.8, 0.6)]
    for frame in frames:
        frame[:, 2] = 0.0
    information = np.tile(np.diag([1 / 0.0027**2, 1 / 0.0027**2, 0.0]), (len(markers), 1, 1))
    grid = gel_grid(slab, markers)
    hyperparameters = most_likely_hyperparameters(grid, information, frames)
    contact = InvertedForce(grid, information, hyperparameters).solve(frames[0])
    total = scale * force.sum(axis=0)
    assert np.linalg.norm(contact.force_N.sum(axis=0)[:2] - total[:2]) < 0.1 * np.linalg.norm(total)


def test_a_drag_goes_one_way_and_a_press_all_ways() -> None:
    """A twist and a spread have as much to the left as to the right, whatever markers are hidden."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-5, 5, 12), np.linspace(-4, 4, 10)))
    far = np.exp(-(x**2 + y**2) / 8)[:, None]
    press = far * np.column_stack([x, y, -np.ones_like(x)])
    drag = far * np.array([0.6, -0.3, 0.0])
    assert one_way_share(press) < 0.01
    assert one_way_share(drag) == pytest.approx(1.0)
    press[x > 4] = np.nan
    assert one_way_share(press) < DRAGGED
    assert one_way_share(np.zeros_like(press)) == 0.0


NODES, FIELDS = 30, 4
UNKNOWNS = 3 * NODES + FIELDS
FORCES = np.arange(UNKNOWNS) < 3 * NODES


@pytest.fixture
def equations() -> NormalEquations:
    rng = np.random.default_rng(0)
    half = rng.normal(size=(UNKNOWNS, 3 * UNKNOWNS))
    return NormalEquations(half @ half.T, rng.uniform(1, 9, NODES), rng.uniform(1, 9, FIELDS))


@pytest.mark.parametrize("touched", [0, 1, 12, NODES])
def test_equations_of_a_contact_are_solved_as_the_whole_matrix_is(
    equations: NormalEquations, touched: int
) -> None:
    """Whatever number of nodes touch."""
    rng = np.random.default_rng(touched)
    touching = np.zeros(NODES, dtype=bool)
    touching[rng.permutation(NODES)[:touched]] = True
    right, smooth = rng.normal(size=UNKNOWNS), rng.uniform(1, 9, FIELDS)
    play = np.flatnonzero(np.concatenate([np.repeat(touching, 3), np.ones(FIELDS, dtype=bool)]))
    whole = equations.normal + np.diag(np.where(FORCES, 0.0, np.pad(smooth, (3 * NODES, 0))))
    block = whole[np.ix_(play, play)]

    factor = equations.factor(touching)
    forces, fields, log_det_root = factor.solved(right, smooth)

    expected = np.linalg.solve(block, right[play])
    np.testing.assert_allclose(np.concatenate([forces, fields]), expected, rtol=1e-8, atol=1e-10)
    assert log_det_root == pytest.approx(np.linalg.slogdet(block)[1] / 2)
    resisted = equations.resisted(factor.at, forces, fields)
    np.testing.assert_allclose(resisted, (whole[:, play] @ expected)[2 : 3 * NODES : 3], atol=1e-9)
    root = factor.covariance_root(smooth)
    np.testing.assert_allclose(root.T @ root, np.linalg.inv(block), rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("lost", [0, 7])
def test_pressures_of_all_nodes_and_their_deviations_are_those_of_the_whole_inverse(
    equations: NormalEquations, lost: int
) -> None:
    rng = np.random.default_rng(1)
    right, rows = rng.normal(size=UNKNOWNS), rng.normal(size=(lost, UNKNOWNS))
    if lost:
        equations = equations.without(rows)
    pressures, sd = equations.free_pressures(right), equations.free_sd
    inverse = np.linalg.inv(equations.normal + np.diag(np.pad(equations.usual_smooth, (3 * NODES, 0))))
    np.testing.assert_allclose(pressures, (inverse @ right)[2 : 3 * NODES : 3], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(sd, np.sqrt(np.diag(inverse))[2 : 3 * NODES : 3], rtol=1e-8)
