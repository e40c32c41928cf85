"""The normal equations of all signatures of a case, everything else integrated out.

N = phi.W' phi and b = phi.W' y with W' the weight after 1/E and the nuisances (GramMatrix.marginal). Some
hundred numbers stand for the recordings: every linear explanation is tried with them alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import log_ndtr, logsumexp

from fem.mismatch.evidence.linear_evidence import GramMatrix


@dataclass(frozen=True, kw_only=True)
class SignatureEquations:
    """`ways`: of every effect its alternative signatures, each the numbers of its columns. `sd`, `positive`:
    prior of each amount.
    """

    normal: Float[np.ndarray, "c c"]
    right: Float[np.ndarray, " c"]
    sd: Float[np.ndarray, " c"]
    positive: Bool[np.ndarray, " c"]
    ways: Mapping[str, Sequence[Sequence[int]]]

    @classmethod
    def of(
        cls,
        products: GramMatrix,
        nuisances: Sequence[int],
        signatures: Mapping[str, Sequence[Sequence[int]]],
    ) -> "SignatureEquations":
        """From the products of a case; `signatures` by the columns of `products`."""
        columns = sorted({j for ways in signatures.values() for own in ways for j in own})
        place = {j: k for k, j in enumerate(columns)}
        normal, right = products.marginal(nuisances, columns)
        return cls(
            normal=normal,
            right=right,
            sd=np.array([products.columns[j].sd for j in columns]),
            positive=np.array([products.columns[j].positive for j in columns], dtype=bool),
            ways={
                name: [tuple(place[j] for j in own) for own in ways if len(own)]
                for name, ways in signatures.items()
            },
        )

    def drawn(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "d c"]:
        """b of recordings without mismatch: Gaussian with mean zero and covariance N."""
        size, axes = np.linalg.eigh(self.normal)
        root = axes * np.sqrt(np.maximum(size, 0.0))
        return np.asarray(rng.standard_normal((count, len(size))) @ root.T)

    def log_bayes_factors(self, right: Float[np.ndarray, "d c"]) -> dict[str, Float[np.ndarray, " d"]]:
        """ln Bayes factor of each effect over none, the mean over its signatures, for d data b."""
        found = {}
        for name, ways in self.ways.items():
            if len(ways):
                each = [self._log_bayes_factor(list(own), right) for own in ways]
                found[name] = np.asarray(logsumexp(each, axis=0) - np.log(len(ways)))
        return found

    def _log_bayes_factor(
        self, own: Sequence[int], right: Float[np.ndarray, "d c"]
    ) -> Float[np.ndarray, " d"]:
        """With a ~ N(0, L^-1): b'(N + L)^-1 b / 2 - ln det(I + L^-1 N) / 2, plus ln 2 Phi(mean / sd) where
        the amount is positive.
        """
        weight = self.sd[own] ** -2.0
        normal = self.normal[np.ix_(own, own)] + np.diag(weight)
        mine = right[:, own]
        amounts = np.linalg.solve(normal, mine.T).T
        log_det = np.linalg.slogdet(normal)[1] - np.log(weight).sum()
        found = ((mine * amounts).sum(axis=1) - log_det) / 2
        if len(own) == 1 and self.positive[own[0]]:
            found = found + np.log(2.0) + log_ndtr(amounts[:, 0] * np.sqrt(normal[0, 0]))
        return np.asarray(found)
