"""Quadratic elements, their assembly, and a rigid core: against polynomials and closed forms."""

from math import factorial

import numpy as np
import pytest
from fem_shapes import cube_mesh, on_cube_surface
from refusals import refused
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from fem.elements.assembly import ElementPattern, assemble, lumped_moments, unit_lame_constants
from fem.elements.shape_functions import (
    TET_EDGES,
    TET_FACES,
    t6_gradient,
    t6_shape,
    t10_gradient,
    t10_shape,
    tet_quadrature,
    tri_quadrature,
)
from fem.fem_failure import FemProblem
from fem.solid.rigid_core import reduced, reduction
from fem.sparse.solver import factorise

T10_NODES = np.vstack([np.zeros(3), np.eye(3), np.zeros((6, 3))])
T10_NODES[4:] = T10_NODES[TET_EDGES].mean(axis=1)
T6_NODES = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]])


def test_shape_functions_are_one_at_their_node_and_zero_at_the_others():
    assert np.allclose(t10_shape(T10_NODES), np.eye(10), atol=1e-15)
    assert np.allclose(t6_shape(T6_NODES), np.eye(6), atol=1e-15)


@pytest.mark.parametrize(
    ("shape", "gradient", "d"), [(t10_shape, t10_gradient, 3), (t6_shape, t6_gradient, 2)]
)
def test_gradients_are_the_differences_of_the_values(shape, gradient, d):
    points = np.random.default_rng(0).dirichlet(np.ones(d + 1), 5)[:, 1:]
    step = 1e-6
    for k in range(d):
        away = step * np.eye(d)[k]
        difference = (shape(points + away) - shape(points - away)) / (2 * step)
        assert np.allclose(gradient(points)[:, k], difference, atol=1e-9)


@pytest.mark.parametrize("degree", [2, 5])
def test_tetrahedron_quadrature_is_exact_to_its_degree(degree):
    points, weights = tet_quadrature(degree)
    assert (weights > 0).all()
    powers = range(degree + 1)
    for i, j, k in [(a, b, c) for a in powers for b in powers for c in powers if a + b + c <= degree]:
        exact = factorial(i) * factorial(j) * factorial(k) / factorial(i + j + k + 3)
        assert weights @ (points[:, 0] ** i * points[:, 1] ** j * points[:, 2] ** k) == pytest.approx(
            exact, rel=1e-13
        )


def test_triangle_quadrature_is_exact_to_degree_five():
    points, weights = tri_quadrature()
    for i, j in [(a, b) for a in range(6) for b in range(6 - a)]:
        exact = factorial(i) * factorial(j) / factorial(i + j + 2)
        assert weights @ (points[:, 0] ** i * points[:, 1] ** j) == pytest.approx(exact, rel=1e-13)


def test_faces_of_an_element_point_outward_and_carry_their_own_mid_edge_nodes():
    corner = T10_NODES[TET_FACES]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    outward = corner[:, :3].mean(axis=1) - T10_NODES[:4].mean(axis=0)
    assert (np.einsum("fx,fx->f", normal, outward) > 0).all()
    for middle, (i, j) in zip((3, 4, 5), ((0, 1), (1, 2), (2, 0)), strict=True):
        assert np.allclose(corner[:, middle], (corner[:, i] + corner[:, j]) / 2)


def half_curved():
    """A cube with straight and curved elements in turn."""
    nodes, tets = cube_mesh(3, uneven=0.2, bulge=0.04)
    straight, _ = cube_mesh(3, uneven=0.2)
    return np.where(nodes[:, :1] < 0.5, nodes, straight), tets


def point_by_point(nodes, tets):
    """H of every element, (m, 10, 3, 10, 3), by quadrature and nothing else."""
    points, weights = tet_quadrature()
    jacobian = np.einsum("qin,mnx->mqix", t10_gradient(points), nodes[tets])
    slope = np.linalg.solve(jacobian, t10_gradient(points)[None])
    return np.einsum("mqia,mqjb,mq->maibj", slope, slope, np.linalg.det(jacobian) * weights, optimize=True)


