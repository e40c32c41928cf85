"""Displacement of the skin in front of the pads under forces on it, with all other unknowns free.

C = P' K^-1 P is the dense compliance of the skin's unknowns P. Its softest modes, the whole fruit on its weak
support springs, are a thousand times softer than the rest. They are split off, C = E + Z M Z', so that single
precision suffices for E.

fem contributes only the sparse linear algebra: every correct factorisation gives the same answer.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from fem.sparse.solver import Factor, factorise

SOFTEST, ROUNDS = 16, 3
"""Modes split off: six of the whole fruit, six of a loose pit, some to spare. Steps of subspace iteration for
them (Golub and Van Loan 2013, section 8.2.4). C depends on neither."""

Slices = tuple[slice, ...]


@dataclass(frozen=True, kw_only=True)
class SkinCompliance:
    """C = scale (E + Z M Z'), mm/N: `elastic` E in single precision, `softest` Z orthonormal, `core` M."""

    elastic: Float[np.ndarray, "d d"]
    softest: Float[np.ndarray, "d z"]
    core: Float[np.ndarray, "z z"]
    scale: float = 1.0

    def __len__(self) -> int:
        return len(self.elastic)

    def scaled(self, factor: float) -> "SkinCompliance":
        """The compliance of flesh that is `factor` times as compliant."""
        return replace(self, scale=factor * self.scale)

    def times(
        self, force: Float[np.ndarray, "a ..."], columns: Slices, rows: Slices | None = None
    ) -> Float[np.ndarray, "r ..."]:
        """Displacement at `rows` (None: all) under forces at `columns`, listed one after another."""
        rows = (slice(0, len(self)),) if rows is None else rows
        if not columns:
            return np.zeros((sum(r.stop - r.start for r in rows), *force.shape[1:]))
        single = force.astype(self.elastic.dtype)
        pull = self.core @ sum(
            self.softest[c].T @ part for c, part in parts_of(force, columns)
        )  # the softest modes' share, in double precision
        displacements = []
        for r in rows:
            elastic = sum(self.elastic[r, c] @ part for c, part in parts_of(single, columns))
            displacements.append(elastic + self.softest[r] @ pull)
        return np.asarray(self.scale * np.concatenate(displacements))

    def dense(self) -> Float[np.ndarray, "d d"]:
        """C itself."""
        return np.asarray(self.scale * (self.elastic + self.softest @ self.core @ self.softest.T))


def parts_of(
    values: Float[np.ndarray, "a ..."], columns: Slices
) -> list[tuple[slice, Float[np.ndarray, "_ ..."]]]:
    """Parts of `values` for each of the columns' slices."""
    ends = np.cumsum([c.stop - c.start for c in columns])
    return list(zip(columns, np.split(values, ends[:-1]), strict=True))


def skin_compliance(stiffness: csr_array, kept: Int[np.ndarray, " d"]) -> SkinCompliance:
    """Compliance of the unknowns `kept` of a symmetric positive definite stiffness."""
    return compliance_of(factorise(stiffness), kept)


def compliance_of(factor: Factor, kept: Int[np.ndarray, " d"]) -> SkinCompliance:
    """As `skin_compliance`, for a factorised stiffness."""
    whole = factor.compliance(kept)
    softest = np.random.default_rng(0).normal(size=(len(whole), min(SOFTEST, len(whole))))
    for _ in range(ROUNDS):
        softest, _ = np.linalg.qr(whole @ softest)
    core = softest.T @ (whole @ softest)
    core = (core + core.T) / 2
    for first in range(0, len(whole), 500):
        rows = slice(first, first + 500)
        whole[rows] -= (softest[rows] @ core) @ softest.T
    return SkinCompliance(elastic=whole.astype(np.float32), softest=softest, core=core)
