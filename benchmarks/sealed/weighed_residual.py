"""Held-out residual in the metric of the evidence, which every method's answer can be put to."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from fem.mismatch.evidence.linear_evidence import GramMatrix


def weighed_squares(products: GramMatrix, columns: Sequence[int]) -> float:
    """Sum over recordings of r.W r, r the residual of the fit to the others; NaN for one recording."""
    count = len(products.rows)
    if count < 2:
        return float("nan")
    total = 0.0
    for k in range(count):
        fit = products.fit(columns, keep=[j for j in range(count) if j != k])
        total += squares_of(products, k, dict(zip(fit.chosen, fit.amounts, strict=True)))
    return total


def squares_of(products: GramMatrix, k: int, amounts: dict[int, float]) -> float:
    """r.W r of recording k at these amounts of columns: y.W y - 2 a.b + a.N a."""
    own = products.products[k]
    a: Float[np.ndarray, " k"] = np.array([amounts.get(int(j), 0.0) for j in products.rows[k]])
    return float(own[0, 0] - 2 * a @ own[1:, 0] + a @ own[1:, 1:] @ a)
