"""`skin`: a membrane on the flesh carries part of the load.

Its stiffness is Et, Young's modulus times thickness (N/mm), its Poisson's ratio the flesh's; K = E K0 + Et Km
(fem.solid.membrane). The search varies theta = Et / E; the reported parameter is Et.
"""

from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.linear_law import LinearLaw, matrix_operator
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.reduced_law import Operator
from fem.solid.membrane import membrane_forces, membrane_stiffness

SPEC = EffectSpec(
    name="skin",
    rank=30,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="a stiff skin carries part of the load",
        meaning="The skin works like a membrane stretched over the flesh: the fruit looks firmer than it is.",
        advice="Apply the effect to the batch: the modulus is then that of the flesh under the skin.",
    ),
    parameters=(
        EffectParameter(
            "Et_N_per_mm",
            "N/mm",
            "stiffness of the skin",
            limits=(0.0, 1e4),
            low=0.0,
            high=60.0,
            searched_as="Et_over_E_mm",
            modulus_power=1.0,
        ),
    ),
)
"""Limits and bounds are set by hand, wide."""


def _stretched(model: CaseModel) -> Operator:
    return matrix_operator(membrane_stiffness(model.mesh, poisson_ratio=model.poisson_ratio))


def _stretched_finite(model: CaseModel) -> Operator:
    return lambda displacement: membrane_forces(model.mesh, displacement, poisson_ratio=model.poisson_ratio)


EFFECT: Effect = LinearLaw(spec=SPEC, sd=4.0, positive=True, derivative=_stretched, finite=_stretched_finite)
"""theta in mm: thickness of flesh that is as stiff as the membrane. It is not negative; 60 is as stiff as a
whole fruit; the prior of 4 is set by hand."""
