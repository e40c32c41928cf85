"""Flesh that yields where it is strained most, and keeps its new shape.

    sigma = C (eps - eps_p),   f = sqrt(3/2 s : s) - (Y + H p) <= 0,   d eps_p = dp sqrt(3/2) s / |s|

von Mises with a little isotropic hardening (H = HARDENING E), small strain, by radial return in every frame.
Source: Simo and Hughes, "Computational Inelasticity", 1998, box 3.1.
"""

import numpy as np

from fem.elements.assembly import unit_lame_constants
from fem.materials.strain_path import PathLaw, Tensors, deviator, von_mises

HARDENING = 0.05
"""Rise of the yield stress with plastic strain, over E."""


def plastic_strain(gradient: Tensors, yield_over_E: float, *, poisson_ratio: float) -> Tensors:
    """eps_p in frames in order of time, none before the first."""
    mu = unit_lame_constants(poisson_ratio)[0]
    shear = deviator(gradient)
    plastic = np.zeros_like(shear[..., :1])
    hardened = np.zeros_like(plastic[:, :, 0, 0])
    for k in range(shear.shape[-1]):
        elastic = shear[..., k : k + 1] - plastic
        size = von_mises(elastic, poisson_ratio=poisson_ratio)
        flow = np.maximum(size - yield_over_E - HARDENING * hardened, 0.0) / (3 * mu + HARDENING)
        hardened += flow
        plastic += (3 * mu * flow / np.maximum(size, 1e-30))[:, :, None, None] * elastic
        shear[..., k : k + 1] = plastic
    return shear


def von_mises_set(yield_over_E: float, *, poisson_ratio: float) -> PathLaw:
    """-C eps_p, Y given over E."""
    mu = unit_lame_constants(poisson_ratio)[0]

    def added(gradient: Tensors) -> Tensors:
        return np.asarray(-2 * mu * plastic_strain(gradient, yield_over_E, poisson_ratio=poisson_ratio))

    return added
