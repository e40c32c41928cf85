"""Flesh that is softened for good where it once held much energy (Mullins).

    sigma = (1 - D) C eps,  D = dmax (1 - exp(-Wmax / W0)),  Wmax = largest W so far,  W = eps : C : eps / 2

C and W those of healthy flesh, small strain; discontinuous damage, driven by the largest energy.
Source: Simo, "On a fully three-dimensional finite-strain viscoelastic damage model", Computer Methods in
Applied Mechanics and Engineering 60, 1987.
"""

import numpy as np
from jaxtyping import Float

from fem.materials.strain_path import PathLaw, Tensors, linear_stress, strain_energy


def damaged_share(
    energy: Float[np.ndarray, "*x f"], dmax: float, W0_over_E: float
) -> Float[np.ndarray, "*x f"]:
    """D in frames in order of time, from W/E.

    Damage stays when the energy falls again.

    >>> damaged_share(np.array([[0.0, 50.0, 0.1]]), dmax=0.5, W0_over_E=1.0).round(6)
    array([[0. , 0.5, 0.5]])
    """
    return np.asarray(-dmax * np.expm1(-np.maximum.accumulate(energy, axis=-1) / W0_over_E))


def mullins_damage(dmax: float, W0_over_E: float, *, poisson_ratio: float) -> PathLaw:
    """-D C eps."""

    def added(gradient: Tensors) -> Tensors:
        share = damaged_share(strain_energy(gradient, poisson_ratio=poisson_ratio), dmax, W0_over_E)
        return np.asarray(-share[:, :, None, None] * linear_stress(gradient, poisson_ratio=poisson_ratio))

    return added
