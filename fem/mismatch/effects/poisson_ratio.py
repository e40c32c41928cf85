"""`poisson_ratio`: Poisson's ratio is not the assumed one. K = mu(nu) K_mu + lambda(nu) K_lambda at E = 1."""

import numpy as np
from jaxtyping import Float

from fem.elements.assembly import LARGEST_POISSON_RATIO, lame_constants_slope, unit_lame_constants
from fem.materials.fung_neo_hookean import neo_hookean_stress
from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import Correction, EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.linear_law import LinearLaw, matrix_operator, piecewise_operator
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.reduced_law import Operator

SPEC = EffectSpec(
    name="poisson_ratio",
    rank=70,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the flesh keeps its volume more, or less, than assumed",
        meaning="Squeezed flesh bulges sideways by another share than the settings say (Poisson's ratio).",
        advice="Apply the effect: the ratio goes into the batch's settings.",
    ),
    parameters=(
        EffectParameter(
            "nu", "1", "Poisson's ratio", limits=(0.0, LARGEST_POISSON_RATIO), low=0.05, high=0.4995
        ),
    ),
    correction=Correction.POISSON_RATIO,
)
"""Limits and bounds are set by hand, wide."""


def _derivative(model: CaseModel) -> Operator:
    def change(displacement: Float[np.ndarray, "f m 3"]) -> Float[np.ndarray, "f m 3"]:
        flat = displacement.reshape(len(displacement), -1).T
        forces = model.parts.change_with_poisson_ratio(flat, poisson_ratio=model.poisson_ratio)
        return np.ascontiguousarray(forces.T).reshape(displacement.shape)

    return change


def _derivative_finite(model: CaseModel) -> Operator:
    shear, lame = lame_constants_slope(model.poisson_ratio)
    return piecewise_operator(model, lambda gradient: neo_hookean_stress(gradient, shear, lame))


EFFECT: Effect = LinearLaw(
    spec=SPEC,
    sd=0.06,
    derivative=_derivative,
    finite=_derivative_finite,
    parts=lambda model: (matrix_operator(model.parts.k_mu), matrix_operator(model.parts.k_lambda)),
    amounts=unit_lame_constants,
    null=lambda model: model.poisson_ratio,
)
"""Elastic flesh has nu < 0.5, where K is unbounded; 0.06 is a wide prior about the assumed ratio (set by
hand)."""
