from math import factorial

import numpy as np
import pytest

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
