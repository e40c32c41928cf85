"""Expected evidence between two explanations, against multivariate normal densities in full."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fem.mismatch.design.expected_evidence import PairGram, pair_distance

NOISE_SD = 0.3
X = np.linspace(0.1, 2.0, 9)
"""Nine numbers that a recording would give."""


class Toy:
    """Two models that are linear in two parameters each: y = a x + b and y = a x + c x^2."""

    means = (1.3 * X + 0.2, 1.1 * X + 0.25 * X**2)
    fields = (np.stack([X, np.ones_like(X)]), np.stack([X, X**2]))
    covariances = (np.array([[0.04, 0.01], [0.01, 0.09]]), np.array([[0.05, -0.02], [-0.02, 0.06]]))

    def density(self, k: int):
        spread = self.fields[k].T @ self.covariances[k] @ self.fields[k]
        return multivariate_normal(self.means[k], NOISE_SD**2 * np.eye(len(X)) + spread)

    def gram(self) -> PairGram:
        rows = np.stack([self.means[0] - self.means[1], *self.fields[0], *self.fields[1]])
        return PairGram(
            products=rows @ rows.T / NOISE_SD**2,
            first=np.array([1, 2]),
            second=np.array([3, 4]),
            first_covariance=self.covariances[0],
            second_covariance=self.covariances[1],
        )


def divergence(p, q) -> float:
    """Kullback and Leibler's of two normal distributions."""
    inverse = np.linalg.inv(q.cov)
    off = q.mean - p.mean
    return float(
        (np.trace(inverse @ p.cov) - len(off) + off @ inverse @ off) / 2
        + (np.linalg.slogdet(q.cov)[1] - np.linalg.slogdet(p.cov)[1]) / 2
    )


def test_expected_evidence_is_the_divergence_of_the_two_predictions():
    toy, gram = Toy(), Toy().gram()
    assert gram.expected() == pytest.approx(divergence(toy.density(0), toy.density(1)), rel=1e-9)
    assert gram.exchanged.expected() == pytest.approx(divergence(toy.density(1), toy.density(0)), rel=1e-9)


def test_drawn_evidence_is_that_of_recordings_drawn_in_full():
    toy, rng = Toy(), np.random.default_rng(3)
    for truth, gram in ((0, toy.gram()), (1, toy.gram().exchanged)):
        y = toy.density(truth).rvs(20000, random_state=rng)
        full = toy.density(truth).logpdf(y) - toy.density(1 - truth).logpdf(y)
        drawn = gram.drawn(rng, 20000)
        assert drawn.mean() == pytest.approx(full.mean(), abs=4 * full.std() / np.sqrt(10000))
        assert drawn.std() == pytest.approx(full.std(), rel=0.05)
        for level in (-1.0, 0.0, 2.0):
            assert (drawn > level).mean() == pytest.approx((full > level).mean(), abs=0.02)


def test_a_rival_that_may_have_any_amount_of_the_difference_is_not_told_apart():
    """y = 0 against y = a x with a known to 0.01, then to 100: the fit of a takes the difference up."""
    row = np.stack([-0.5 * X, X])
    no, none = np.zeros((0, 0)), np.zeros(0, dtype=int)

    def left(sd: float) -> float:
        return PairGram(
            products=row @ row.T / NOISE_SD**2,
            first=none,
            second=np.array([1]),
            first_covariance=no,
            second_covariance=np.array([[sd**2]]),
        ).expected()

    whole = float((0.5 * X) @ (0.5 * X)) / NOISE_SD**2 / 2
    assert left(0.001) == pytest.approx(whole, rel=0.01)
    # with a free only its width counts against it (Occam): ln(1 + N C) / 2, less what noise lets it explain
    information = float(X @ X) / NOISE_SD**2
    assert left(100.0) == pytest.approx((np.log(1 + information * 1e4) - 1) / 2, rel=1e-3)


def test_what_decided_already_stays_decided_and_equal_predictions_decide_nothing():
    same = np.zeros((1, 1))
    no, none = np.zeros((0, 0)), np.zeros(0, dtype=int)
    gram = PairGram(products=same, first=none, second=none, first_covariance=no, second_covariance=no)

    def decides(lead: float) -> float:
        return pair_distance(
            gram,
            names=("a", "b"),
            lead=lead,
            first_share=0.75,
            enough=4.5,
            rng=np.random.default_rng(0),
        ).decides

    assert decides(0.0) == 0.0
    assert decides(10.0) == 0.75
    assert decides(-10.0) == 0.25
