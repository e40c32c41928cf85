"""Large deformation against closed forms, against the linear limit, and against itself turned round."""

import re
from dataclasses import dataclass

import numpy as np
import pytest
from decoupled_neo_hookean import DecoupledNeoHookean
from fem_shapes import ball, cube_flesh, cube_mesh, on_cube_surface
from hookes_law import Linear
from scipy.optimize import brentq, minimize_scalar
from scipy.spatial.transform import Rotation

import fem.solid.finite_strain_balance
from fem.elements.assembly import unit_lame_constants
from fem.elements.shape_functions import TET_FACES
from fem.fem_failure import FemFailure, FemProblem
from fem.materials.law import UnitLaw
from fem.materials.neo_hookean import NeoHookean
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.mesh.surface_points import locate, skin_quadrature
from fem.mesh.tetrahedra import boundary_faces
from fem.solid.anderson import Anderson
from fem.solid.equilibrium import Ending, equilibrium
from fem.solid.finite_strain import FiniteStrainSolid
from fem.solid.finite_strain_balance import rigid_fit
from fem.solid.finite_strain_elements import FiniteFlesh
from fem.solid.linear_solid import UnitModulusSolid

NU = 0.45
LAW = NeoHookean(poisson_ratio=NU)


def finite_displacement(solid: UnitModulusSolid, law: UnitLaw, load: np.ndarray) -> np.ndarray:
    return FiniteStrainSolid(solid=solid, law=law).displacement(load)


@pytest.fixture(scope="module")
def small_fruit():
    """A coarse cube of 24 mm around a pit off its centre, a box of 8 x 8 x 12 mm."""
    nodes, tets = cube_mesh(6, uneven=0.0)
    nodes = 24 * nodes - 12
    away = np.abs(nodes[tets[:, :4]].mean(axis=1) - [0, 0, 2])
    used, numbered = np.unique(tets[(away > [4, 4, 6]).any(axis=1)], return_inverse=True)
    nodes, tets = nodes[used], numbered.reshape(-1, 10)
    owner, face = boundary_faces(tets[:, :4])[1].T
    faces = tets[owner[:, None], TET_FACES[face]]
    inner = (np.abs(nodes[faces]) < 11).all(axis=(1, 2))
    return FleshMesh(nodes, tets, faces[~inner], np.unique(faces[inner]))


@pytest.fixture(scope="module")
def free(small_fruit):
    solid = UnitModulusSolid.factorise(small_fruit, poisson_ratio=NU, support="free")
    return FiniteStrainSolid(solid=solid, law=LAW)


@pytest.fixture(scope="module")
def pinch(small_fruit):
    """Two smooth pads that press along x, not quite opposite and not quite equal."""
    points, area = skin_quadrature(small_fruit)
    load = np.zeros((1, *small_fruit.nodes_mm.shape))
    for side, y, share in ((1.0, 1.0, 0.18), (-1.0, -0.5, 0.174)):
        away = np.linalg.norm(points.point_mm - np.array([side * 12.0, y, 0.5]), axis=1)
        traction = -side * share * np.maximum(1 - (away / 6) ** 2, 0)[:, None] * [1, 0.05, 0]
        load += points.point_load((traction * area[:, None])[None])
    return load


def test_an_even_strain_is_in_balance_on_any_mesh():
    mesh = cube_flesh(3, uneven=0.3, bulge=0.05)
    F = np.eye(3) + np.array([[0.3, 0.4, -0.1], [0.0, -0.2, 0.2], [0.1, -0.3, 0.15]])
    flesh = FiniteFlesh.of(mesh, LAW)
    force = flesh.force_N(mesh.nodes_mm @ (F - np.eye(3)).T)
    inside = np.setdiff1d(np.arange(len(force)), on_cube_surface(mesh.nodes_mm))
    assert np.abs(force[inside]).max() < 1e-13
    right = mesh.nodes_mm[:, 0] > 1 - 1e-9
    assert np.abs(force[right].sum(axis=0)).max() > 0.01
    # the faces across x carry P's first column
    assert np.abs(np.einsum("ni,nj->ij", force, mesh.nodes_mm) - LAW.stress(F[None])[0]).max() < 1e-12


