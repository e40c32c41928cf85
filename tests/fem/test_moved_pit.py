"""A mesh whose pit is moved keeps its skin and its elements, or says that it cannot."""

import numpy as np
import pytest
from coarse_fruit import fruit_mesh

from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.boundary_fit import t10_jacobians
from fem.mesh.flesh_mesh import t6_volume_mm3
from fem.solid.moved_pit import with_pit_moved

PLACE = np.array([1.0, -1.5, 0.8, np.log(0.8)])


@pytest.fixture(scope="module")
def moved():
    return with_pit_moved(fruit_mesh(), PLACE)


def test_the_pit_is_where_and_as_large_as_asked_in_the_same_skin_and_elements(moved):
    mesh = fruit_mesh()
    before, after = mesh.nodes_mm[mesh.pit_nodes], moved.nodes_mm[moved.pit_nodes]
    middle = before.mean(axis=0)
    np.testing.assert_allclose(after, middle + PLACE[:3] + 0.8 * (before - middle), atol=1e-12)
    np.testing.assert_array_equal(moved.nodes_mm[moved.outer_nodes], mesh.nodes_mm[mesh.outer_nodes])
    np.testing.assert_array_equal(moved.tets, mesh.tets)
    assert t10_jacobians(moved.nodes_mm, moved.tets).min() > 0
    pit_mm3 = t6_volume_mm3(mesh.nodes_mm, mesh.outer_faces) - mesh.volume_mm3
    assert moved.volume_mm3 - mesh.volume_mm3 == pytest.approx((1 - 0.8**3) * pit_mm3, rel=1e-6)


def test_no_move_is_no_move():
    np.testing.assert_array_equal(with_pit_moved(fruit_mesh(), np.zeros(4)).nodes_mm, fruit_mesh().nodes_mm)


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ([0, 0, 14.0, 0], r"moves by \(0\.0, 0\.0, 14\.0\) mm and grows to 1\.00"),
        ([0, 0, 0, 1.0], "grows to 2.72"),
    ],
)
def test_a_pit_pushed_through_the_skin_is_refused_with_where_it_should_go(place, said):
    with pytest.raises(FemFailure, match=said) as refused:
        with_pit_moved(fruit_mesh(), np.array(place, dtype=float))
    assert refused.value.problem is FemProblem.INVERTED_ELEMENTS
    assert "Check the pit prior" in refused.value.detail
