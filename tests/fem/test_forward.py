import numpy as np
import pytest
from fem_shapes import ball
from scipy.sparse import csr_array

from fem.elements.assembly import assemble
from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.mesh.surface_points import locate, skin_quadrature
from fem.solid.closed_forms import cored_sphere_shrinkage_mm
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.rigid_core import pit_centre_mm, reduction, rigid_modes
from fem.sparse.solver import factorise


@pytest.fixture(scope="module")
def parts(nectarine):
    return assemble(nectarine.nodes_mm, nectarine.tets)


@pytest.fixture(scope="module")
def free(nectarine, parts):
    return UnitModulusSolid.factorise(nectarine, poisson_ratio=0.45, support="free", parts=parts)


@pytest.fixture(scope="module")
def pinch(nectarine):
    """Two pads that press along x, not quite opposite and not quite equal."""
    points = locate(nectarine, np.array([[30.0, 1, 2], [30, 2, -1], [-30, 0, 1], [-30, 1, -2]]))
    force = np.array([[[-0.5, 0, 0], [-0.5, 0.1, 0], [0.6, 0, 0.05], [0.45, 0, 0]]])
    return points.point_load(force)


def balanced(solid, load):
    """The load, one column, with the smooth body force that takes up its resultant."""
    column = load.reshape(-1, 1)
    return column - solid.free_body.body_forces @ solid.free_body.acceleration(column)


def test_forces_balance_at_every_node_and_on_the_rigid_pit(free, nectarine, pinch):
    moved, load = free.displacement(pinch), balanced(free, pinch)
    assert np.abs(free.free_body.modes.T @ load).max() < 1e-11
    assert np.abs(load - pinch.reshape(-1, 1)).max() < 1e-3 * np.abs(pinch).max()
    left = (free.stiffness @ moved.reshape(-1, 1) - load).reshape(-1, 3)
    nodes = nectarine.pit_nodes
    assert np.abs(np.delete(left, nodes, axis=0)).max() < 1e-8
    modes = rigid_modes(nectarine.nodes_mm[nodes], centre_mm=pit_centre_mm(nectarine.nodes_mm, nodes))
    assert np.abs(np.einsum("pxk,px->k", modes, left[nodes])).max() < 1e-8
    assert np.abs(modes @ free.pit_motion(moved)[0] - moved[0, nodes]).max() < 1e-10


@pytest.mark.parametrize("support", ["free", "base"])
def test_contact_nodes_alone_move_as_they_do_with_all(nectarine, parts, pinch, support):
    nodes = np.sort(nectarine.outer_nodes)[::3]
    solid = UnitModulusSolid.factorise(
        nectarine, poisson_ratio=0.45, support=support, parts=parts, contact_nodes=nodes
    )
    whole = solid.displacement(pinch)[:, nodes]
    assert np.abs(solid.contact_displacement(pinch) - whole).max() < 1e-10 * np.abs(whole).max()


def energy(solid: UnitModulusSolid, moved: np.ndarray) -> float:
    return moved.ravel() @ (solid.stiffness @ moved.ravel())


def test_free_displacement_has_no_rigid_part_and_does_not_depend_on_what_held_it(free, nectarine, pinch):
    moved = free.displacement(pinch)
    assert energy(free, moved) == pytest.approx((pinch * moved).sum(), rel=1e-9)
    mean = free.free_body.body_forces.T @ moved.ravel()
    assert np.abs(mean / np.diag(free.free_body.inertia)).max() < 1e-12
    # the same body, its pit let go and three skin nodes held instead
    motions = reduction(nectarine.nodes_mm, nectarine.pit_nodes)
    held = held_by_three_nodes(nectarine)
    kept = np.setdiff1d(np.arange(motions.shape[1]), held)
    way = csr_array(motions[:, kept])
    load = balanced(free, pinch)
    other = way @ factorise(csr_array(way.T @ free.stiffness @ way)).solve(way.T @ load)
    assert energy(free, other) == pytest.approx(energy(free, moved), rel=1e-9)
    body = free.free_body
    other -= body.modes @ np.linalg.solve(body.inertia, body.body_forces.T @ other)
    assert np.abs(other.T.reshape(pinch.shape) - moved).max() < 1e-8 * np.abs(moved).max()