def test_stiffness_is_symmetric_and_the_derivative_of_nodal_forces():
    mesh = cube_flesh(2, uneven=0.2, bulge=0.03)
    flesh = FiniteFlesh.of(mesh, LAW)
    moved, way = 0.03 * np.random.default_rng(0).normal(size=(2, *mesh.nodes_mm.shape))
    stiffness = flesh.stiffness(moved)
    assert abs(stiffness - stiffness.T).max() < 1e-12  # the forces have a potential
    off = []
    for h in (2e-2, 1e-2):
        change = flesh.force_N(moved + h * way) - flesh.force_N(moved - h * way)
        off.append(np.abs(change.ravel() / (2 * h) - stiffness @ way.ravel()).max())
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.05)


def pulled_block(solid: UnitModulusSolid, stress_MPa: float) -> np.ndarray:
    """Dead tractions along x on the two faces across it."""
    points, area = skin_quadrature(solid.mesh)
    side = np.where(np.abs(points.normal[:, 0]) > 0.5, points.normal[:, 0], 0.0)
    return points.point_load((stress_MPa * (side * area)[:, None] * [1.0, 0, 0])[None])


@pytest.mark.parametrize("stretch", [0.75, 1.4])
def test_a_free_block_pulled_at_both_ends_follows_the_closed_form(stretch):
    def bar(across: float) -> np.ndarray:
        return LAW.stress(np.diag([stretch, across, across])[None])[0]

    across = brentq(lambda a: bar(a)[1, 1], 0.5, 1.5, xtol=1e-14)
    solid = UnitModulusSolid.factorise(cube_flesh(3, uneven=0.2), poisson_ratio=NU, support="free")
    moved = finite_displacement(solid, LAW, pulled_block(solid, bar(across)[0, 0]))
    exact = (solid.mesh.nodes_mm - 0.5) * (np.array([stretch, across, across]) - 1)
    assert np.abs(moved[0] - exact).max() < 1e-6


def test_linear_flesh_without_a_pit_gives_the_linear_answer():
    solid = UnitModulusSolid.factorise(cube_flesh(3, uneven=0.2), poisson_ratio=NU, support="free")
    load = pulled_block(solid, 0.4)
    moved = finite_displacement(solid, Linear(poisson_ratio=NU), load)
    assert np.abs(moved - solid.displacement(load)).max() < 1e-7


def test_small_loads_have_the_linear_answer_for_their_limit(free, pinch):
    off = []
    for size in (0.01, 0.005):
        linear = free.solid.displacement(size * pinch)
        off.append(np.abs(free.displacement(size * pinch) - linear).max() / np.abs(linear).max())
    assert off[1] < 0.005
    assert off[0] / off[1] == pytest.approx(2.0, rel=0.05)


def test_a_free_fruit_is_in_balance_in_its_deformed_shape(free, small_fruit, pinch):
    moved = free.displacement(pinch)[0]
    assert np.abs(moved).max() > 0.5
    mean = free.solid.free_body.body_forces.T @ moved.ravel()
    assert np.abs(mean / np.diag(free.solid.free_body.inertia)).max() < 1e-9
    # what the flesh does not hold is a body force linear in the place at rest, and the pit's inner forces
    left = pinch[0] - free.flesh.force_N(moved)
    place = small_fruit.nodes_mm + moved
    assert np.abs(np.cross(place, free.flesh.force_N(moved)).sum(axis=0)).max() < 1e-9
    body = free.solid.free_body.body_forces
    loose = np.setdiff1d(np.arange(len(place)), small_fruit.pit_nodes)
    dofs = (3 * loose[:, None] + np.arange(3)).ravel()
    amounts = np.linalg.lstsq(body[dofs], left.ravel()[dofs], rcond=None)[0]
    assert np.abs(left.ravel()[dofs] - body[dofs] @ amounts).max() < 1e-6 * np.abs(pinch).max()
    at_pit = (left.ravel() - body @ amounts).reshape(-1, 3)[small_fruit.pit_nodes]
    arms = place[small_fruit.pit_nodes]
    assert np.abs(at_pit.sum(axis=0)).max() < 1e-6
    assert np.abs(np.cross(arms, at_pit).sum(axis=0)).max() < 1e-5


