"""Equilibrium by steps  K step = -residual, for every law of the flesh.

Chord steps keep the first factor (initial stress), or renew it where more than PATIENCE of them would still
be needed. Steps with the same tangent are accelerated (fem.solid.anderson). Where the forces derive from a
potential, a line search along it guards every step.

Unknowns are displacements and, where something is held on average, multipliers; both come in one vector,
the `primal` ones first.
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
"""Earlier steps that the next one learns from. Measured on a deep load of 23 steps (nu 0.49,
tolerance 1e-7): 10 save two steps; with 2 a new tangent is needed."""
OVERSHOOT = 0.5
"""A step has gone too far where the forces along it have turned round to more than this share of before."""
SHORTEST = 1e-4
"""Share of a step below which the line search gives up."""


class Tangent(Protocol):
    """A factorised linearisation."""

    def solve(self, residual: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """K^-1 residual."""
        ...


class Balance(Protocol[State]):
    """A problem of equilibrium: residual, tangent, and how a state is moved by a step."""

    @property
    def has_potential(self) -> bool:
        """Whether the residual is the slope of a potential, along which steps are then searched; where it is
        not, every step is taken in full."""
        ...

    @property
    def primal(self) -> int:
        """How many of the unknowns are displacements; the multipliers come after them."""
        ...

    def residual(self, state: State) -> Float[np.ndarray, "*d"]:
        """Forces out of balance; NaN where the state is none that matter can take. Raises FemFailure where
        the search has run away."""
        ...

    def size(self, residual: Float[np.ndarray, "*d"]) -> float:
        """A norm of the residual, in the unit of the tolerance."""
        ...

    def moved(self, state: State, step: Float[np.ndarray, "*d"], share: float) -> State:
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


@dataclass(frozen=True, kw_only=True)
class EquilibriumResult(Generic[State]):
    """The state that was reached, with its `residual`, and how.

    `sizes`: the residual's size before each step and at the end; `shares`: how much of each step was taken.
    `tangent`: the last one in use, None where the next step would have renewed it; `tangents` counts those
    made.
    """

    state: State
    residual: Float[np.ndarray, "*d"]
    ending: Ending
    sizes: tuple[float, ...]
    shares: tuple[float, ...]
    tangent: Tangent | None
    tangents: int


def equilibrium(
    balance: Balance[State],
    start: State,
    *,
    tolerance: float,
    iterations: int,
    renews: bool,
    tangent: Tangent | None = None,
    acceleration: Anderson | None = None,
) -> EquilibriumResult[State]:
    """The state near `start` with a residual of `tolerance` at most, or the last of `iterations` steps.

    The first tangent is `tangent`, or where none is given that of the start; `renews`: it is made anew where
    it no longer serves. `acceleration`: None for one of
    MEMORY steps with all unknowns in one group. Raises what the residual raises.
    """
    learnt = Anderson(MEMORY) if acceleration is None else acceleration
    learnt.forget()
    state, residual = start, balance.residual(start)
    sizes, shares = [balance.size(residual)], list[float]()
    made, in_full = 0, 0
    ending = Ending.TOO_MANY
    while len(shares) < iterations:
        if sizes[-1] <= tolerance:
            ending = Ending.CONVERGED
            break
        fresh = tangent is None
        if tangent is None:
            try:
                tangent = balance.tangent(state)
            except FemFailure:
                ending = Ending.STALLED
                break
            made, in_full = made + 1, 0
            learnt.forget()
        plain = -tangent.solve(residual)
        change = _moved(balance, state, learnt.step(plain), sizes[-1])
        if change is None:
            learnt.forget()
            in_full = 0
            change = _moved(balance, state, learnt.step(plain), sizes[-1])
        if change is None and not fresh and renews:
            tangent = None
            continue
        if change is None:
            ending = Ending.STALLED
            break
        state, residual, step, share = change
        if share == 1.0:
            learnt.took(step)
            in_full += 1
        else:
            learnt.forget()
            in_full = 0
        sizes.append(balance.size(residual))
        shares.append(share)
        if renews and _is_slow(sizes[-1 - in_full :], tolerance):
            tangent = None
    else:
        if sizes[-1] <= tolerance:
            ending = Ending.CONVERGED
    return EquilibriumResult(
        state=state,
        residual=residual,
        ending=ending,
        sizes=tuple(sizes),
        shares=tuple(shares),
        tangent=tangent,
        tangents=made,
    )


def _moved(
    balance: Balance[State], state: State, step: Float[np.ndarray, "*d"], size: float
) -> tuple[State, Float[np.ndarray, "*d"], Float[np.ndarray, "*d"], float] | None:
    """State, residual, step and share after the step, searched along the potential where there is one."""
    if balance.has_potential:
        return _searched(balance, state, step, size)
    there = balance.moved(state, step, 1.0)
    return there, balance.residual(there), step, 1.0


def _searched(
    balance: Balance[State], state: State, step: Float[np.ndarray, "*d"], size: float
) -> tuple[State, Float[np.ndarray, "*d"], Float[np.ndarray, "*d"], float] | None:
    """State, residual, step and share after a line search; None where no share of the step is any good.

    The slope of the potential along the step is step . residual, the multipliers new. It must start below
    zero; where it has risen to more than OVERSHOOT of its start, or matter is turned inside out, the step is
    too long and is shortened, by the secant of the slope where there is one (Matthies and Strang, Int. J.
    Num. Meth. Eng. 14, 1979, section 3). A step that brings the residual down is good anyhow.
    """
    n = balance.primal

    def slope(at: State) -> tuple[float, Float[np.ndarray, "*d"]]:
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
    """Whether, at the rate of these steps, more than PATIENCE are still to come."""
    if len(sizes) < 4 or sizes[-1] <= tolerance:
        return False
    rate = np.log(sizes[-1] / sizes[-4]) / 3
    return bool(rate > np.log(tolerance / sizes[-1]) / PATIENCE)
