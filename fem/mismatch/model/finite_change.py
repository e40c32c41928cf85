"""Change of an effect's linear response by large deformation of the flesh.

With an amount a of an effect, the scaled displacement w = u / s of the flesh solves

    F(w) + a D(w) = f,        F: Neo-Hookean, D: the effect's own forces, both at finite strain

At a = 0 the derivative of w with respect to a solves K_T w' = -D(w), K_T the tangent at large deformation.
At small strain it is w0' = -K0^-1 D0 w0, with D0 the linear part of D and w0 = K0^-1 f. Their difference is
of second and third degree in the forces, like large deformation itself, and the same frames predict it. The
factor of K0 solves for it as for any law that adds stress: K_T - K0 adds w' - w0' to the linear field w0'
(fem.solid.initial_stress).
"""

from collections.abc import Callable, Hashable

import numpy as np

from fem.fem_failure import FemFailure
from fem.materials.fung_neo_hookean import neo_hookean_tangent
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.plain_model import Fields
from fem.mismatch.model.reduced_law import Operator
from fem.mismatch.model.stress_history import MOST_ROUNDS, neo_hookean_field, path_state, stiffening_path
from fem.solid.initial_stress import AddedStress

CLOSE_MM = 2e-3
"""Iterations stop when a usual amount moves no node of the skin by more than this. Set by hand: with 0.6 um
the residuals of `benchmarks/effects_at_truth.py` differ by 0.2 um at most."""
FRAMES = 12
"""Frames of all recordings together; each has at least LEAST_FRAMES (fem.mismatch.model.stress_history). Set
by hand on one external case of four recordings: against 24 frames, the change of a usual skin (47 um) differs
by 1.5 um. Those of other effects (1 to 10 um) differ by 0.3 um at most. With both,
`benchmarks/effects_at_truth.py` gives residuals within 0.1 um."""


def finite_change(
    model: CaseModel, key: Hashable, operators: Callable[[], tuple[Operator, Operator]], *, amount: float
) -> Fields:
    """w' - w0' at the markers of every recording, mm MPa per unit of the amount.

    `operators`: D and D0, from displacements in mm to the nodal forces of a unit amount. `amount`: a usual
    one. The change is solved for once per `key`; at another 1/E it is scaled in proportion, since it is
    mostly of second degree in the forces. It is zero if the plain model has no large deformation. Raises
    FemFailure (NOT_CONVERGED).
    """
    if not model.beyond_small_strain:
        return [np.zeros_like(plain) for plain in model.plain]
    compliance, change = model.memoised(("finite change", key), lambda: _solved(model, operators, amount))
    if isinstance(change, FemFailure):
        raise change
    return [model.compliance / compliance * field for field in change]


def _solved(
    model: CaseModel, operators: Callable[[], tuple[Operator, Operator]], amount: float
) -> tuple[float, Fields | FemFailure]:
    """The 1/E of the solve, and the change or the failure of the solve."""
    s, field = model.compliance, neo_hookean_field(model)
    if isinstance(field, FemFailure):
        return s, [np.zeros_like(plain) for plain in model.plain]
    state, (finite, linear) = path_state(model, frames=FRAMES, remembers=False), operators()
    at = s * (state.linear + field[state.among(stiffening_path(model))])
    law = neo_hookean_tangent(poisson_ratio=model.poisson_ratio)
    tangent = model.memoised(("tangent", FRAMES, s), lambda: model.pieces.tangent(at, law))
    small = linear(state.linear)
    more = finite(at) - s * small
    problem = AddedStress(
        linear=-state.response(small),
        added_force=lambda moved: tangent(moved) + more,
        response=state.response,
        compliance=s,
        stiffer=np.ones(len(at)),
        skin=model.mesh.outer_nodes,
    )
    try:
        change = problem.beyond_linear(
            start=None, together=False, tolerance_mm=CLOSE_MM / amount, rounds=MOST_ROUNDS
        )
    except FemFailure as failure:
        return s, failure
    return s, state.at_markers(change)


def in_proportion(response: Fields, plain: Fields, first: Fields, finite: Fields) -> Fields:
    """A response of the small-strain law with its change by large deformation.

    The finite change is scaled by the projection of the small-strain change on `first`, over all recordings
    and markers. This is exact for small amounts, and bounded where the law's own change is.
    """
    along = sum(float(np.vdot(c - c0, c1)) for c, c0, c1 in zip(response, plain, first, strict=True))
    size = sum(float(np.vdot(c1, c1)) for c1 in first)
    share = along / size if size > 0 else 0.0
    return [c + share * more for c, more in zip(response, finite, strict=True)]
