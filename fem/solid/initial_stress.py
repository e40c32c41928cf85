"""Flesh under a law that adds stress to the linear one, in many frames at once, by the linear factor alone.

    K0 v + B' d(s v) / s = L f,        v = u / s,  s = 1 / E

d: the stress (for E = 1 MPa) that the law adds to the linear one, a function of the strain of all frames so
far. With v0 the linear displacement and w = v - v0, multiplication by K0^-1 gives

    r(w) = w + K0^-1 B' d(s (v0 + w)) / s = 0

and a step  -r / k  uses the tangent k K0. In each frame k is half of the largest stiffness over the linear
one, and 1 for a law that softens; a smaller k overshoots. A law that depends on the path has no potential,
and its own tangents would cost a factorisation per frame, so the first one is kept.
Source: Kachanov's method of variable elasticity parameters with the initial stiffness; initial stress in
Zienkiewicz, Valliappan and King, Int. J. Num. Meth. Eng. 1, 1969.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fem.fem_failure import FemFailure, FemProblem
from fem.solid.anderson import Anderson

MEMORY = 4
"""Earlier rounds that accelerate the next one: each is a field of all frames (tens of MB). Set by hand."""
RUN_AWAY = 1e6
"""N per MPa of the modulus: force on a node that means divergence."""

Fields = Float[np.ndarray, "f n 3"]


def bounded(force: Fields, compliance: float) -> Fields:
    """Nodal forces of the stress that a law adds; raises FemFailure (NOT_CONVERGED) beyond RUN_AWAY."""
    if not np.abs(force).max() < RUN_AWAY:
        raise FemFailure(
            FemProblem.NOT_CONVERGED,
            f"The nonlinear solve of how flesh of {1 / compliance:.3g} MPa moves by this law did not "
            "converge. Check the forces",
        )
    return force


@dataclass(frozen=True, kw_only=True)
class AddedStress:
    """The problem; w is in mm MPa, in all frames.

    `linear`: v0. `added_force`: nodal forces B' d of displacements in mm, in all frames. `response`: K0^-1 of
    nodal forces. `stiffer`: each frame's largest tangent stiffness over the linear one. `skin`: nodes at
    which steps are measured, as only their motion is observed.
    """

    linear: Fields
    added_force: Callable[[Fields], Fields]
    response: Callable[[Fields], Fields]
    compliance: float
    stiffer: Float[np.ndarray, " f"]
    skin: Int[np.ndarray, " o"]

    def residual(self, state: Fields) -> Fields:
        """r(w). Raises FemFailure (NOT_CONVERGED) if the added stress diverges."""
        force = bounded(self.added_force(self.compliance * (self.linear + state)), self.compliance)
        return np.asarray(state + self.response(force) / self.compliance)

    def beyond_linear(
        self, *, start: Fields | None, together: bool, tolerance_mm: float, rounds: int
    ) -> Fields:
        """w, from a guess of it (None: zero), when the residual on the skin is at most `tolerance_mm`.

        `together`: all frames share one mix of earlier steps; if stress depends on earlier frames, a mix for
        each would be inconsistent in the later ones. Raises FemFailure (NOT_CONVERGED) if the iteration
        diverges or needs more than so many rounds, each an evaluation of the law.
        """

        def seen(step: Fields) -> Float[np.ndarray, "g x"]:
            return step[:, self.skin].reshape(1 if together else len(step), -1)

        learnt = Anderson(MEMORY, weighed=seen)
        slower = np.maximum(self.stiffer / 2, 1.0)[:, None, None]
        w = np.zeros_like(self.linear) if start is None else start
        for _ in range(rounds):
            residual = self.residual(w)
            left_mm = self.compliance * float(np.abs(residual[:, self.skin]).max())
            plain = -residual / slower
            if left_mm <= tolerance_mm:
                return np.asarray(w + plain)
            step = learnt.step(plain)
            learnt.took(step)
            w = w + step
        raise FemFailure(
            FemProblem.NOT_CONVERGED,
            f"The search for how flesh of {1 / self.compliance:.3g} MPa moves by this law did not "
            f"converge. The skin still moves by {1e3 * left_mm:.2g} µm after {rounds} rounds, "
            f"expected at most {1e3 * tolerance_mm:.2g} µm. Check the forces",
        )