def held_by_three_nodes(mesh):
    """Six dofs, as columns of T: all of one skin node, two of a second across their line, one of a third."""
    skin = np.setdiff1d(mesh.outer_nodes, mesh.pit_nodes)
    x = mesh.nodes_mm[skin]
    a, b, c = skin[x[:, 0].argmax()], skin[x[:, 0].argmin()], skin[x[:, 1].argmax()]
    first, second, third = (3 * (k - np.searchsorted(mesh.pit_nodes, k)) for k in (a, b, c))
    return np.array([first, first + 1, first + 2, second + 1, second + 2, third + 2])


def test_compliance_is_symmetric(free, nectarine):
    points = locate(nectarine, np.array([[30.0, 1, 2], [0, 29, 3], [-4, 0, 28]]))
    loads = points.point_load(np.einsum("ab,x->abx", np.eye(3), [0.3, -0.5, 0.8]))
    compliance = np.einsum("anx,bnx->ab", loads, free.displacement(loads))
    assert np.abs(compliance - compliance.T).max() < 1e-10 * np.abs(compliance).max()
    assert (np.linalg.eigvalsh(compliance) > 0).all()


def test_based_fruit_stands_still_at_its_base_and_pushes_back_the_load():
    outer = ball(4000, semi_axes_mm=(30, 30, 28))
    pit = ball(1500, semi_axes_mm=(14, 10, 12))
    base = np.array([[0.0, 0, -28]])
    mesh = tetrahedralise(*outer, *pit, edge_mm=7.0, refine_at_mm=base, refine_edge_mm=1.5)
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=0.45, support="base")
    load = locate(mesh, np.array([[1.0, 0, 28.5]])).point_load(np.array([[[0.1, 0, -1.0]]]))
    moved = solid.displacement(load)
    lowest = mesh.nodes_mm[mesh.outer_nodes, 2].min()
    held = mesh.outer_nodes[mesh.nodes_mm[mesh.outer_nodes, 2] <= lowest + 0.2]
    assert np.abs(moved[0, held]).max() == 0
    reaction = (solid.stiffness @ moved.reshape(-1)).reshape(-1, 3) - load[0]
    assert np.abs(reaction[held].sum(axis=0) - np.array([-0.1, 0, 1.0])).max() < 1e-8
    assert solid.pit_motion(moved)[0, 2] < 0


def test_a_base_without_enough_nodes_is_refused(nectarine, parts):
    tipped = FleshMesh(
        nectarine.nodes_mm @ np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]).T + 0,
        nectarine.tets,
        nectarine.outer_faces,
        nectarine.pit_nodes,
    )
    tipped.nodes_mm[nectarine.outer_nodes[0], 2] -= 50
    with pytest.raises(FemFailure) as refused:
        UnitModulusSolid.factorise(tipped, poisson_ratio=0.45, support="base", parts=parts)
    assert refused.value.problem is FemProblem.NO_BASE


