"""Displacement of the flesh under large deformation: equilibrium of a `UnitModulusSolid` under another law.

Since every stress grows with E, a fruit of modulus E under forces f moves like one of 1 MPa under f / E.

A free fruit is in balance in its deformed shape: of the potential  W(u) - f . u + alpha . B'u  both
derivatives vanish, so that u has no mean translation and rotation over the flesh (B'u = 0, as in
`FreeBody.without_rigid_motion`) and the six alpha are a smooth body force B alpha (`FreeBody.balance`), here
one that balances force and moment where the loads have moved to. The linear solid is the limit of small
loads. The pit turns by any angle (fem.solid.finite_rotation).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from fem.cached_value import cached_value
from fem.fem_failure import FemFailure, FemProblem
from fem.materials.law import UnitLaw
from fem.solid.anderson import Anderson
from fem.solid.equilibrium import MEMORY, Ending, Tangent, Tangents, equilibrium
from fem.solid.finite_strain_balance import FiniteBalance, FiniteState
from fem.solid.finite_strain_elements import FiniteFlesh
from fem.solid.linear_solid import UnitModulusSolid

TOLERANCE = 1e-7
"""Forces out of balance, as a share of the load; displacements are then exact to about as much."""
ITERATIONS = 40
"""Steps of Newton's method under one load at most; hopeless ones are given up before. Set by hand."""
SMALLEST_SHARE = 1 / 64
"""The load is applied in smaller and smaller steps where it cannot be at once; below this one we stop."""
CHORDS = 15
"""Chord steps that all loads take together at most: half of fem.solid.equilibrium.PATIENCE. A load that needs
more is taken alone, where it may renew its tangent."""
FARTHER = 2.0
"""An accelerated step may make the residual larger before later ones make it smaller; beyond this many times
the smallest so far the load is taken alone, with a line search. Set by hand."""
SIMILAR = 0.9
"""Cosine between two loads from which on one's difference from the linear answer predicts the other's."""


@dataclass(frozen=True, kw_only=True)
class FiniteResult:
    """Displacements under f loads, and how the search for each ended.

    `displacement`: in mm, of a fruit of modulus E under E times the loads given. `share`: how much of each
    load it balances; below one where the search stopped, and this is the last displacement in balance.
    `out_of_balance`: the residual left, as a share of the load (2-norm over the unknowns).
    """

    displacement: Float[np.ndarray, "f n 3"]
    share: Float[np.ndarray, " f"]
    ending: tuple[Ending, ...]
    iterations: tuple[int, ...]
    tangents: tuple[int, ...]
    out_of_balance: Float[np.ndarray, " f"]

    def require_equilibrium(self) -> "FiniteResult":
        """This result; raises NOT_CONVERGED with the first load that is not balanced."""
        for k in np.flatnonzero(self.share < 1):
            raise FemFailure(
                FemProblem.NOT_CONVERGED,
                f"The nonlinear solve reached only {self.share[k]:.0%} of load {k + 1} of "
                f"{len(self.share)} ({self.ending[k].value}). Check forces and modulus, or use a "
                "finer mesh where the load acts",
            )
        return self


