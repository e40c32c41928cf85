"""Flesh that grows stiffer the more it is strained, at finite strain.

    P(F) = exp(b W / mu) P_nh,     P_nh = mu (F - F^-T) + lambda ln(J) F^-T = dW/dF,
    W = mu/2 (F : F - 3 - 2 ln J) + lambda/2 (ln J)^2,      F = I + grad u,  J = det F

the exponential of Fung (1967, "Elasticity of soft tissues in simple elongation", American Journal of
Physiology 213) on the Neo-Hookean law in the form of Bonet and Wood (2008, "Nonlinear Continuum Mechanics for
Finite Element Analysis", eq. 6.28). It has no memory; as a path law it is solved for all frames together.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import unit_lame_constants
from fem.materials.strain_path import (
    PathLaw,
    Points,
    TangentLaw,
    Tensors,
    linear_stress,
    on_diagonal,
    strain_energy,
    trace,
)

LEAST_VOLUME = 0.01
"""Flesh is never pressed to less than this share of its volume, not even while rounds go on."""
STEEPEST = 4.0
"""b W/mu above which the exponential goes on as a straight line: no round of the search may run away."""


def fung_neo_hookean(b: float, *, poisson_ratio: float) -> PathLaw:
    """P less the linear stress."""

    def added(gradient: Tensors) -> Tensors:
        return np.asarray(
            first_piola_stress(gradient, b, poisson_ratio=poisson_ratio)
            - linear_stress(gradient, poisson_ratio=poisson_ratio)
        )

    return added


def neo_hookean_tangent(*, poisson_ratio: float) -> TangentLaw:
    """Derivative of P_nh along dF, less the linear stress of dF.

    mu dF + lambda (G : dF) G + (mu - lambda ln J) G dF^T G,      G = F^-T
    (the tangent of fem.materials.neo_hookean).
    """
    mu, lame = unit_lame_constants(poisson_ratio)

    def at(gradient: Tensors) -> Callable[[Tensors], Tensors]:
        cofactor, J, log_J = _cofactor(gradient)
        G = cofactor / J[:, :, None, None]
        shear = (mu - lame * log_J)[:, :, None, None]

        def added(change: Tensors) -> Tensors:
            turned = np.einsum("mqjlf,mqklf->mqjkf", G, change)
            tangent = np.einsum("mqjkf,mqkif->mqjif", turned, G)
            tangent *= shear
            tangent += mu * change
            tangent += (lame * (G * change).sum(axis=(2, 3)))[:, :, None, None] * G
            return np.asarray(tangent - linear_stress(change, poisson_ratio=poisson_ratio))

        return added

    return at


def fung_at_small_strain(*, poisson_ratio: float) -> PathLaw:
    """W/mu times the linear stress: the law's derivative to b where strains are small."""
    mu = unit_lame_constants(poisson_ratio)[0]

    def added(gradient: Tensors) -> Tensors:
        grown = strain_energy(gradient, poisson_ratio=poisson_ratio) / mu
        return np.asarray(grown[:, :, None, None] * linear_stress(gradient, poisson_ratio=poisson_ratio))

    return added


@np.errstate(over="ignore", invalid="ignore")
def first_piola_stress(gradient: Tensors, b: float, *, poisson_ratio: float) -> Tensors:
    """P for E = 1 MPa, [j, i] of it P_ij."""
    mu, lame = unit_lame_constants(poisson_ratio)
    P, log_J = _neo_hookean(gradient, mu, lame)
    # F : F - 3 = 2 tr H + H : H, whose parts would cancel in single precision otherwise
    energy = trace(gradient) + (gradient**2).sum(axis=(2, 3)) / 2 - log_J + lame / mu / 2 * log_J**2
    P *= _exponential(b * energy)[:, :, None, None]
    return P


def neo_hookean_stress(gradient: Tensors, mu: float, lame: float) -> Tensors:
    """P_nh of these constants, [j, i] of it P_ij; linear in both."""
    return _neo_hookean(gradient, mu, lame)[0]


def _neo_hookean(gradient: Tensors, mu: float, lame: float) -> tuple[Tensors, Points]:
    """P_nh and ln J."""
    cofactor, J, log_J = _cofactor(gradient)
    P = mu * deformation_gradient(gradient)
    P += ((lame * log_J - mu) / J)[:, :, None, None] * cofactor
    return P, log_J


def deformation_gradient(gradient: Tensors) -> Tensors:
    """F = I + grad u."""
    return on_diagonal(gradient.copy(), np.ones_like(gradient[:, :, 0, 0]))


def _cofactor(gradient: Tensors) -> tuple[Tensors, Points, Points]:
    """J F^-T, J and ln J."""
    F = deformation_gradient(gradient)
    cofactor = np.empty_like(F)
    for j in range(3):
        for i in range(3):
            p, q, r, s = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            cofactor[:, :, j, i] = F[:, :, p, r] * F[:, :, q, s] - F[:, :, p, s] * F[:, :, q, r]
    return cofactor, *_volume_ratio(gradient)


def shrunk_as_a_whole(
    energy: Points, volume_mm3: Float[np.ndarray, "m 4"], b: float, *, poisson_ratio: float
) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, " f"]]:
    """By how much a linear field of this W/E shrinks if it keeps its shape, in every frame, and the stiffness
    then over the linear one at all but 1 % of the points.

    The share a of least work: a + sum over points of a W expm1(b a^2 W/mu) over that of W = 1, small strain.
    """
    mu = unit_lame_constants(poisson_ratio)[0]
    x, v = b / mu * energy.reshape(-1, energy.shape[-1]).T, volume_mm3.ravel()
    whole = np.maximum(x @ v, 1e-300)
    low, high = np.zeros(len(x)), np.ones(len(x))
    for _ in range(12):
        a = (low + high) / 2
        over = a * ((x * _exponential(a[:, None] ** 2 * x)) @ v) / whole > 1
        low, high = np.where(over, low, a), np.where(over, a, high)
    top = np.quantile(x, 0.99, axis=1) * a**2
    return a, _exponential(top) * (1 + 2 * top)


def _volume_ratio(H: Tensors) -> tuple[Points, Points]:
    """J = det(I + H), never below LEAST_VOLUME, and its logarithm, of which little is lost near 1."""
    grown = trace(H)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        grown = grown + H[:, :, i, i] * H[:, :, j, j] - H[:, :, i, j] * H[:, :, j, i]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        grown = grown + H[:, :, 0, i] * (H[:, :, 1, j] * H[:, :, 2, k] - H[:, :, 1, k] * H[:, :, 2, j])
    grown = np.maximum(grown, LEAST_VOLUME - 1)
    return 1 + grown, np.log1p(grown)


def _exponential(x: Float[np.ndarray, "*x"]) -> Float[np.ndarray, "*x"]:
    """exp(x), beyond STEEPEST as its tangent there."""
    near = np.minimum(x, STEEPEST)
    return np.asarray(np.exp(near) * (1 + x - near))
