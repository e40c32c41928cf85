"""Forces from displacement: of a slab by finite elements, its equations by numpy.linalg."""

import numpy as np
import pytest

from samples.gel_press import GelBlock, gel_block
from tactile.gel.force_inverse import DRAGGED, InvertedForce, most_likely_hyperparameters, one_way_share
from tactile.gel.grid import GelGrid, PriorHyperparameters, gel_grid
from tactile.gel.normal_equations import NormalEquations
from tactile.gel.slab import GelSlab, tent_compliance
from tactile.sensors import marker_grid

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
    blind = InvertedForce(grid, flat, hyperparameters)
    contact = blind.solve(seen)
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
