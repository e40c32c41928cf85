"""`anisotropy`: the flesh is stiffer (or softer) along the stem axis: C_zzzz grows by axial times mu.

At finite strain the added stress is F S with S_zz = axial mu E_zz, E the Green-Lagrange strain.
"""

import numpy as np

from fem.elements.assembly import unit_lame_constants
from fem.materials.fung_neo_hookean import deformation_gradient
from fem.materials.strain_path import Tensors
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.linear_law import LinearLaw, piecewise_operator, stress_operator
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.reduced_law import Operator

ALONG_STEM = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
"""Selects zz of the six stresses xx, yy, zz, yz, xz, xy."""

SPEC = EffectSpec(
    name="anisotropy",
    rank=60,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the flesh is firmer along the stem axis than across it, or the other way round",
        meaning="Fibres make the flesh resist differently in different directions.",
        advice="Grasp all fruit in the same direction, or apply the effect to the batch.",
    ),
    parameters=(
        EffectParameter(
            "axial",
            "1",
            "extra stiffness along the stem axis",
            limits=(-10.0, 1e3),
            low=-1.5,
            high=6.0,
        ),
    ),
)
"""Limits and bounds are set by hand, wide."""


def _along_the_stem(model: CaseModel) -> Operator:
    mu, _ = unit_lame_constants(model.poisson_ratio)
    return stress_operator(model, lambda strain: mu * strain * ALONG_STEM)


def _along_the_stem_finite(model: CaseModel) -> Operator:
    mu, _ = unit_lame_constants(model.poisson_ratio)

    def law(gradient: Tensors) -> Tensors:
        strain = gradient[:, :, 2, 2] + (gradient[:, :, 2] ** 2).sum(axis=2) / 2
        stress = np.zeros_like(gradient)
        stress[:, :, 2] = mu * strain[:, :, None] * deformation_gradient(gradient)[:, :, 2]
        return stress

    return piecewise_operator(model, law)


EFFECT: Effect = LinearLaw(spec=SPEC, sd=0.8, derivative=_along_the_stem, finite=_along_the_stem_finite)
"""At -1.5 C_zzzz is still positive; 6, far stiffer than flesh, and the prior of 0.8 are set by hand."""