def test_the_pit_keeps_its_shape_however_far_it_turns(free, small_fruit, pinch):
    nodes = small_fruit.pit_nodes
    arms = small_fruit.nodes_mm[nodes] - small_fruit.nodes_mm[nodes].mean(axis=0)
    couple = np.zeros_like(pinch)
    couple[0, nodes] = np.cross([0.0, 0.0, 400.0], arms) / (arms[:, :2] ** 2).sum()
    now = small_fruit.nodes_mm[nodes] + free.displacement(pinch + couple)[0][nodes]
    now -= now.mean(axis=0)
    assert Rotation.align_vectors(now, arms)[0].magnitude() > np.radians(5)
    assert np.abs(np.linalg.norm(now, axis=1) - np.linalg.norm(arms, axis=1)).max() < 1e-12


def test_the_tangent_is_that_of_the_residual_with_the_pit_far_turned(free, small_fruit, pinch):
    balance = free.rest.under(pinch[0])
    rng = np.random.default_rng(0)
    turned = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    smooth = small_fruit.nodes_mm @ (turned - np.eye(3)).T + 0.02 * np.sin(
        0.3 * small_fruit.nodes_mm[:, ::-1]
    )
    state = balance.state(smooth)
    way = rng.normal(size=len(balance.residual(state))) * 0.01
    tangent = balance.tangent(state)
    off = []
    for h in (2e-2, 1e-2):
        ahead, behind = (balance.moved(state, s * h * way, 1.0) for s in (1, -1))
        slope = (balance.residual(ahead) - balance.residual(behind)) / (2 * h)
        off.append(np.linalg.norm(tangent.solve(slope) - way) / np.linalg.norm(way))
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.1)
    assert off[1] < 1e-3


def test_newton_doubles_the_digits_with_one_analysis_and_chord_steps_agree(free, pinch, monkeypatch):
    analysed = []
    real = fem.solid.finite_strain_balance.analyse
    monkeypatch.setattr(fem.solid.finite_strain_balance, "analyse", lambda k: analysed.append(k) or real(k))
    load = 2 * pinch
    balance = FiniteStrainSolid(solid=free.solid, law=free.law).rest.under(load[0])
    state, sizes = balance.state(np.zeros_like(load[0])), [1.0]
    while sizes[-1] > 1e-11 and len(sizes) < 8:
        state = balance.moved(state, -balance.tangent(state).solve(balance.residual(state)), 1.0)
        sizes.append(balance.size(balance.residual(state)))
    late = np.log([s for s in sizes if 1e-13 < s < 0.2])
    assert len(late) >= 3
    assert (late[1:] / late[:-1] > 1.8).all()
    assert len(analysed) == 1
    chord = free.displacement(load)
    exact = state.displacement_mm
    assert np.abs(chord[0] - exact).max() < 1e-6 * np.abs(exact).max()


def test_any_start_leads_to_the_same_place(free, pinch):
    good = free.displacement(pinch)
    wild = free.displacement(pinch, start=3 * free.solid.displacement(pinch))
    assert np.abs(wild - good).max() < 1e-6
    with_noise = good + 0.05 * np.random.default_rng(0).normal(size=good.shape)
    assert np.abs(free.displacement(pinch, start=with_noise) - good).max() < 1e-6


def test_a_fruit_and_its_load_turned_together_move_alike(free, small_fruit, pinch):
    turn = Rotation.from_rotvec([0.4, 1.1, -0.7]).as_matrix()
    there = FleshMesh(
        small_fruit.nodes_mm @ turn.T, small_fruit.tets, small_fruit.outer_faces, small_fruit.pit_nodes
    )
    solid = UnitModulusSolid.factorise(there, poisson_ratio=NU, support="free")
    moved = finite_displacement(solid, free.law, pinch @ turn.T)
    assert np.abs(moved @ turn - free.displacement(pinch)).max() < 1e-6


