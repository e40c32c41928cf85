"""`graded_modulus`: E (1 + gamma (2 d - 1)), d the relative depth, 0 at the skin and 1 at the pit.

E is that halfway. d by the distances to both (fem.mismatch.model.forward_model).
"""

from collections.abc import Sequence

from fem.mismatch.effect import ParameterSpec
from fem.mismatch.linear_law import LinearLaw, plain_stiffness, stress_operator
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.reduced_law import Operator
from fem.solid.strain_field import elastic_stress


def _operators(forward: ForwardModel) -> tuple[Operator, Sequence[Operator]]:
    grade = (2 * forward.depth - 1)[..., None]
    graded = stress_operator(
        forward, lambda strain: grade * elastic_stress(strain, poisson_ratio=forward.poisson_ratio)
    )
    return graded, (plain_stiffness(forward), graded)


EFFECT = LinearLaw(
    name="graded_modulus",
    parameter=ParameterSpec(name="gamma", unit="1", low=-0.9, high=0.9, model_share=0.18),
    sd=0.4,
    needs_pit=True,
    operators=_operators,
    amounts=lambda forward, theta: (1.0, theta),
)
"""Beyond 0.9 flesh at the pit or the skin would have no stiffness; the prior of 0.4 is set by hand."""