@dataclass(frozen=True, kw_only=True)
class FiniteStrainSolid:
    """A factorised linear solid, its flesh under a law of finite strain.

    `degree`: of the quadrature. Four points (degree 2) take half the time of fourteen.
    """

    solid: UnitModulusSolid
    law: UnitLaw
    degree: Literal[2, 5] = 5

    def __post_init__(self) -> None:
        if self.law.poisson_ratio != self.solid.poisson_ratio:
            raise FemFailure(
                FemProblem.BAD_POISSON_RATIO,
                f"the law has Poisson's ratio {self.law.poisson_ratio:g}, but the factorised solid "
                f"has {self.solid.poisson_ratio:g}; both must be equal",
            )

    @cached_value
    def flesh(self) -> FiniteFlesh:
        """The elements."""
        return FiniteFlesh.of(self.solid.mesh, self.law, degree=self.degree)

    @cached_value
    def rest(self) -> FiniteBalance:
        """Without load: all that every load shares, and the linear tangent."""
        return FiniteBalance.of(self.solid, self.flesh)

    def prepare(self) -> None:
        """Computes `flesh` and `rest`, which threads then share."""
        _ = self.rest

    def displacement(
        self,
        nodal_force_over_E: Float[np.ndarray, "f n 3"],
        *,
        start: Float[np.ndarray, "f n 3"] | None = None,
        tolerance: float = TOLERANCE,
        together: bool = False,
    ) -> FiniteResult:
        """The displacement under each of f loads: dead forces on the nodes, N per MPa of the modulus.

        Each search starts from `start`, or from the linear answer plus what the load before, if it was alike,
        has shown to lie beyond it. Chord steps with the linear factor go on as long as they serve.
        `together`: chord steps of all loads at once first, from `start` or the linear answer; only a load
        that they do not balance is searched for by itself. A load that is not balanced at once is applied in
        smaller steps; the result then holds the last displacement in balance (`share` < 1). Raises BAD_LOAD
        like the solid.
        """
        linear = self.solid.displacement(nodal_force_over_E) if start is None else start
        at_once: list[_Loaded | None] = [None] * len(linear)
        if together:
            at_once = self._together(nodal_force_over_E, linear, tolerance=tolerance)
        solutions: list[_Loaded] = []
        for k, load in enumerate(nodal_force_over_E):
            balanced = at_once[k]
            if balanced is not None:
                solutions.append(balanced)
                continue
            last = solutions[-1] if solutions and _similar(nodal_force_over_E[k - 1], load) else None
            if start is not None:
                first = start[k]
            else:
                first = linear[k] if last is None else linear[k] + _predicted(linear, last, k)
            tangent = self.rest.linear_tangent if last is None else last.tangent
            solutions.append(self._loaded(load, first, tolerance=tolerance, tangent=tangent))
        return FiniteResult(
            displacement=np.stack([solution.displacement_mm for solution in solutions]),
            share=np.array([solution.share for solution in solutions]),
            ending=tuple(solution.ending for solution in solutions),
            iterations=tuple(solution.iterations for solution in solutions),
            tangents=tuple(solution.tangents for solution in solutions),
            out_of_balance=np.array([solution.out_of_balance for solution in solutions]),
        )

    def _together(
        self,
        loads: Float[np.ndarray, "f n 3"],
        first: Float[np.ndarray, "f n 3"],
        *,
        tolerance: float,
    ) -> "list[_Loaded | None]":
        """All loads by accelerated chord steps with the linear factor; None for one that a step leads away
        from balance (FARTHER), or that CHORDS steps do not bring to it.
        """
        rest, solutions = self.rest, list[_Loaded | None]([None] * len(loads))
        open_ = {
            k: _Chord(rest.under(load), rest.admissible(start))
            for k, (load, start) in enumerate(zip(loads, first, strict=True))
            if load.any()
        }
        for step in range(CHORDS + 1):
            for k, chord in list(open_.items()):
                size = chord.measured()
                if size <= tolerance:
                    solutions[k] = _Loaded(
                        displacement_mm=chord.state.displacement_mm,
                        share=1.0,
                        ending=Ending.CONVERGED,
                        iterations=step,
                        tangents=0,
                        out_of_balance=size,
                        tangent=rest.linear_tangent,
                    )
                if size <= tolerance or not chord.comes_nearer:
                    del open_[k]
            if not open_ or step == CHORDS:
                break
            plain = rest.linear_tangent.solve(np.column_stack([chord.residual for chord in open_.values()]))
            for chord, correction in zip(open_.values(), plain.T, strict=True):
                chord.step(-correction)
        return solutions

    def _loaded(
        self,
        load: Float[np.ndarray, "n 3"],
        first: Float[np.ndarray, "n 3"],
        *,
        tolerance: float,
        tangent: Tangent,
    ) -> "_Loaded":
        """One load, at once or in steps: halved where the search fails, doubled where it succeeds."""
        rest = self.rest
        last = rest.state(np.zeros_like(first))
        share, step, iterations, tangents, left = 0.0, 1.0, 0, 0, 0.0
        ending, guess = Ending.CONVERGED, rest.admissible(first)
        while share < 1 and load.any():
            wanted = min(1.0, share + step)
            result = equilibrium(
                rest.under(wanted * load),
                guess,
                tolerance=tolerance,
                iterations=ITERATIONS,
                tangents=Tangents.WHILE_THEY_SERVE,
                tangent=tangent,
            )
            iterations, tangents = iterations + len(result.shares), tangents + result.tangents
            ending = result.ending
            if ending is Ending.CONVERGED:
                before, last, left = last, result.state, result.sizes[-1]
                tangent = result.tangent or rest.linear_tangent
                step = min(2 * step, 1 - wanted)
                # straight on along the path so far
                guess = rest.between(before, last, 1 + step / (wanted - share)) if step > 0 else last
                share = wanted
            elif step / 2 < SMALLEST_SHARE:
                break
            else:
                step /= 2
                guess = rest.state(step * first) if share == 0 else last
        return _Loaded(
            displacement_mm=last.displacement_mm,
            share=share if load.any() else 1.0,
            ending=ending,
            iterations=iterations,
            tangents=tangents,
            out_of_balance=left,
            tangent=tangent,
        )


class _Chord:
    """One load on its way to balance: its state, the residual there, and what earlier steps have taught."""

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
        """Takes the accelerated step in the place of `plain`."""
        step = self.learnt.step(plain)
        self.state = self.balance.moved(self.state, step, 1.0)
        self.learnt.took(step)


@dataclass(frozen=True, kw_only=True)
class _Loaded:
    displacement_mm: Float[np.ndarray, "n 3"]
    share: float
    ending: Ending
    iterations: int
    tangents: int
    out_of_balance: float
    tangent: Tangent


def _similar(before: Float[np.ndarray, "n 3"], now: Float[np.ndarray, "n 3"]) -> bool:
    """Whether two loads act alike, though not equally strong."""
    sizes = float(np.linalg.norm(before)) * float(np.linalg.norm(now))
    return float((before * now).sum()) > SIMILAR * sizes


def _predicted(linear: Float[np.ndarray, "f n 3"], last: _Loaded, k: int) -> Float[np.ndarray, "n 3"]:
    """The difference from the linear answer, which grows with the square of a load that keeps its shape."""
    size = float(np.linalg.norm(linear[k])) / float(np.linalg.norm(linear[k - 1]))
    return np.asarray((last.displacement_mm - linear[k - 1]) * size**2 * (last.share == 1))
