import numpy as np
import pytest
from scipy.sparse import csr_array, diags_array, kron

from fem.elimination_order import nested_dissection
from fem.failure import FemFailure, FemProblem
from fem.solver import factorise


def plate(n, shift=0.0):
    """A five-point Laplacian on n x n points, three dofs each, coupled."""
    line = diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    grid = kron(line, np.eye(n)) + kron(np.eye(n), line)
    return csr_array(
        kron(grid, np.array([[2.0, 0.5, 0.1], [0.5, 2, 0.5], [0.1, 0.5, 2]])) + shift * np.eye(3 * n * n)
    )


def test_solution_is_that_of_a_dense_solver():
    matrix = plate(9)
    load = np.random.default_rng(0).standard_normal((matrix.shape[0], 3))
    assert np.allclose(factorise(matrix).solve(load), np.linalg.solve(matrix.toarray(), load), atol=1e-12)


def test_order_is_a_permutation_that_keeps_dofs_of_a_node_together():
    order = nested_dissection(plate(9))
    assert (np.sort(order) == np.arange(len(order))).all()
    assert (order.reshape(-1, 3) // 3 == order.reshape(-1, 3)[:, :1] // 3).all()


def test_a_diagonal_matrix_and_one_dense_block_need_no_order():
    assert np.allclose(
        factorise(csr_array(np.diag([1.0, 2.0, 4.0]))).solve(np.ones((3, 1)))[:, 0], [1, 0.5, 0.25]
    )
    dense = np.eye(4) + 0.1
    assert np.allclose(dense @ factorise(csr_array(dense)).solve(np.eye(4)), np.eye(4))


@pytest.mark.parametrize(
    "matrix",
    [
        pytest.param(csr_array(np.diag([1.0, 0.0, 1.0])), id="empty row"),
        pytest.param(csr_array(np.array([[1.0, -1.0], [-1.0, 1.0]])), id="singular"),
        pytest.param(csr_array(-np.eye(3)), id="negative"),
    ],
)
def test_what_is_not_positive_definite_is_refused(matrix):
    with pytest.raises(FemFailure, match="not positive definite") as refused:
        factorise(matrix)
    assert refused.value.problem is FemProblem.SINGULAR_STIFFNESS
