import numpy as np
import pytest
from fem_shapes import cube_mesh, on_cube_surface

from fem.assembly import assemble
from fem.mean_dilatation import with_mean_dilatation


def both(n, **shape):
    nodes, tets = cube_mesh(n, **shape)
    parts = assemble(nodes, tets)
    return nodes, parts, with_mean_dilatation(parts, nodes, tets)


def test_even_strain_is_met_exactly_on_curved_elements():
    nodes, parts, mean = both(2, bulge=0.05)
    even = (nodes @ np.array([[0.1, 0.2, 0], [0.3, -0.3, 0.1], [0.4, 0, 0.5]])).ravel()
    inside = np.setdiff1d(np.arange(len(nodes)), on_cube_surface(nodes))
    forces = (mean.k_lambda @ even).reshape(-1, 3)
    assert np.abs(forces[inside]).max() < 1e-12
    assert even @ mean.k_lambda @ even == pytest.approx(even @ parts.k_lambda @ even, rel=1e-12)
    assert even @ mean.k_lambda @ even == pytest.approx(0.3**2, rel=1e-12)  # (div u)^2 of the unit cube


def test_it_is_softer_than_pointwise_dilatation_and_symmetric():
    nodes, parts, mean = both(2)
    field = np.random.default_rng(0).normal(size=(3 * len(nodes), 20))
    softer = np.einsum("df,df->f", field, mean.k_lambda @ field)
    stiffer = np.einsum("df,df->f", field, parts.k_lambda @ field)
    assert (softer < stiffer).all()
    assert abs(mean.k_lambda - mean.k_lambda.T).max() < 1e-14


def test_turning_without_strain_costs_nothing():
    nodes, _, mean = both(2, bulge=0.05)
    turned = np.cross([0.3, -0.2, 0.5], nodes).ravel()
    assert np.abs(mean.for_unit_modulus(poisson_ratio=0.49) @ turned).max() < 1e-12
