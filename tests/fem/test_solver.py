import numpy as np
import pytest
from fem_shapes import cube_mesh
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from scipy.sparse import block_diag, csr_array, diags_array, eye_array, kron, random_array
from scipy.sparse.linalg import splu

from fem.elements.assembly import assemble
from fem.fem_failure import FemProblem
from fem.sparse import elimination_order
from fem.sparse.fronts import fronts
from fem.sparse.solver import analyse, factorise, solver_name


def sheet(n, shift=0.0):
    """A five-point Laplacian on n x n points, three dofs each, coupled."""
    line = diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    grid = kron(line, np.eye(n)) + kron(np.eye(n), line)
    return csr_array(
        kron(grid, np.array([[2.0, 0.5, 0.1], [0.5, 2, 0.5], [0.1, 0.5, 2]])) + shift * np.eye(3 * n * n)
    )


def held_cube(n, *, poisson_ratio=0.45, bulge=0.03):
    """Stiffness of an uneven curved cube of T10 whose bottom is held."""
    nodes, tets = cube_mesh(n, uneven=0.2, bulge=bulge)
    free = np.flatnonzero(np.repeat(nodes[:, 2] > 1e-9, 3))
    whole = assemble(nodes, tets).for_unit_modulus(poisson_ratio=poisson_ratio)
    return csr_array(whole[free][:, free])


def scattered(n, rng, density):
    """A random sparse symmetric positive definite matrix."""
    lower = random_array((n, n), density=density, rng=rng)
    return csr_array(lower @ lower.T + (0.1 + rng.random()) * eye_array(n))


@pytest.mark.parametrize(
    "matrix",
    [
        pytest.param(held_cube(5), id="cube"),
        pytest.param(held_cube(4, poisson_ratio=0.49), id="nearly incompressible cube"),
        pytest.param(sheet(40, shift=0.01), id="sheet"),
        pytest.param(csr_array(block_diag([held_cube(2), sheet(7), [[3.0]]])), id="three separate bodies"),
    ],
)
def test_solution_is_that_of_superlu(matrix):
    load = np.random.default_rng(0).standard_normal((matrix.shape[0], 7))
    theirs = splu(matrix.tocsc()).solve(load)
    assert np.abs(factorise(matrix).solve(load) - theirs).max() < 1e-10 * np.abs(theirs).max()


@pytest.mark.parametrize(
    "load",
    [
        pytest.param(np.asfortranarray(np.arange(729.0).reshape(243, 3)), id="column by column"),
        pytest.param(np.arange(729).reshape(3, 243).T, id="whole numbers, transposed"),
        pytest.param(np.arange(1458.0).reshape(243, 6)[:, ::2], id="every other column"),
        pytest.param(np.ones((243, 1)), id="one load"),
        pytest.param(np.ones((243, 0)), id="no load"),
    ],
)
def test_loads_are_solved_however_they_lie_in_memory_and_left_as_they_were(load):
    matrix, before = sheet(9), load.copy()
    moved = factorise(matrix).solve(load.astype(float, order="K"))
    assert np.allclose(matrix @ moved, load, atol=1e-9)
    assert (load == before).all()


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 160), seed=st.integers(0, 2**32 - 1), density=st.sampled_from([0.0, 0.005, 0.02, 0.1])
)
def test_any_positive_definite_pattern_is_solved_and_condensed(n, seed, density):
    rng = np.random.default_rng(seed)
    matrix = scattered(n, rng, density)
    last = rng.permutation(n)[: rng.integers(0, n + 1)]
    factor = factorise(matrix)
    load = rng.standard_normal((n, 3))
    inverse = np.linalg.inv(matrix.toarray())
    assert np.allclose(factor.solve(load), inverse @ load, atol=1e-9)
    assert np.allclose(factor.solve_at(load, last), (inverse @ load)[last], atol=1e-9)
    assert np.allclose(factor.compliance(last), inverse[np.ix_(last, last)], atol=1e-9)


def test_one_analysis_serves_matrices_of_one_pattern():
    soft, hard = held_cube(4, poisson_ratio=0.1), held_cube(4, poisson_ratio=0.49)
    plan = analyse(soft)
    load = np.random.default_rng(0).standard_normal((soft.shape[0], 2))
    for matrix in (soft, hard, soft):
        factor, fresh = plan.factorise(matrix), factorise(matrix)
        assert (factor.solve(load) == fresh.solve(load)).all()
        assert (factor.compliance(np.arange(5)) == fresh.compliance(np.arange(5))).all()


