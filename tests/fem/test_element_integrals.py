import numpy as np
from fem_shapes import cube_mesh

from fem.elements.assembly import ElementPattern, assemble, lumped_moments, unit_lame_constants
from fem.elements.shape_functions import t10_gradient, tet_quadrature


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
