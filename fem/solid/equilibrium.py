"""Equilibrium by steps  K step = -residual  where the forces derive from a potential.

Chord steps keep the factor; it is renewed if more than PATIENCE of them would still be needed. Steps with the
same tangent are accelerated (fem.solid.anderson). A line search along the potential guards every step.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, Protocol, TypeVar

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure
from fem.solid.anderson import Anderson

State = TypeVar("State")

PATIENCE = 30
"""A fresh factor costs about as much as this many residuals and solves."""
MEMORY = 6
"""Earlier steps that accelerate the next one. Measured on a deep load of 23 steps (nu 0.49,
tolerance 1e-7): 10 save two steps; with 2 a new tangent is needed."""
OVERSHOOT = 0.5
"""A step is too long if the force along it has reversed to more than this share of its start."""
SHORTEST = 1e-4
"""Share of a step below which the line search gives up."""


class Tangent(Protocol):
    """A factorised linearisation."""

    def solve(self, residual: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
        """K^-1 residual."""
        ...


class Balance(Protocol[State]):
    """A problem of equilibrium whose residual is the slope of a potential.

    `primal`: how many of the unknowns are displacements; the multipliers come after them.
    """

    @property
    def primal(self) -> int: ...  # noqa: D102

    def residual(self, state: State) -> Float[np.ndarray, " d"]:
        """Residual forces; NaN if the state has an element with a volume of zero or below."""
        ...

    def size(self, residual: Float[np.ndarray, " d"]) -> float:
        """A norm of the residual, in the unit of the tolerance."""
        ...

    def moved(self, state: State, step: Float[np.ndarray, " d"], share: float) -> State:
        """The state with `share` of the step's displacements and all of its multipliers added."""
        ...

    def tangent(self, state: State) -> Tangent:
        """The factorised linearisation there; raises FemFailure where it is singular."""
        ...


class Ending(StrEnum):
    """How a search for equilibrium ended, as a sentence."""

    CONVERGED = "in equilibrium"
    STALLED = "no step reduces the force residual"
    TOO_MANY = "the forces are not in balance after the last iteration"


@dataclass(frozen=True)
class EquilibriumResult(Generic[State]):
    """The state that was reached, and how; `tangent`: the last one, None if the next step renews it."""

    state: State
    ending: Ending
    tangent: Tangent | None


def equilibrium(
    balance: Balance[State],
    start: State,
    *,
    tolerance: float,
    iterations: int,
    tangent: Tangent | None = None,
) -> EquilibriumResult[State]:
    """The state near `start` with a residual of `tolerance` at most, or the last of `iterations` steps.

    The first tangent is `tangent` (default: that of the start).
    """
    learnt = Anderson(MEMORY)
    state, residual = start, balance.residual(start)
    sizes, steps = [balance.size(residual)], 0  # since the last new tangent or partial step
    while not sizes[-1] <= tolerance:
        if steps == iterations:
            return EquilibriumResult(state, Ending.TOO_MANY, tangent)
        fresh = tangent is None
        if tangent is None:
            try:
                tangent = balance.tangent(state)
            except FemFailure:
                return EquilibriumResult(state, Ending.STALLED, tangent)
            sizes = sizes[-1:]
            learnt.forget()
        plain = -tangent.solve(residual)
        change = _searched(balance, state, learnt.step(plain), sizes[-1])
        if change is None:
            learnt.forget()
            sizes = sizes[-1:]
            change = _searched(balance, state, learnt.step(plain), sizes[-1])
        if change is None:
            if fresh:
                return EquilibriumResult(state, Ending.STALLED, tangent)
            tangent = None
            continue
        state, residual, step, share = change
        steps += 1
        if share == 1.0:
            learnt.took(step)
        else:
            learnt.forget()
            sizes = []
        sizes.append(balance.size(residual))
        if _is_slow(sizes, tolerance):
            tangent = None
    return EquilibriumResult(state, Ending.CONVERGED, tangent)


def _searched(
    balance: Balance[State], state: State, step: Float[np.ndarray, " d"], size: float
) -> tuple[State, Float[np.ndarray, " d"], Float[np.ndarray, " d"], float] | None:
    """State, residual, step and share after a line search; None if no share of the step is acceptable.

    The slope of the potential along the step is step . residual, with the new multipliers. It must be
    negative at the start. If it rises to more than OVERSHOOT of its start, or an element is inverted, the
    step is too long and is shortened, if possible by the secant of the slope (Matthies and Strang, Int. J.
    Num. Meth. Eng. 14, 1979, section 3). A step that reduces the residual is always acceptable.
    """
    n = balance.primal

    def slope(at: State) -> tuple[float, Float[np.ndarray, " d"]]:
        residual = balance.residual(at)
        return float(step[:n] @ residual[:n]), residual

    share, start = 1.0, None
    while share > SHORTEST:
        there = balance.moved(state, step, share)
        here, residual = slope(there)
        if np.isfinite(here) and balance.size(residual) < size:
            return there, residual, step, share
        if start is None:
            start = slope(balance.moved(state, step, 0.0))[0]
            if not start < 0:
                return None
        if not np.isfinite(here):
            share *= 0.4
        elif here > OVERSHOOT * abs(start):
            share *= float(np.clip(start / (start - here), 0.1, 0.5))
        else:
            return there, residual, step, share
    return None


def _is_slow(sizes: list[float], tolerance: float) -> bool:
    """Whether convergence at the rate of these steps needs more than PATIENCE steps."""
    if len(sizes) < 4 or sizes[-1] <= tolerance:
        return False
    rate = np.log(sizes[-1] / sizes[-4]) / 3
    return bool(rate > np.log(tolerance / sizes[-1]) / PATIENCE)
