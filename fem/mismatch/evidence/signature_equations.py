"""The normal equations of all signatures of a case, with all other columns integrated out.

N = phi.W' phi and b = phi.W' y with W' the weight after 1/E and the nuisances (GramMatrix.marginal). These
hundred or so numbers replace the recordings in every linear explanation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import log_ndtr, logsumexp

from fem.mismatch.evidence.linear_evidence import GramMatrix

SAME_ERROR = 1e-3
"""Share of the greatest energy (chi-square) below which a direction is a combination of the others, up to
noise. Set by hand."""
ABSORBED = 1e-6
"""Share of an error's energy (chi-square) below which the nuisances absorb it, up to round-off. Set by
hand."""


@dataclass(frozen=True, kw_only=True)
class SignatureEquations:
    """`columns`: those of the case's products, in order. `ways`: each effect's alternative signatures, as
    indices of their columns here. `sd`, `positive`, `measured`: prior of each amount (Regressor). `least`:
    the smallest meaningful value of a positive amount. `law_error`: products of the columns with orthonormal
    errors of the law that is given (fem.mismatch.evidence.law_error), if there is one.
    """

    normal: Float[np.ndarray, "c c"]
    right: Float[np.ndarray, " c"]
    sd: Float[np.ndarray, " c"]
    positive: Bool[np.ndarray, " c"]
    least: Float[np.ndarray, " c"]
    measured: Float[np.ndarray, " c"]
    ways: Mapping[str, Sequence[Sequence[int]]]
    columns: tuple[int, ...] = ()
    law_error: Float[np.ndarray, "c m"] | None = None

    @classmethod
    def of(
        cls,
        products: GramMatrix,
        nuisances: Sequence[int],
        signatures: Mapping[str, Sequence[Sequence[int]]],
    ) -> "SignatureEquations":
        """From the products of a case; `signatures` by the columns of `products`."""
        columns = sorted({j for ways in signatures.values() for way in ways for j in way})
        place = {j: k for k, j in enumerate(columns)}
        normal, right = products.marginal(nuisances, columns)
        return cls(
            normal=normal,
            right=right,
            sd=np.array([products.columns[j].sd for j in columns]),
            positive=np.array([products.columns[j].positive for j in columns], dtype=bool),
            least=np.array([products.columns[j].least for j in columns]),
            measured=np.array([products.columns[j].measured for j in columns]),
            columns=tuple(columns),
            ways={
                name: [tuple(place[j] for j in way) for way in ways if len(way)]
                for name, ways in signatures.items()
            },
        )

    def drawn(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "d c"]:
        """b of recordings without mismatch: Gaussian with mean zero and covariance N."""
        size, axes = np.linalg.eigh(self.normal)
        root = axes * np.sqrt(np.maximum(size, 0.0))
        return np.asarray(rng.standard_normal((count, len(size))) @ root.T)

    def log_bayes_factors(
        self, right: Float[np.ndarray, "d c"], *, said: Mapping[str, Sequence[float]] | None = None
    ) -> dict[str, Float[np.ndarray, " d"]]:
        """Log Bayes factor of each effect over none, the mean over its signatures, for d data b.

        `said`: auxiliary log likelihood of each signature, by effect.
        """
        factors = {}
        for name, ways in self.ways.items():
            if len(ways):
                known = [0.0] * len(ways) if said is None else said[name]
                each = [
                    self.log_bayes_factor(columns, right) + more
                    for columns, more in zip(ways, known, strict=True)
                ]
                factors[name] = np.asarray(logsumexp(each, axis=0) - np.log(len(ways)))
        return factors

    def numbers(self, columns: Sequence[int]) -> tuple[int, ...]:
        """Indices here of these columns of the case's products."""
        return tuple(self.columns.index(j) for j in columns)

    def given(self, first: Sequence[int]) -> tuple["SignatureEquations", float]:
        """The equations after the columns `first` are integrated out, and the signal that these columns
        explain: b'(N + L)^-1 b for prior means of zero.
        """
        at = list(first)
        measured, right = self.measured[at], self.right - self.normal[:, at] @ self.measured[at]
        normal = self.normal[np.ix_(at, at)] + np.diag(self.sd[at] ** -2.0)
        solved = np.linalg.solve(normal, np.c_[self.normal[at], right[at]])
        left = self.normal - self.normal[:, at] @ solved[:, :-1]
        signal = right[at] @ solved[:, -1] + measured @ (self.right[at] + right[at])
        return replace(
            self,
            normal=(left + left.T) / 2,
            right=right - self.normal[:, at] @ solved[:, -1],
            law_error=None,
        ), float(signal)

    def given_law(
        self,
        errors: Float[np.ndarray, "e e"],
        products: Float[np.ndarray, "c e"],
        *,
        energy: Float[np.ndarray, " e"],
    ) -> "SignatureEquations":
        """The equations with the law's errors: their products with each other and with the columns. `energy`:
        that of each error before the nuisances are integrated out; one that they absorb is left out.
        """
        remaining = np.flatnonzero(np.diag(errors) > ABSORBED * energy)
        size = np.sqrt(np.diag(errors)[remaining])
        share, axes = np.linalg.eigh(errors[np.ix_(remaining, remaining)] / np.outer(size, size))
        kept = share > SAME_ERROR * share.max(initial=0.0)
        return replace(self, law_error=products[:, remaining] / size @ axes[:, kept] / np.sqrt(share[kept]))

    @cached_property
    def resemblance(self) -> dict[tuple[int, ...], float]:
        """The greatest share of each signature's energy in the space of the law's errors, over its amounts; 1
        if that space is not known.
        """
        return {way: self._in_law_error(way) for ways in self.ways.values() for way in map(tuple, ways)}

    def _in_law_error(self, columns: Sequence[int]) -> float:
        if self.law_error is None:
            return 1.0
        at = list(columns)
        energy, axes = np.linalg.eigh(self.normal[np.ix_(at, at)])
        kept = energy > SAME_ERROR * energy.max()
        inside = (axes[:, kept] / np.sqrt(energy[kept])).T @ self.law_error[at]
        if not inside.size:
            return 0.0
        return min(float(np.linalg.norm(inside, 2)) ** 2, 1.0)

    def amounts(self, columns: Sequence[int]) -> Float[np.ndarray, " k"]:
        """Posterior means of the amounts of these columns without others: (N + L)^-1 (b + L m)."""
        at = list(columns)
        weight = self.sd[at] ** -2.0
        return np.asarray(
            np.linalg.solve(
                self.normal[np.ix_(at, at)] + np.diag(weight), self.right[at] + weight * self.measured[at]
            )
        )

    def log_bayes_factor(
        self, columns: Sequence[int], right: Float[np.ndarray, "d c"], *, noise: float = 1.0
    ) -> Float[np.ndarray, " d"]:
        """Of one signature over none. With a ~ N(m, L^-1) and c = b - N m: c'(N + L)^-1 c / 2 + m'(b + c) / 2
        - ln det(I + L^-1 N) / 2, plus ln 2 Phi(mean / sd) for a positive amount. It is at most zero if an
        amount is below its `least`. `noise`: variance of the noise, which N and b have as 1.
        """
        at = list(columns)
        weight, measured = self.sd[at] ** -2.0, self.measured[at]
        normal = self.normal[np.ix_(at, at)] / noise
        beyond = right[:, at] / noise - measured @ normal
        known = (right[:, at] / noise + beyond) @ measured
        normal += np.diag(weight)
        steps = np.linalg.solve(normal, beyond.T).T
        amounts = measured + steps
        log_det = np.linalg.slogdet(normal)[1] - np.log(weight).sum()
        log_factor = ((beyond * steps).sum(axis=1) + known - log_det) / 2
        if len(at) == 1 and self.positive[at[0]]:
            log_factor = log_factor + np.log(2.0) + log_ndtr(amounts[:, 0] * np.sqrt(normal[0, 0]))
        meaningless = (self.positive[at] & (amounts < self.least[at])).any(axis=1)
        return np.asarray(np.where(meaningless, np.minimum(log_factor, 0.0), log_factor))
