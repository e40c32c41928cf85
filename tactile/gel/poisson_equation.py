"""Poisson's equation on a grid inside a fixed border, by sine transforms."""

import numpy as np
from jaxtyping import Float
from scipy.fft import dstn, idstn


def laplacian_eigenvalues(shape: tuple[int, int]) -> Float[np.ndarray, "a b"]:
    """Eigenvalues of the five-point Laplacian inside the border of a grid, in the order of the transform."""
    a, b = (2.0 * np.cos(np.pi * np.arange(1, n - 1) / (n - 1)) - 2.0 for n in shape)
    return np.asarray(a[:, None] + b)


def poisson(right: Float[np.ndarray, "a b"], eigen: Float[np.ndarray, "a b"]) -> Float[np.ndarray, "a b"]:
    """The inside values, zero at the border, whose five-point Laplacian is `right`."""
    return np.asarray(idstn(dstn(right, type=1) / eigen, type=1))
