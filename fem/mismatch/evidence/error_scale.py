"""How large the model's own error is in one case: a scale k with a heavy-tailed prior.

The error of the plain model is about ten times as large for some fruit without mismatch as for others. A
statistic that compares explanations at its usual size (fem.mismatch.evidence.model_error) therefore has a
heavier tail without mismatch than that size alone gives. Draws without mismatch have an error of k times its
usual size,

    k^2 ~ freedom size^2 / chi-square(freedom),

so that its amounts are Student-t distributed together.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from fem.mismatch.evidence.signature_equations import SignatureEquations


@dataclass(frozen=True, kw_only=True)
class ScalePrior:
    """`size`, `freedom` of the prior of k (module docstring)."""

    size: float
    freedom: float

    def drawn(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " d"]:
        """So many k."""
        return np.asarray(self.size * np.sqrt(self.freedom / rng.chisquare(self.freedom, count)))


@dataclass(frozen=True, kw_only=True)
class NullDraws:
    """Data b of recordings without mismatch, beside the plain model with the usual error integrated out.

    `bare`: the equations beside a plain model without error. `error_sd`: of each column's amount by the usual
    error, zero where it has none.
    """

    bare: SignatureEquations
    error_sd: Float[np.ndarray, " c"]
    prior: ScalePrior

    def drawn(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, "d c"]:
        """With N of `bare`, S = diag(error_sd), amounts a ~ N(0, k^2 S^2) and noise e ~ N(0, N):

        b = T (N a + e),        T = I - N S (I + S N S)^-1 S
        """
        normal, sd = self.bare.normal, self.error_sd
        scale = self.prior.drawn(count, rng)[:, None]
        data = (scale * sd * rng.standard_normal((count, len(sd)))) @ normal + self.bare.drawn(count, rng)
        factor = cho_factor(np.eye(len(sd)) + sd[:, None] * normal * sd)
        return np.asarray(data - cho_solve(factor, sd[:, None] * data.T).T @ (sd[:, None] * normal))
