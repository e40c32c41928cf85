"""`graded_modulus`: E (1 + gamma (2 d - 1)), d the relative depth, 0 at the skin and 1 at the pit.

E is the modulus halfway. d: fem.mesh.relative_depth.
"""

from fem.mismatch.effect import Effect
from fem.mismatch.effect_spec import EffectParameter, EffectSpec, EffectWords, Scope
from fem.mismatch.kinds.linear_law import LinearLaw, neo_hookean_operator, stress_operator
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.reduced_law import Operator
from fem.solid.strain_field import elastic_stress

SPEC = EffectSpec(
    name="graded_modulus",
    rank=40,
    family="object",
    scope=Scope.LOT,
    words=EffectWords(
        short="the flesh is not equally firm from skin to pit",
        meaning="Firmness changes with depth: fruit often softens from the outside in, or around the pit.",
        advice="Read the modulus as that of the flesh halfway between skin and pit.",
    ),
    parameters=(
        EffectParameter(
            "gamma",
            "1",
            "change of firmness from skin (−) to pit (+)",
            limits=(-1.0, 1.0),
            low=-0.9,
            high=0.9,
        ),
    ),
)
"""Limits and bounds are set by hand, wide."""


def _graded(model: CaseModel) -> Operator:
    grade = (2 * model.depth - 1)[..., None]
    return stress_operator(
        model, lambda strain: grade * elastic_stress(strain, poisson_ratio=model.poisson_ratio)
    )


def _graded_finite(model: CaseModel) -> Operator:
    return neo_hookean_operator(model, 2 * model.depth - 1)


EFFECT: Effect = LinearLaw(spec=SPEC, sd=0.4, of_the_depth=True, derivative=_graded, finite=_graded_finite)
"""Near 1 flesh at pit or skin has no stiffness, hence the bound of 0.9. The prior of 0.4 is set by hand."""