def test_a_load_that_no_flesh_can_bear_is_reported_with_what_was_borne():
    """Dead tension on all sides: P = mu (l - 1/l) + 3 lambda ln(l)/l cannot pass its first maximum.

    Even stretch is stable up to P = 2 mu only (Rivlin 1974, Q. Appl. Math. 32). Beyond that, rounding decides
    how much of it a search still follows.
    """
    law = NeoHookean(poisson_ratio=0.49)
    mu, lam = unit_lame_constants(0.49)
    solid = UnitModulusSolid.factorise(cube_flesh(2, uneven=0.2), poisson_ratio=0.49, support="free")
    points, area = skin_quadrature(solid.mesh)

    def borne(stretch):
        return mu * (stretch - 1 / stretch) + 3 * lam * np.log(stretch) / stretch

    most = minimize_scalar(lambda stretch: -borne(stretch), bounds=(1, 5), method="bounded")
    tension = -1.5 * most.fun
    load = points.point_load((tension * area[:, None] * points.normal)[None])
    with pytest.raises(FemFailure, match=r"reached only \d+% of load 1 of 1") as refused:
        finite_displacement(solid, law, load)
    assert refused.value.problem is FemProblem.NOT_CONVERGED
    share = float(re.search(r"(\d+)%", refused.value.detail)[1]) / 100
    assert 2 * mu / tension < share + 0.005
    assert share - 0.005 <= 1 / 1.5


@pytest.mark.slow
def test_a_based_block_with_a_ball_in_it_moves_as_calculix_has_it():
    """Hexahedra of another program; linear flesh would be 10 % off."""
    truth = np.loadtxt("tests/data/cube-around-ball-calculix.csv", delimiter=",")
    corner = np.array([[x, y, z] for x in (0, 20.0) for y in (0, 20.0) for z in (0, 20.0)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))])
    mesh = tetrahedralise(
        *(corner, faces),
        *ball(4000, semi_axes_mm=(5, 5, 5), centre_mm=(10, 10, 10)),
        edge_mm=2.2,
        refine_at_mm=np.array([[13.0, 11.0, 20.0]]),
        refine_radius_mm=7.0,
        refine_edge_mm=1.6,
    )
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="base")
    points, area = skin_quadrature(mesh)
    r2 = ((points.point_mm[:, :2] - [13.0, 11.0]) ** 2).sum(axis=1) / 8.0**2
    bump = 0.16 * np.maximum(1 - r2, 0) ** 2 * area * (points.point_mm[:, 2] > 20 - 1e-6)
    load = points.point_load((bump[:, None] * [0.2, 0.1, -1.0])[None])
    solved = finite_displacement(solid, DecoupledNeoHookean(poisson_ratio=NU), load)
    top = truth[:, 2] > 20 - 1e-6
    where = locate(mesh, truth[top, :3])
    size = np.sqrt((truth[top, 3:] ** 2).sum(axis=1).mean())

    def rms(displacement):
        off = where.sample(displacement)[0] - truth[top, 3:]
        return np.sqrt((off**2).sum(axis=1).mean()) / size

    assert rms(solved) < 0.005
    assert rms(solid.displacement(load)) > 0.09
    # the ball turns by 3.35 degrees: eight points of its surface follow
    shift, turn = rigid_fit(mesh.nodes_mm[mesh.pit_nodes] - 10, solved[0, mesh.pit_nodes])
    assert np.degrees(Rotation.from_matrix(turn).magnitude()) == pytest.approx(3.35, rel=0.015)
    start, moved = truth[~top, :3] - 10, truth[~top, 3:]
    off = shift + start @ (turn - np.eye(3)).T - moved
    assert np.sqrt((off**2).mean() / (moved**2).mean()) < 0.01


