"""The model's own error, in the coordinates of the effects.

No model is exact: with every effect absent its residual still resembles small amounts of some effects. A
signature of these is therefore also a column of the plain model, with mean zero and a standard deviation that
simulated fruit without mismatch show. An effect counts only for what exceeds it. This is the Bayesian
approximation error approach (Kaipio and Somersalo 2007, Inverse Problems 23, section 4) with a diagonal
covariance: the full one of few fruit has directions in which errors cancel that other fruit do not have.

`model_error.csv` has one share for each effect: the standard deviation of its amount without mismatch, over
the prior standard deviation of the amount and the compliance ratio of flesh to gel, with which apparent
amounts grow. `benchmarks/mismatch_scores.py` fits all shares together to simulated fruit without mismatch, by
the likelihood of their recordings. So an error counts once, though several effects resemble it. What the
scanned surface's error leaves is computed for each case (fem.mismatch.evidence.surface_bias) and added.

The error is several times as large for some fruit without mismatch as for others. A statistic that compares
explanations at its usual size therefore has a heavier tail without mismatch than that size alone gives. Draws
without mismatch have an error of k times its usual size,

    k^2 ~ freedom size^2 / chi-square(freedom),

so its amounts have a joint Student-t distribution. FILE has size and freedom, too.
"""

import csv
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from fem.mismatch.effect import Effect, Signature
from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.model.observation_delta import Regressor

FILE = "model_error.csv"


SIZE, FREEDOM = "size of the scale", "freedom of the scale"
"""Rows of FILE that belong to no effect."""


@dataclass(frozen=True, kw_only=True)
class ScalePrior:
    """`size`, `freedom` of the prior of k (module docstring)."""

    size: float
    freedom: float

    def drawn(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " d"]:
        """Draws of k."""
        return np.asarray(self.size * np.sqrt(self.freedom / rng.chisquare(self.freedom, count)))


@dataclass(frozen=True, kw_only=True)
class NullDraws:
    """Draws of b without mismatch, after the plain model with the usual error is integrated out.

    `bare`: the equations for a plain model without error. `error_sd`: standard deviation of each column's
    amount by the usual error, zero if it has none.
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


@cache
def _rows() -> Mapping[str, float]:
    text = (files("fem.mismatch.evidence") / FILE).read_text("utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    return {row["effect"]: float(row["share"]) for row in rows}


def model_error_shares() -> Mapping[str, float]:
    """The shipped share of each effect."""
    return {name: share for name, share in _rows().items() if name not in (SIZE, FREEDOM)}


def scale_prior() -> ScalePrior:
    """The shipped prior of the error's scale."""
    return ScalePrior(size=_rows()[SIZE], freedom=_rows()[FREEDOM])


def model_error_columns(
    signatures: Sequence[tuple[Effect, Signature, tuple[int, ...]]],
    *,
    compliance_ratio: float,
    surface_sd: Mapping[int, float],
    shares: Mapping[str, float] | None = None,
) -> list[Regressor]:
    """A column of model error for each column of the signatures, with the same fields. An effect's
    alternatives (on one pad, if the effect belongs to a pad) resemble each other and share its error.

    `signatures`: of a case, with the numbers of their columns. `surface_sd`: by column, the standard
    deviation of its amount by the error of the surface.
    """
    known = model_error_shares() if shares is None else shares
    count = Counter((effect.spec.name, signature.variant.pad) for effect, signature, _ in signatures)
    errors = []
    for effect, signature, numbers in signatures:
        share = known.get(effect.spec.name, 0.0) * compliance_ratio
        share /= np.sqrt(count[effect.spec.name, signature.variant.pad])
        for column, number in zip(signature.columns, numbers, strict=True):
            if (sd := float(np.hypot(share * column.sd, surface_sd.get(number, 0.0)))) > 0:
                errors.append(
                    replace(
                        column,
                        name=f"model error {effect.spec.name}",
                        mean=0.0,
                        measured=0.0,
                        measured_sd=0.0,
                        sd=sd,
                        positive=False,
                        of_forces=None,
                        same_as=number,
                    )
                )
    return errors
