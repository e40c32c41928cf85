"""Expected evidence of a recording that is not made yet: how far two explanations' predictions lie apart.

Explanation i predicts y = m_i + A_i a + noise of a candidate recording, a ~ N(0, C_i) being what the
recordings so far have left uncertain (1/E, its parameters, nuisances), and W the inverse variance of the
noise (fem.mismatch.model.marker_equations). Where i is true, the mean of ln p(y | i) - ln p(y | j) is, with
d = m_i - m_j, N_ij = A_i.W A_j, M = (C^-1 + N)^-1 and b = A_j.W d,

    D_ij = [d.W d - b.M_j b + tr(C_i N_ii) - tr(M_j (N_jj + N_ji C_i N_ij)) + ln det(1 + N_jj C_j)
            - ln det(1 + N_ii C_i)] / 2

the expected ln evidence of Hunter and Reiner 1965 (Technometrics 7) and of Box and Hill 1967 (Technometrics
9). Its first two terms are what j fitted anew leaves of i's mean, the T-optimal criterion of Atkinson and
Fedorov 1975 (Biometrika 62), with the prior that the recordings so far leave in place of none, as in Chu et
al. 2024 (arXiv 2409.00011).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

DRAWS = 400
"""Recordings drawn for each pair and truth: a probability is then known to 2 %."""


@dataclass(frozen=True, kw_only=True)
class PairGram:
    """Products by W of d (index 0) and of the fields of two explanations, each with its covariance.

    `first`, `second`: indices of their fields, those known to both in either. Fields are scaled to amounts of
    unit variance.
    """

    products: Float[np.ndarray, "b b"]
    first: Int[np.ndarray, " k"]
    second: Int[np.ndarray, " l"]
    first_covariance: Float[np.ndarray, "k k"]
    second_covariance: Float[np.ndarray, "l l"]

    @property
    def exchanged(self) -> "PairGram":
        """With the second one as the first: the sign of d cancels."""
        return PairGram(
            products=self.products,
            first=self.second,
            second=self.first,
            first_covariance=self.second_covariance,
            second_covariance=self.first_covariance,
        )

    def expected(self) -> float:
        """D_ij in nats, the first one true.

        With nothing uncertain it is half of d.W d:

        >>> none, no = np.zeros(0, dtype=int), np.zeros((0, 0))
        >>> both = dict(first=none, second=none, first_covariance=no, second_covariance=no)
        >>> PairGram(products=np.array([[8.0]]), **both).expected()
        4.0
        """
        normal = self.products[np.ix_(self.first, self.first)]
        rival = self.products[np.ix_(self.second, self.second)]
        across = self.products[np.ix_(self.second, self.first)]
        missed = self.products[self.second, 0]
        shrunk = _posterior(rival, self.second_covariance)
        spread = rival + across @ self.first_covariance @ across.T
        twice = self.products[0, 0] - missed @ shrunk @ missed
        twice += np.trace(self.first_covariance @ normal) - np.trace(shrunk @ spread)
        twice += _log_det(rival, self.second_covariance) - _log_det(normal, self.first_covariance)
        return max(0.0, float(twice) / 2)

    def drawn(self, rng: np.random.Generator, draws: int = DRAWS) -> Float[np.ndarray, " n"]:
        """ln p(y | i) - ln p(y | j) of recordings drawn from the first one."""
        amounts = rng.normal(size=(draws, len(self.first))) @ _root(self.first_covariance).T
        seen = amounts @ self.products[self.first] + rng.normal(size=(draws, len(self.products))) @ (
            _root(self.products).T
        )
        normal = self.products[np.ix_(self.first, self.first)]
        rival = self.products[np.ix_(self.second, self.second)]
        mine = seen[:, self.first]
        theirs = seen[:, self.second] + self.products[self.second, 0]
        twice = 2 * seen[:, 0] + self.products[0, 0]
        twice += np.einsum("nk,kl,nl->n", mine, _posterior(normal, self.first_covariance), mine)
        twice -= np.einsum("nk,kl,nl->n", theirs, _posterior(rival, self.second_covariance), theirs)
        twice += _log_det(rival, self.second_covariance) - _log_det(normal, self.first_covariance)
        return np.asarray(twice / 2)


def _posterior(normal: Float[np.ndarray, "k k"], covariance: Float[np.ndarray, "k k"]) -> np.ndarray:
    """(C^-1 + N)^-1 = C (1 + N C)^-1, for a C that may be singular."""
    return np.asarray(covariance @ np.linalg.inv(np.eye(len(normal)) + normal @ covariance))


def _log_det(normal: Float[np.ndarray, "k k"], covariance: Float[np.ndarray, "k k"]) -> float:
    """ln det(1 + N C)."""
    root = _root(covariance)
    return float(np.linalg.slogdet(np.eye(len(normal)) + root.T @ normal @ root)[1])


def _root(matrix: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """R with R R' = the matrix, which has no negative eigenvalue but by rounding."""
    if not len(matrix):
        return matrix
    size, way = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray(way * np.sqrt(np.maximum(size, 0.0)))


@dataclass(frozen=True, kw_only=True)
class PairDistance:
    """Two explanations and D in nats, where the first is true and where the second is.

    `decides`: probability that the recording sets the true one apart.
    """

    names: tuple[str, str]
    first_true: float
    second_true: float
    decides: float

    @property
    def least(self) -> float:
        """The smaller one, nats."""
        return min(self.first_true, self.second_true)


def pair_distance(
    gram: PairGram,
    *,
    names: tuple[str, str],
    lead: float,
    first_share: float,
    enough: float,
    rng: np.random.Generator,
) -> PairDistance:
    """`lead`: ln evidence of the first over the second so far; `first_share`: probability that of the two it
    is the true one; `enough`: ln evidence by which the true one must lead afterwards.
    """
    other = gram.exchanged
    decided = [
        float((drawn.drawn(rng) + ahead >= enough).mean()) for drawn, ahead in ((gram, lead), (other, -lead))
    ]
    return PairDistance(
        names=names,
        first_true=gram.expected(),
        second_true=other.expected(),
        decides=first_share * decided[0] + (1 - first_share) * decided[1],
    )


def smallest(pairs: Sequence[PairDistance]) -> PairDistance:
    """The pair that a candidate tells apart least."""
    return min(pairs, key=lambda pair: pair.least)
