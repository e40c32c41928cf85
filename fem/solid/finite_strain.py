"""Displacement of the flesh under large deformation: equilibrium of a `UnitModulusSolid` under another law.

Stresses are proportional to E, so a fruit of modulus E under forces f moves like one of 1 MPa under f / E.

A free fruit is in equilibrium in its deformed shape: both derivatives of the potential
W(u) - f . u + alpha . B'u  vanish. So u has no mean translation and rotation over the flesh (B'u = 0, as in
fem.solid.linear_solid), and the six alpha define a smooth body force B alpha. Here it balances force and
moment of the loads at the points to which these have moved. The linear solid is the limit of small loads. The
pit may rotate by any angle.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from fem.cached_value import cached_value
from fem.fem_failure import FemFailure, FemProblem
from fem.materials.law import UnitLaw
from fem.solid.anderson import Anderson
from fem.solid.equilibrium import MEMORY, Ending, Tangent, equilibrium
from fem.solid.finite_strain_balance import FiniteBalance, FiniteState
from fem.solid.finite_strain_elements import FiniteFlesh
from fem.solid.linear_solid import UnitModulusSolid

TOLERANCE = 1e-7
"""Force residual over the load; displacements then have about the same relative error."""
ITERATIONS = 40
"""Most steps of Newton's method under one load; a solve that stalls ends earlier. Set by hand."""
SMALLEST_SHARE = 1 / 64
"""Least load step; a load that cannot be applied at once is applied in smaller and smaller steps."""
CHORDS = 15
"""Most chord steps of all loads together: half of fem.solid.equilibrium.PATIENCE. A load that needs more is
solved alone, where it may renew its tangent."""
FARTHER = 2.0
"""An accelerated step may increase the residual before later ones reduce it; above this many times the
smallest so far, the load is solved alone, with a line search. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class FiniteStrainSolid:
    """A factorised linear solid whose flesh has a law of finite strain with the same Poisson's ratio.

    `degree`: of the quadrature. Four points (degree 2) take half the time of fourteen.
    """

    solid: UnitModulusSolid
    law: UnitLaw
    degree: Literal[2, 5] = 5

    @cached_value
    def flesh(self) -> FiniteFlesh:
        """The elements."""
        return FiniteFlesh.of(self.solid.mesh, self.law, degree=self.degree)

    @cached_value
    def rest(self) -> FiniteBalance:
        """The balance without load, shared by loads."""
        return FiniteBalance.of(self.solid, self.flesh)

    def prepare(self) -> None:
        """Computes `flesh` and `rest`, which threads then share."""
        _ = self.rest.linear_tangent

    def displacement(
        self,
        nodal_force_over_E: Float[np.ndarray, "f n 3"],
        *,
        start: Float[np.ndarray, "f n 3"] | None = None,
        tolerance: float = TOLERANCE,
    ) -> Float[np.ndarray, "f n 3"]:
        """The displacement under each of f loads: dead forces on the nodes, N per MPa of the modulus.

        The iteration starts at `start`, or at the linear displacement: chord steps of all loads at once, with
        the linear factor. A load that these do not balance is solved alone, in smaller load steps if needed.
        Raises FemFailure: BAD_LOAD like the solid, NOT_CONVERGED with the first load that is not balanced and
        the share of it that is.
        """
        first = self.solid.displacement(nodal_force_over_E) if start is None else start
        at_once = self._together(nodal_force_over_E, first, tolerance=tolerance)
        states = []
        for k, (load, state) in enumerate(zip(nodal_force_over_E, at_once, strict=True)):
            if state is None:
                state, share, ending = self._stepwise(load, first[k], tolerance=tolerance)
                if share < 1:
                    raise FemFailure(
                        FemProblem.NOT_CONVERGED,
                        f"The nonlinear solve reached only {share:.0%} of load {k + 1} of "
                        f"{len(at_once)} ({ending.value}). Check forces and modulus, or use a "
                        "finer mesh where the load acts",
                    )
            states.append(state.displacement_mm)
        return np.stack(states)

    def _together(
        self,
        loads: Float[np.ndarray, "f n 3"],
        first: Float[np.ndarray, "f n 3"],
        *,
        tolerance: float,
    ) -> list[FiniteState | None]:
        """All loads by accelerated chord steps with the linear factor; None for a load whose residual grows
        (FARTHER), or that CHORDS steps do not balance.
        """
        rest, solutions = self.rest, list[FiniteState | None]([None] * len(loads))
        open_ = {
            k: _Chord(rest.under(load), rest.admissible(start))
            for k, (load, start) in enumerate(zip(loads, first, strict=True))
            if load.any()
        }
        for k in set(range(len(loads))) - set(open_):
            solutions[k] = rest.state(np.zeros_like(first[k]))
        for step in range(CHORDS + 1):
            for k, chord in list(open_.items()):
                size = chord.measured()
                if size <= tolerance:
                    solutions[k] = chord.state
                if size <= tolerance or not chord.comes_nearer:
                    del open_[k]
            if not open_ or step == CHORDS:
                break
            plain = rest.linear_tangent.solve(np.column_stack([chord.residual for chord in open_.values()]))
            for chord, correction in zip(open_.values(), plain.T, strict=True):
                chord.step(-correction)
        return solutions

    def _stepwise(
        self, load: Float[np.ndarray, "n 3"], first: Float[np.ndarray, "n 3"], *, tolerance: float
    ) -> tuple[FiniteState, float, Ending]:
        """The state under one load, applied at once or in steps, which are halved after a failure and doubled
        after a success; the share of the load that it balances, and how the last solve ended.
        """
        rest = self.rest
        tangent: Tangent = rest.linear_tangent
        last = rest.state(np.zeros_like(first))
        share, step, ending, guess = 0.0, 1.0, Ending.CONVERGED, rest.admissible(first)
        while share < 1:
            wanted = min(1.0, share + step)
            result = equilibrium(
                rest.under(wanted * load),
                guess,
                tolerance=tolerance,
                iterations=ITERATIONS,
                tangent=tangent,
            )
            ending = result.ending
            if ending is Ending.CONVERGED:
                moved_mm = result.state.displacement_mm - last.displacement_mm
                last = result.state
                tangent = result.tangent or rest.linear_tangent
                step = min(2 * step, 1 - wanted)
                # extrapolates the path so far
                ahead_mm = last.displacement_mm + step / (wanted - share) * moved_mm
                guess = rest.admissible(ahead_mm) if step > 0 else last
                share = wanted
            elif step / 2 < SMALLEST_SHARE:
                break
            else:
                step /= 2
                guess = rest.state(step * first) if share == 0 else last
        return last, share, ending


class _Chord:
    """The iteration of one load: its state, the residual there, and the acceleration by earlier steps."""

    def __init__(self, balance: FiniteBalance, state: FiniteState) -> None:
        self.balance, self.state = balance, state
        self.learnt, self.smallest, self.comes_nearer = Anderson(MEMORY), np.inf, True

    def measured(self) -> float:
        """The residual's size; `comes_nearer`: whether it is less than FARTHER times the smallest so far."""
        self.residual = self.balance.residual(self.state)
        size = self.balance.size(self.residual)
        self.comes_nearer, self.smallest = size < FARTHER * self.smallest, min(size, self.smallest)
        return size

    def step(self, plain: Float[np.ndarray, " d"]) -> None:
        """Takes the accelerated step in place of `plain`."""
        step = self.learnt.step(plain)
        self.state = self.balance.moved(self.state, step, 1.0)
        self.learnt.took(step)
