"""What large deformation adds to the linear change that an effect of the flesh makes.

Flesh with an amount a of an effect is at w = u / s where

    F(w) + a D(w) = f,        F: Neo-Hookean, D: the effect's own forces, both at finite strain

At a = 0 the derivative of w to a solves K_T w' = -D(w), K_T the tangent at large deformation. At small strain
it is w0' = -K0^-1 D0 w0. Their difference is of second and third degree in the forces, like large deformation
itself, and is predicted between the same frames. K0's factor solves for it as for any law that adds stress:
w' - w0' is what K_T - K0 adds to the linear field w0' (fem.solid.initial_stress).
"""

import numpy as np

from fem.fem_failure import FemFailure
from fem.materials.fung_neo_hookean import neo_hookean_tangent
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import Fields
from fem.mismatch.model.reduced_law import Operator
from fem.mismatch.model.stress_history import MOST_ROUNDS, neo_hookean_field, stiffening_path
from fem.solid.initial_stress import AddedStress

CLOSE_MM = 2e-3
"""Rounds end when none asks a node of the skin to move more than this, half of a marker's noise: the step
after the last round leaves a fifth of it."""


def finite_change(model: CaseModel, *, finite: Operator, linear: Operator, amount: float) -> Fields:
    """w' - w0' at the markers of every recording, mm MPa per unit of the amount.

    `finite` and `linear`: D and D0, from displacements in mm to the nodal forces of a unit amount.
    `amount`: a usual one; its change is right to CLOSE_MM. Zero where large deformation is not found.
    Raises FemFailure (NOT_CONVERGED).
    """
    field = neo_hookean_field(model)
    if isinstance(field, FemFailure):
        return [np.zeros_like(plain) for plain in model.plain]
    state, s = stiffening_path(model), model.compliance
    at = s * (state.linear + field)
    small = linear(state.linear)
    more = finite(at) - s * small
    tangent = neo_hookean_tangent(poisson_ratio=model.poisson_ratio)
    problem = AddedStress(
        linear=-state.response(small),
        added_force=lambda moved: model.pieces.tangent_forces(at, moved, tangent) + more,
        response=state.response,
        compliance=s,
        stiffer=np.ones(len(at)),
        skin=model.mesh.outer_nodes,
    )
    change = problem.beyond_linear(
        start=None, together=False, tolerance_mm=CLOSE_MM / amount, rounds=MOST_ROUNDS
    )
    return state.at_markers(change)


def in_proportion(response: Fields, plain: Fields, first: Fields, finite: Fields) -> Fields:
    """A response of the small-strain law with its change by large deformation.

    That grows as the change itself does along the `first` one of a unit amount: exact for small amounts, and
    bounded where the law's own change is.
    """
    along = sum(float(np.vdot(c - c0, c1)) for c, c0, c1 in zip(response, plain, first, strict=True))
    size = sum(float(np.vdot(c1, c1)) for c1 in first)
    share = along / size if size > 0 else 0.0
    return [c + share * more for c, more in zip(response, finite, strict=True)]
