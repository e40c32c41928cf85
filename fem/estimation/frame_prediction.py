"""Prediction of an elastic law's response in all frames, from those in which it is solved for.

Beyond small strain the response is of second and third degree in the forces. As a Gaussian process its kernel
is a^2 + a^3, with a the work of one frame's forces on another's displacement. It is exact for such maps if
enough frames are known (Schaback and Wendland, "Kernel techniques", Acta Numerica 15, 2006, section 8).
"""

import numpy as np
from jaxtyping import Float, Int


def elastic_kernel(work: Float[np.ndarray, "t t"], greatest: float) -> Float[np.ndarray, "t t"]:
    """a^2 + a^3 of the work f . C f of every pair of frames, over the `greatest`."""
    a = (work + work.T) / (2 * greatest)
    return np.asarray(a**2 + a**3)


def weights_of_known(
    kernel: Float[np.ndarray, "t t"], known: Int[np.ndarray, " k"], jitter: float
) -> Float[np.ndarray, "k t"]:
    """Weight of each known frame in the prediction of every frame; `jitter`: added to the diagonal."""
    among = kernel[np.ix_(known, known)] + jitter * np.eye(len(known))
    return np.asarray(np.linalg.solve(among, kernel[known]))