def test_a_fruit_without_a_pit_floats_too(solid_ball):
    solid = UnitModulusSolid.factorise(solid_ball, poisson_ratio=0.3, support="free")
    points, area_mm2 = skin_quadrature(solid_ball)
    load = points.point_load((-area_mm2[:, None] * points.normal)[None])
    moved = solid.displacement(load)
    # even pressure p shrinks a ball by p (1 - 2 nu) / E everywhere
    off = moved[0] + 0.4 * solid_ball.nodes_mm
    assert np.abs(off - off.mean(axis=0)).max() < 0.01
    assert (solid.pit_motion(moved) == 0).all()


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.45, 0.49])
def test_even_pressure_on_a_ball_around_a_core_shrinks_it_as_lame_says(cored_ball, poisson_ratio):
    solid = UnitModulusSolid.factorise(cored_ball, poisson_ratio=poisson_ratio, support="free")
    points, area_mm2 = skin_quadrature(cored_ball)
    moved = solid.displacement(points.point_load((-area_mm2[:, None] * points.normal)[None]))
    inward = -(points.sample(moved)[0] * points.normal).sum(axis=1)
    exact = cored_sphere_shrinkage_mm(
        E_MPa=1.0, poisson_ratio=poisson_ratio, core_radius_mm=10.0, radius_mm=30.0, pressure_MPa=1.0
    )
    assert np.average(inward, weights=area_mm2) == pytest.approx(exact, rel=2e-3)


def embedded_sphere(points_mm, *, nu, radius_mm):
    """Force (N, E = 1 MPa) for a unit displacement of a rigid sphere in an endless medium, and the field.

    F = 24 pi mu (1 - nu) a / (5 - 6 nu) (Lur'e 1964; Puljiz and Menzel, Physical Review E 99, 053002, 2019);
    u = c [((3 - 4 nu) z + x x_z / r^2) / r + a^2/3 (z - 3 x x_z / r^2) / r^3], c = 3 a / (10 - 12 nu).
    """
    r = np.linalg.norm(points_mm, axis=1, keepdims=True)
    axis, radial = np.array([0.0, 0.0, 1.0]), points_mm * points_mm[:, 2:] / r**2
    field = ((3 - 4 * nu) * axis + radial) / r + radius_mm**2 / 3 * (axis - 3 * radial) / r**3
    force = 24 * np.pi * (1 - nu) * radius_mm / (5 - 6 * nu) / (2 * (1 + nu))
    return force, 3 * radius_mm / (10 - 12 * nu) * field


@pytest.mark.parametrize(("poisson_ratio", "within"), [(0.3, 4e-3), (0.45, 8e-3), (0.49, 2e-2)])
def test_a_rigid_inclusion_is_as_stiff_as_the_closed_form(cored_ball, poisson_ratio, within):
    """The skin follows the exact field of a rigid sphere pushed through an endless medium, the pit is free to
    move and takes the force: its motion per force is the inclusion's compliance. The mesh is a coarse one of
    22 thousand dofs; see docs/decisions/0001 for the convergence."""
    mesh = cored_ball
    motions = reduction(mesh.nodes_mm, mesh.pit_nodes)
    stiffness = assemble(mesh.nodes_mm, mesh.tets).for_unit_modulus(poisson_ratio=poisson_ratio)
    whole = csr_array(motions.T @ stiffness @ motions)
    skin = mesh.outer_nodes
    force, exact = embedded_sphere(mesh.nodes_mm[skin], nu=poisson_ratio, radius_mm=10.0)
    before = skin - np.searchsorted(mesh.pit_nodes, skin)
    held = (3 * before[:, None] + np.arange(3)).ravel()
    free = np.setdiff1d(np.arange(motions.shape[1]), held)
    q = np.zeros(motions.shape[1])
    q[held] = exact.ravel()
    right = -(whole @ q)
    right[-6 + 2] += force
    q[free] = factorise(csr_array(whole[free][:, free])).solve(right[free, None])[:, 0]
    translation = q[-6:-3]
    assert translation[2] == pytest.approx(1.0, rel=within)
    assert np.abs(translation[:2]).max() < 4e-3


def test_a_load_of_the_wrong_shape_or_with_nan_is_refused(free, pinch):
    with pytest.raises(FemFailure, match="loads have the shape"):
        free.displacement(pinch[:, :-1])
    with pytest.raises(FemFailure, match="non-finite"):
        free.displacement(np.where(pinch == 0, np.nan, pinch))
