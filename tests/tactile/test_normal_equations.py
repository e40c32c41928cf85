"""Against numpy.linalg on the whole matrices."""

from functools import partial

import numpy as np
import pytest

from tactile.gel import normal_equations
from tactile.gel.normal_equations import FreeFactor, NormalEquations, factor_of, rows_of

NODES, FIELDS, MARKERS = 30, 4, 40
UNKNOWNS = 3 * NODES + FIELDS
FORCES = np.arange(UNKNOWNS) < 3 * NODES


def drawn(
    rng: np.random.Generator, *, depth: bool = True
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Observation, information (without depth of rank two), prior, and the normal matrix of all markers."""
    observed = rng.normal(size=(3 * MARKERS, UNKNOWNS))
    root = rng.normal(size=(MARKERS, 3, 3))
    root[:, :, 2] *= depth
    information = root @ root.transpose(0, 2, 1)
    half = rng.normal(size=(3 * NODES, 3 * NODES))
    prior = np.zeros((UNKNOWNS, UNKNOWNS))
    prior[: 3 * NODES, : 3 * NODES] = half @ half.T + 5 * np.eye(3 * NODES)
    return observed, information, prior, normal_of(observed, information, prior)


def normal_of(observed: np.ndarray, information: np.ndarray, prior: np.ndarray) -> np.ndarray:
    weighted = np.matmul(information, observed.reshape(len(information), 3, -1)).reshape(observed.shape)
    return np.asarray(weighted.T @ observed + prior)


def free_of(normal: np.ndarray) -> FreeFactor:
    return FreeFactor(normal, np.ones(FIELDS))


def log_det_prior(prior: np.ndarray, nodes: np.ndarray) -> float:
    at = (3 * nodes[:, None] + np.arange(3)).ravel()
    return float(np.linalg.slogdet(prior[np.ix_(at, at)])[1])


@pytest.mark.parametrize("depth", [True, False])
@pytest.mark.parametrize("gone", [0, 7])
@pytest.mark.parametrize("touched", [0, 1, 12, NODES])
def test_equations_of_a_contact_are_solved_as_the_whole_matrix_is(
    depth: bool, gone: int, touched: int
) -> None:
    """Markers that are out of view too, and whatever number of nodes touch."""
    rng = np.random.default_rng(touched + 100 * gone)
    observed, information, prior, normal = drawn(rng, depth=depth)
    equations = NormalEquations(normal, NODES, partial(log_det_prior, prior), free_of(normal))
    if gone:
        rows = rows_of(observed[: 3 * gone], information[:gone])
        assert len(rows) == (3 if depth else 2) * gone
        equations = equations.without(rows)
    left = normal_of(observed[3 * gone :], information[gone:], prior)
    touching = np.zeros(NODES, dtype=bool)
    touching[rng.permutation(NODES)[:touched]] = True
    right, smooth = rng.normal(size=UNKNOWNS), rng.uniform(1, 9, FIELDS)
    at = np.flatnonzero(np.repeat(touching, 3))
    play = np.concatenate([at, np.flatnonzero(~FORCES)])
    whole = left + np.diag(np.where(FORCES, 0.0, np.pad(smooth, (3 * NODES, 0))))
    block = whole[np.ix_(play, play)]

    factor = equations.factor(touching)
    forces, fields, log_det_root = factor.solved(right, smooth)

    expected = np.linalg.solve(block, right[play])
    np.testing.assert_allclose(np.concatenate([forces, fields]), expected, rtol=1e-8, atol=1e-10)
    assert log_det_root == pytest.approx(np.linalg.slogdet(block)[1] / 2)
    np.testing.assert_allclose(
        equations.resisted(factor.at, forces, fields),
        (whole[:, play] @ expected)[2 : 3 * NODES : 3],
        atol=1e-9,
    )
    root = factor.covariance_root(smooth)
    np.testing.assert_allclose(root.T @ root, np.linalg.inv(block), rtol=1e-7, atol=1e-10)
    other = factor_of(left[np.ix_(play, play)], len(at))
    np.testing.assert_allclose(other.solved(right[play], smooth)[0], forces, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("gone", [0, 7])
def test_pressures_of_all_nodes_and_their_deviations_are_those_of_the_whole_inverse(gone: int) -> None:
    rng = np.random.default_rng(gone)
    observed, information, prior, normal = drawn(rng)
    smooth, right = rng.uniform(1, 9, FIELDS), rng.normal(size=UNKNOWNS)
    free = FreeFactor(normal, smooth)
    if gone:
        free = free.without(rows_of(observed[: 3 * gone], information[:gone]))

    found, sd = free.pressures(right)

    left = normal_of(observed[3 * gone :], information[gone:], prior)
    inverse = np.linalg.inv(left + np.diag(np.pad(smooth, (3 * NODES, 0))))
    np.testing.assert_allclose(found, (inverse @ right)[2 : 3 * NODES : 3], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(sd, np.sqrt(np.diag(inverse))[2 : 3 * NODES : 3], rtol=1e-8)


def test_factors_are_kept_up_to_a_bound_and_the_latest_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    _, _, prior, normal = drawn(rng)
    equations = NormalEquations(normal, NODES, partial(log_det_prior, prior), free_of(normal))
    sets = [np.arange(NODES) < count for count in (10, 11, 12)]
    monkeypatch.setattr(normal_equations, "KEPT_NUMBERS", 30**2 + 33**2)
    first, second = equations.factor(sets[0]), equations.factor(sets[1])
    assert equations.factor(sets[0]) is first
    third = equations.factor(sets[2])  # the one of 11 nodes, asked for longest ago, goes, and the other too
    assert equations.factor(sets[2]) is third
    assert equations.factor(sets[1]) is not second
    monkeypatch.setattr(normal_equations, "KEPT_NUMBERS", 1)
    only = equations.factor(sets[0])
    assert only is not first
    assert equations.factor(sets[0]) is only


def test_equations_without_a_solution_are_an_error_and_no_numbers() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        factor_of(-np.eye(5), 3)