def test_a_matrix_of_another_pattern_is_refused_by_an_analysis():
    with pytest.raises(ValueError, match="analyse it again"):
        analyse(sheet(9)).factorise(held_cube(2))


def test_columns_may_be_stored_in_any_order_and_more_than_once():
    matrix = sheet(9)
    shuffled = csr_array((matrix.data.copy(), matrix.indices.copy(), matrix.indptr), shape=matrix.shape)
    for a, b in zip(matrix.indptr[:-1], matrix.indptr[1:], strict=True):
        shuffled.indices[a:b] = matrix.indices[a:b][::-1]
        shuffled.data[a:b] = matrix.data[a:b][::-1]
    twice = csr_array(
        (np.repeat(matrix.data / 2, 2), np.repeat(matrix.indices, 2), 2 * matrix.indptr), shape=matrix.shape
    )
    load = np.ones((matrix.shape[0], 1))
    for other in (shuffled, twice):
        assert np.allclose(factorise(other).solve(load), factorise(matrix).solve(load), rtol=1e-12)


def fill(plan):
    """Numbers that the fronts' pivots keep."""
    pivots = np.diff(plan.start)
    return int(pivots @ (pivots + [len(rows) for rows in plan.rows]))


@pytest.mark.parametrize(
    "matrix", [held_cube(5), sheet(40, shift=0.01), csr_array(block_diag([held_cube(2), sheet(7), [[3.0]]]))]
)
def test_without_pymetis_the_answer_is_the_same_and_the_fill_at_most_half_as_much_again(matrix, monkeypatch):
    load = np.random.default_rng(0).standard_normal((matrix.shape[0], 3))
    least = fill(fronts(matrix))
    assert "multifrontal" in solver_name()
    monkeypatch.setattr(elimination_order, "pymetis", None)
    assert "minimum degree" in solver_name()
    assert fill(fronts(matrix)) < 1.5 * least
    theirs = splu(matrix.tocsc()).solve(load)
    assert np.abs(factorise(matrix).solve(load) - theirs).max() < 1e-10 * np.abs(theirs).max()


def indefinite_cube():
    matrix = held_cube(3)
    return csr_array(matrix - 0.05 * abs(matrix).max() * eye_array(matrix.shape[0]))


def loose_cube():
    nodes, tets = cube_mesh(3)
    return assemble(nodes, tets).for_unit_modulus(poisson_ratio=0.3)


@pytest.mark.parametrize(
    "matrix",
    [
        pytest.param(csr_array(np.diag([1.0, 0.0, 1.0])), id="empty row"),
        pytest.param(csr_array(np.array([[1.0, -1.0], [-1.0, 1.0]])), id="singular"),
        pytest.param(csr_array(np.array([[0.0, 1.0], [1.0, 0.0]])), id="no diagonal"),
        pytest.param(csr_array(-np.eye(3)), id="negative"),
        pytest.param(csr_array(np.full((2, 2), np.nan)), id="not numbers"),
        pytest.param(indefinite_cube(), id="indefinite"),
        pytest.param(loose_cube(), id="held by nothing"),
    ],
)
def test_what_is_not_positive_definite_is_refused(matrix):
    with refused(FemProblem.SINGULAR_STIFFNESS, "not positive definite"):
        factorise(matrix)


def test_a_nonzero_that_vanished_on_one_side_of_the_diagonal_only_does_no_harm():
    n = 400
    rng = np.random.default_rng(0)
    i, j = np.sort(rng.integers(n, size=(2, 900)), axis=0)
    i, j = i[i < j], j[i < j]
    matrix = np.diag(np.full(n, 10.0))
    matrix[i, j] = matrix[j, i] = -0.1
    matrix[i[:300], j[:300]], matrix[j[:300], i[:300]] = 0.0, 1e-17
    one_sided, load = csr_array(matrix), rng.normal(size=(n, 2))
    assert np.allclose(one_sided @ factorise(one_sided).solve(load), load, atol=1e-9)