def test_nearly_incompressible_flesh_does_not_lock_at_its_many_points():
    """nu = 0.49, a deep bump: with a third of the volumetric constraints the load does the same work."""
    mesh = cube_flesh(4, 20.0, uneven=0.15)
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=0.49, support="base")
    points, area = skin_quadrature(mesh)
    r2 = ((points.point_mm[:, :2] - 10) ** 2).sum(axis=1) / 8.0**2
    bump = 0.3 * np.maximum(1 - r2, 0) ** 2 * area * (points.point_mm[:, 2] > 20 - 1e-6)
    load = points.point_load((bump[:, None] * [0.0, 0.0, -1.0])[None])
    work = []
    for degree in (5, 2):
        flesh = FiniteStrainSolid(solid=solid, law=NeoHookean(poisson_ratio=0.49), degree=degree)
        solved = flesh.displacement(load)
        assert np.abs(solved).max() > 1.9
        work.append((load * solved).sum())
    assert work[1] == pytest.approx(work[0], rel=1e-3)


@dataclass
class Dense:
    """A dense matrix as a tangent."""

    matrix: np.ndarray

    def solve(self, residual):
        return np.linalg.solve(self.matrix, residual)


@dataclass
class Spring:
    """Forces `force(x)` that must vanish, NaN beyond |x| = limit; counts its residuals."""

    force: object
    slope: object
    n: int
    limit: float = np.inf
    calls: int = 0

    @property
    def primal(self):
        return self.n

    def residual(self, x):
        self.calls += 1
        return np.where(np.abs(x) < self.limit, self.force(x), np.nan)

    def size(self, residual):
        return float(np.linalg.norm(residual))

    def moved(self, x, step, share):
        return x + share * step

    def tangent(self, x):
        matrix = self.slope(x)
        if np.linalg.eigvalsh(matrix).min() <= 0:
            raise FemFailure(FemProblem.SINGULAR_STIFFNESS, "not positive definite")
        return Dense(matrix)


def arctan():
    return Spring(np.arctan, lambda x: np.diag(1 / (1 + x**2)), 1)


def stiffening(n=30):
    """A chain of springs, each stiffer the longer it is, pulled unevenly."""
    rng = np.random.default_rng(0)
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    pull = rng.uniform(0.1, 0.3, n)
    return Spring(lambda x: chain @ x + 0.05 * x**3 - pull, lambda x: chain + np.diag(0.15 * x**2), n)


def search(problem, *, start=None, tolerance=1e-12, iterations=20, tangent=None):
    """From zero on, unless from elsewhere."""
    at = np.zeros(problem.primal) if start is None else np.array([start])
    return equilibrium(problem, at, tolerance=tolerance, iterations=iterations, tangent=tangent)


def test_a_line_search_saves_a_start_from_which_plain_newton_flies_away():
    problem, x = arctan(), 3.0
    for _ in range(4):  # plain Newton, as the textbook has it
        x -= np.arctan(x) * (1 + x**2)
    assert abs(x) > 1e6
    solved = search(problem, start=3.0, iterations=30)
    assert solved.ending is Ending.CONVERGED
    assert abs(solved.state[0]) < 1e-12


def test_states_that_no_matter_can_take_are_stepped_back_from():
    problem = Spring(np.arctan, lambda x: np.diag(1 / (1 + x**2)), 1, limit=3.5)
    assert search(problem, start=3.0, iterations=40).ending is Ending.CONVERGED


def test_chord_steps_find_the_same_with_one_factor_and_few_steps():
    problem = stiffening()
    newton = np.zeros(30)
    for _ in range(60):
        newton = newton - problem.tangent(newton).solve(problem.residual(newton))
    first = problem.tangent(np.ones(30))
    before = problem.calls
    chord = search(problem, iterations=60, tangent=first)
    taken = problem.calls - before
    assert chord.ending is Ending.CONVERGED
    assert chord.tangent is first
    assert np.abs(chord.state - newton).max() < 1e-10
    x, plain = np.zeros(30), 0
    while problem.size(problem.residual(x)) > 1e-12 and plain < 200:
        x, plain = x - first.solve(problem.residual(x)), plain + 1
    assert taken < plain


