"""What the noise of the forces adds to the products of a model that holds an effect.

With e the noise of the data beside the plain model (fem.mismatch.model.force_products) and an effect that
is like its signatures phi in the amounts a, the noise of the data is e - a phi(df). With
n = E[phi(df) . W e] and Q = E[phi(df) . W phi(df)] its square is less than that of e by

    2 a.n - a.Q a,        and the products of columns phi_j with it are n_j - Q_j a

Noise is of short waves, on which an effect that stiffens the surface soon has done what it can: beyond the
amounts t a, t = a.n / a.Q a, where the square is least, it stays as it is there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.model.force_products import ForceNoise, LinearInForces


@dataclass(frozen=True, kw_only=True)
class NoiseOfChange:
    """By recording: `square`: what the effect takes off the noise's square; `plain`: n of the plain model's
    column with it; `signatures`: n of each of its signatures."""

    square: Float[np.ndarray, " k"]
    plain: Float[np.ndarray, " k"]
    signatures: Float[np.ndarray, "k c"]


def noise_of_change(
    bias: Float[np.ndarray, "k c1"], products: Float[np.ndarray, "k c1 c1"], amounts: Float[np.ndarray, " c"]
) -> NoiseOfChange:
    """n and Q of the plain model's column and of the signatures, of which so much is there."""
    of_signatures, across, plain = products[:, 1:, 1:], products[:, 0, 1:], bias[:, 0]
    gained, lost = float((bias[:, 1:] @ amounts).sum()), float((of_signatures @ amounts @ amounts).sum())
    reached = amounts * (gained / lost if 0 < gained < lost else 1.0)
    signatures = bias[:, 1:] - of_signatures @ reached
    return NoiseOfChange(
        square=(bias[:, 1:] + signatures) @ reached,
        plain=plain + (signatures - across) @ reached,
        signatures=signatures,
    )


def noise_products(
    columns: Sequence[LinearInForces | None],
    noise: ForceNoise,
    weighed_markers: Callable[[np.ndarray], np.ndarray],
) -> Float[np.ndarray, "c c"]:
    """Q of one recording, whose W is `weighed_markers`; zero for what does not follow from the forces."""
    products = np.zeros((len(columns),) * 2)
    fields = {j: column.fields(noise) for j, column in enumerate(columns) if column is not None}
    weighed = {j: np.stack([weighed_markers(draw) for draw in draws]) for j, draws in fields.items()}
    for i, field in fields.items():
        for j, other in weighed.items():
            products[i, j] = noise.of_draws(np.einsum("pfnx,pfnx->p", field, other))
    return products