def test_stiffness_is_the_sum_of_its_elements():
    nodes, tets = half_curved()
    h = point_by_point(nodes, tets)
    mu, lame = unit_lame_constants(0.4)
    shear = h.transpose(0, 1, 4, 3, 2) + np.einsum("makbk,ij->maibj", h, np.eye(3))
    element = (mu * shear + lame * h).reshape(-1, 30, 30)
    whole = np.zeros((3 * len(nodes), 3 * len(nodes)))
    for stiffness, dofs in zip(element, (3 * tets[:, :, None] + np.arange(3)).reshape(-1, 30), strict=True):
        whole[np.ix_(dofs, dofs)] += stiffness
    assembled = assemble(nodes, tets).for_unit_modulus(poisson_ratio=0.4)
    assert np.abs(assembled.toarray() - whole).max() < 1e-13 * np.abs(whole).max()
    pattern = ElementPattern.of(tets, len(nodes))
    assert np.abs(pattern.matrix(element).toarray() - whole).max() < 1e-13 * np.abs(whole).max()


def test_every_material_gets_one_pattern():
    nodes, tets = half_curved()
    pattern, rng = ElementPattern.of(tets, len(nodes)), np.random.default_rng(0)
    first, second = (pattern.matrix(rng.standard_normal((len(tets), 30, 30))) for _ in range(2))
    linear = assemble(nodes, tets).for_unit_modulus(poisson_ratio=0.3)
    for other in (second, linear):
        assert (first.indptr == other.indptr).all()
        assert (first.indices == other.indices).all()


def test_moments_of_a_cube_are_its_volume_and_its_centre():
    total = lumped_moments(*cube_mesh(3, uneven=0.2, bulge=0.04)).sum(axis=0)
    assert np.allclose(total, [1, 0.5, 0.5, 0.5], rtol=1e-12)


def solve_with_border(stiffness, nodes, border, imposed, load=None):
    """Displacement with the border nodes' given and the others in equilibrium with the load."""
    held = np.zeros(3 * len(nodes), dtype=bool)
    held[(3 * border[:, None] + np.arange(3)).ravel()] = True
    moved = np.where(held, imposed.ravel(), 0.0)
    right = -(stiffness @ moved) if load is None else load.ravel() - stiffness @ moved
    free = np.flatnonzero(~held)
    moved[free] = factorise(csr_array(stiffness[free][:, free])).solve(right[free, None])[:, 0]
    return moved.reshape(-1, 3)


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.45, 0.49])
def test_constant_strain_is_reproduced_on_an_irregular_curved_mesh(poisson_ratio):
    nodes, tets = cube_mesh(3, uneven=0.2, bulge=0.04)
    border = on_cube_surface(nodes)
    gradient = np.array([[1.0, 0.4, -0.2], [0.1, -0.6, 0.3], [0.5, -0.7, 0.2]])
    exact = nodes @ gradient.T + np.array([0.3, -0.1, 0.2])
    stiffness = assemble(nodes, tets).for_unit_modulus(poisson_ratio=poisson_ratio)
    moved = solve_with_border(stiffness, nodes, border, exact)
    assert len(border) < len(nodes)
    assert np.abs(moved - exact).max() < 1e-10


def test_displacement_converges_with_order_three():
    cells = np.array([3, 6, 10])
    error = np.array([l2_error(n) for n in cells])
    rates = np.log(error[:-1] / error[1:]) / np.log(cells[1:] / cells[:-1])
    assert (rates > 2.8).all(), rates


def l2_error(n):
    """Error for a field u = a phi, phi = sin(pi x) sin(pi y) sin(pi z), with the load that it asks for,
    f = -(mu lap u + (lambda + mu) grad div u), lap u = -3 pi^2 a phi, grad div u = hessian(phi) a."""
    nodes, tets = cube_mesh(n, uneven=0.1)
    parts = assemble(nodes, tets)
    mu, lame = unit_lame_constants(0.3)
    amplitude = np.array([1.0, 2.0, -1.0])

    def field(x):
        return np.prod(np.sin(np.pi * x), axis=-1)[..., None] * amplitude

    def load(x):
        s, c = np.sin(np.pi * x), np.cos(np.pi * x)
        hessian = -(np.pi**2) * np.prod(s, axis=-1)[..., None, None] * np.eye(3)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            mixed = np.pi**2 * c[..., i] * c[..., j] * s[..., k]
            hessian[..., i, j] += mixed
            hessian[..., j, i] += mixed
        return mu * 3 * np.pi**2 * field(x) - (lame + mu) * hessian @ amplitude

    points, weights = tet_quadrature()
    shape = t10_shape(points)
    place = np.einsum("qn,mnx->mqx", shape, nodes[tets])
    measure = np.linalg.det(np.einsum("qin,mnx->mqix", t10_gradient(points), nodes[tets])) * weights
    nodal = np.zeros_like(nodes)
    np.add.at(nodal, tets, np.einsum("mq,qn,mqx->mnx", measure, shape, load(place)))
    stiffness = parts.for_unit_modulus(poisson_ratio=0.3)
    moved = solve_with_border(stiffness, nodes, on_cube_surface(nodes), field(nodes), nodal)
    off = np.einsum("qn,mnx->mqx", shape, moved[tets]) - field(place)
    return np.sqrt((measure * (off**2).sum(axis=-1)).sum())