def test_a_factor_that_serves_no_more_is_renewed():
    problem = Spring(lambda x: x + x**3 - 40.0, lambda x: np.diag(1 + 3 * x**2), 1)
    poor = Dense(np.array([[200.0]]))
    solved = search(problem, tolerance=1e-13, iterations=60, tangent=poor)
    assert solved.ending is Ending.CONVERGED
    assert solved.state[0] + solved.state[0] ** 3 == pytest.approx(40.0, rel=1e-12)


def test_what_did_not_converge_says_how():
    assert search(stiffening(), iterations=2).ending is Ending.TOO_MANY
    hill = Spring(lambda x: -x + 1.0, lambda x: -np.eye(1), 1)
    assert search(hill, iterations=9).ending is Ending.STALLED


def test_nothing_is_done_where_all_is_in_balance():
    problem = arctan()
    assert search(problem, iterations=5).ending is Ending.CONVERGED
    assert problem.calls == 1


def iterates(f, x, count, acceleration):
    """x and what `count` accelerated steps make of it."""
    states = [x]
    for _ in range(count):
        step = acceleration.step(f(x))
        acceleration.took(step)
        x = x + step
        states.append(x)
    return states


def linear(n, seed=0):
    """f(x) = b - A x with its zero, to which every eigenvector adds; plain steps diverge."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(n, n)))[0]
    A = turn @ np.diag(np.geomspace(0.3, 4.0, n)) @ turn.T
    b = turn @ np.ones(n)
    return A, b, np.linalg.solve(A, b)


def test_in_a_linear_problem_every_step_is_that_of_gmres_with_a_plain_one_after_it():
    """Walker and Ni 2011, theorem 2.2: from 0 on, GMRES has the least residual over b, A b, A A b ..."""
    n = 6
    A, b, _ = linear(n)
    states = iterates(lambda x: b - A @ x, np.zeros(n), n, Anderson(n))
    krylov = b[:, None]
    for k in range(1, n):
        gmres = krylov @ np.linalg.lstsq(A @ krylov, b, rcond=None)[0]
        np.testing.assert_allclose(states[k + 1], gmres + (b - A @ gmres), atol=1e-4)
        krylov = np.column_stack([krylov, A @ krylov[:, -1]])


def test_with_one_unknown_it_is_the_secant_method():
    def f(x):
        return np.cos(x) - x

    states = np.concatenate(iterates(f, np.array([0.3]), 6, Anderson(1)))
    for a, b, c in zip(states[:4], states[1:5], states[2:6], strict=True):
        assert c == pytest.approx(b - f(b) * (b - a) / (f(b) - f(a)), rel=1e-6)
    assert states[6] == pytest.approx(0.7390851332151607, abs=1e-9)  # Dottie's number


def test_groups_have_a_mix_each_and_one_group_has_one_for_all():
    """Two unknowns that know nothing of each other: on its own each is met by the secant in two steps."""
    slope = np.array([[0.5], [1.7]])
    apart = iterates(lambda x: 1 - slope * x, np.zeros((2, 1)), 2, Anderson(1, weighed=lambda step: step))
    together = iterates(lambda x: 1 - slope * x, np.zeros((2, 1)), 2, Anderson(1))
    assert np.abs(apart[2] - 1 / slope).max() < 1e-6
    assert np.abs(together[2] - 1 / slope).max() > 0.05


def test_only_what_is_weighed_decides_the_mix():
    """The mix is that of the first unknown alone; the second moves by it, and is no nearer its own zero."""
    slope = np.array([0.5, 1.7])
    first = Anderson(1, weighed=lambda step: step[None, :1])
    states = iterates(lambda x: 1 - slope * x, np.zeros(2), 2, first)
    assert states[2][0] == pytest.approx(2.0, abs=1e-6)
    assert abs(states[2][1] - 1 / 1.7) > 0.05
