import numpy as np
import pytest
from fem_shapes import cube_mesh
from scipy.sparse import csr_array

from fem.elements.assembly import assemble
from fem.solid.rigid_core import reduced, reduction

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