# a straight element's integrand is a polynomial; for a curved one the two quadratures differ by 3e-7
@pytest.mark.parametrize(("bulge", "within"), [(0.0, 1e-12), (0.02, 1e-6)], ids=["straight", "curved"])
@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_stiffness_is_that_of_scikit_fem(poisson_ratio, bulge, within):
    skfem = pytest.importorskip("skfem")
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    straight, tets = cube_mesh(2, uneven=0.2)
    nodes, _ = cube_mesh(2, uneven=0.2, bulge=bulge)
    n_corners = tets[:, :4].max() + 1
    mesh = skfem.MeshTet2.from_mesh(skfem.MeshTet(straight[:n_corners].T.copy(), tets[:, :4].T.copy()))
    mesh = skfem.MeshTet2(nodes[cKDTree(straight).query(mesh.doflocs.T)[1]].T.copy(), mesh.t)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP2()), intorder=6)
    theirs = linear_elasticity(*lame_parameters(1.0, poisson_ratio)).assemble(basis).toarray()
    node = cKDTree(nodes).query(basis.doflocs.T)[1]
    axis = np.zeros(basis.N, dtype=int)
    for kind in (basis.nodal_dofs, basis.edge_dofs):
        for k in range(3):
            axis[kind[k]] = k
    ours = assemble(nodes, tets).for_unit_modulus(poisson_ratio=poisson_ratio).toarray()
    dof = 3 * node + axis
    assert np.abs(ours[np.ix_(dof, dof)] - theirs).max() < within * np.abs(theirs).max()


@pytest.mark.parametrize("poisson_ratio", [-0.01, 0.49991, 0.5, np.nan])
def test_a_poisson_ratio_that_no_flesh_has_is_refused_with_its_value(poisson_ratio):
    with refused(FemProblem.BAD_POISSON_RATIO, rf"is {poisson_ratio:g}, expected a value between 0 and"):
        unit_lame_constants(poisson_ratio)


NODES, TETS = cube_mesh(3, uneven=0.2, bulge=0.03)
STIFFNESS = assemble(NODES, TETS).for_unit_modulus(poisson_ratio=0.45)
PIT = np.flatnonzero((np.abs(NODES - 0.5) < 0.25).all(axis=1))


def tied_to_pit():
    return reduction(NODES, PIT)


def without_some_columns():
    motions = reduction(NODES, PIT)
    return csr_array(motions[:, np.setdiff1d(np.arange(motions.shape[1]), [0, 7, 90, motions.shape[1] - 2])])


@pytest.mark.parametrize(
    "kinematics",
    [
        pytest.param(tied_to_pit(), id="free nodes and six pit motions"),
        pytest.param(without_some_columns(), id="some held"),
        pytest.param(reduction(NODES, PIT[:0]), id="no pit"),
        pytest.param(csr_array(tied_to_pit()[:, ::-1]), id="in another order"),
        pytest.param(csr_array(tied_to_pit()[:, :-6]), id="pit held"),
        pytest.param(csr_array((STIFFNESS.shape[0], 3)), id="all held"),
    ],
)
def test_reduced_stiffness_is_the_triple_product(kinematics):
    expected = (kinematics.T @ STIFFNESS @ kinematics).toarray()
    product = reduced(STIFFNESS, kinematics)
    assert np.abs(product.toarray() - expected).max() <= 1e-14 * np.abs(STIFFNESS.data).max()
    assert product.has_canonical_format
