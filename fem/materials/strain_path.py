"""Laws of the flesh as functions of the strains so far, and what they measure of a small strain.

A law takes the displacement gradients of some elements in all frames and gives the stress that flesh of
E = 1 MPa adds to the linear one. Frames are the last axis, in order of time: what a law remembers (a set, a
damage) is a loop or an accumulation along it, and every component is worked on for all frames together.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import unit_lame_constants

Tensors = Float[np.ndarray, "m 4 3 3 f"]
"""[j, i] of a gradient du_i/dX_j or a first Piola stress P_ij, at four points of m elements in all frames."""

Points = Float[np.ndarray, "m 4 f"]

PathLaw = Callable[[Tensors], Tensors]
"""Displacement gradients, frames in order of time, to the stress added (for E = 1 MPa)."""

TangentLaw = Callable[[Tensors], Callable[[Tensors], Tensors]]
"""Displacement gradients to the linear map from their change to that of the stress (for E = 1 MPa)."""


def symmetric(gradient: Tensors) -> Tensors:
    """Small strain."""
    return np.asarray((gradient + np.swapaxes(gradient, 2, 3)) / 2)


def trace(tensors: Tensors) -> Points:
    """Sum of the three on the diagonal."""
    return np.asarray(tensors[:, :, 0, 0] + tensors[:, :, 1, 1] + tensors[:, :, 2, 2])


def on_diagonal(tensors: Tensors, more: Points) -> Tensors:
    """The tensors with this added to their diagonals, in place."""
    for i in range(3):
        tensors[:, :, i, i] += more
    return tensors


def linear_stress(gradient: Tensors, *, poisson_ratio: float) -> Tensors:
    """2 mu eps + lambda tr(eps) I for E = 1 MPa."""
    mu, lame = unit_lame_constants(poisson_ratio)
    return on_diagonal(mu * (gradient + np.swapaxes(gradient, 2, 3)), lame * trace(gradient))


def strain_energy(gradient: Tensors, *, poisson_ratio: float) -> Points:
    """W = mu eps : eps + lambda/2 tr(eps)^2 for E = 1 MPa."""
    mu, lame = unit_lame_constants(poisson_ratio)
    strain = symmetric(gradient)
    return np.asarray(mu * (strain**2).sum(axis=(2, 3)) + lame / 2 * trace(strain) ** 2)


def deviator(gradient: Tensors) -> Tensors:
    """Small strain without its change of volume."""
    strain = symmetric(gradient)
    return on_diagonal(strain, -trace(strain) / 3)


def von_mises(shear: Tensors, *, poisson_ratio: float) -> Points:
    """sqrt(3/2 s : s) over E of a strain deviator, s = 2 mu times it."""
    mu, _ = unit_lame_constants(poisson_ratio)
    return np.asarray(2 * mu * np.sqrt(1.5 * (shear**2).sum(axis=(2, 3))))
