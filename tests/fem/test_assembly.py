import numpy as np
import pytest
from fem_shapes import cube_mesh, on_cube_surface
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from fem.elements.assembly import assemble, unit_lame_constants
from fem.elements.shape_functions import t10_gradient, t10_shape, tet_quadrature
from fem.fem_failure import FemFailure, FemProblem
from fem.sparse.solver import factorise


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
    with pytest.raises(FemFailure, match=rf"is {poisson_ratio:g}, expected a value between 0 and") as refused:
        unit_lame_constants(poisson_ratio)
    assert refused.value.problem is FemProblem.BAD_POISSON_RATIO
