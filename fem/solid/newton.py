"""Newton's method for equilibrium, with a line search, and with a factor kept for as long as it serves.

Unknowns are displacements and, where something is held on average, multipliers; both come in one vector,
the `primal` ones first. A step solves  K step = -residual  with the tangent of the present state, or with a
factor of an earlier one (chord steps). Chord steps are sped up by what earlier steps have taught (Anderson,
"Iterative procedures for nonlinear integral equations", J. ACM 12, 1965), and the tangent is renewed only
where more than PATIENCE of them would still be needed.
"""

from collections import deque
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Generic, Protocol, TypeVar

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure

State = TypeVar("State")

PATIENCE = 30
"""A fresh factor costs about as much as this many residuals and solves."""
MEMORY = 6
"""Earlier steps that the next one learns from."""
OVERSHOOT = 0.5
"""A step has gone too far where the forces along it have turned round to more than this share of before."""
SHORTEST = 1e-4
"""Share of a step below which the line search gives up."""


class Tangent(Protocol):
    """A factorised linearisation."""

    def solve(self, residual: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
        """K^-1 residual."""
        ...


class Balance(Protocol[State]):
    """A problem of equilibrium: residual, tangent, and how a state is moved by a step."""

    @property
    def primal(self) -> int:
        """How many of the unknowns are displacements; the multipliers come after them."""
        ...

    def residual(self, state: State) -> Float[np.ndarray, " d"]:
        """Forces out of balance; NaN where the state is none that matter can take."""
        ...

    def size(self, residual: Float[np.ndarray, " d"]) -> float:
        """A norm of the residual, as a share of the load."""
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
    STALLED = "no step brings the forces closer to balance"
    TOO_MANY = "still out of balance after the last allowed iteration"


@dataclass(frozen=True, kw_only=True)
class NewtonResult(Generic[State]):
    """The state that was reached, and how.

    `sizes`: the residual's size before each step and at the end; `shares`: how much of each step was taken.
    `tangent`: the last one in use, None where the next step would have renewed it; `tangents` counts those
    made.
    """

    state: State
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
    tangent: Tangent | None = None,
) -> NewtonResult[State]:
    """The state near `start` whose residual is at most `tolerance` in size.

    With `tangent` given, chord steps start from it; without, every step has a tangent of its own.
    """
    chord, renewed = tangent is not None, 0
    state, residual = start, balance.residual(start)
    sizes, shares = [balance.size(residual)], list[float]()
    learnt = _Learnt()
    ending = Ending.TOO_MANY
    while len(shares) < iterations:
        if sizes[-1] <= tolerance:
            ending = Ending.CONVERGED
            break
        if tangent is None:
            try:
                tangent = balance.tangent(state)
            except FemFailure:
                ending = Ending.STALLED
                break
            renewed, learnt = renewed + 1, _Learnt()
            fresh = True
        else:
            fresh = False
        plain = -tangent.solve(residual)
        found = _searched(balance, state, learnt.step(plain), sizes[-1])
        if found is None:
            learnt = _Learnt()
            found = _searched(balance, state, plain, sizes[-1])
        if found is None and not fresh:
            tangent = None
            continue
        if found is None:
            ending = Ending.STALLED
            break
        state, residual, step, share = found
        learnt.add(plain, step if share == 1.0 else None)
        sizes.append(balance.size(residual))
        shares.append(share)
        if not chord or _is_slow(sizes[-1 - len(learnt.plain) :], tolerance):
            tangent = None
    else:
        if sizes[-1] <= tolerance:
            ending = Ending.CONVERGED
    return NewtonResult(
        state=state,
        ending=ending,
        sizes=tuple(sizes),
        shares=tuple(shares),
        tangent=tangent,
        tangents=renewed,
    )


def _searched(
    balance: Balance[State], state: State, step: Float[np.ndarray, " d"], size: float
) -> tuple[State, Float[np.ndarray, " d"], Float[np.ndarray, " d"], float] | None:
    """State, residual, step and share after a line search; None where no share of the step is any good.

    The slope of the potential along the step is step . residual, the multipliers new. It must start below
    zero; where it has risen to more than OVERSHOOT of its start, or matter is turned inside out, the step is
    too long and is shortened, by the secant of the slope where there is one (Matthies and Strang, Int. J.
    Num. Meth. Eng. 14, 1979, section 3). A step that brings the residual down is good anyhow.
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


class _Learnt:
    """The last steps, and what a plain chord step would have been before and after each."""

    def __init__(self) -> None:
        self.plain: deque[Float[np.ndarray, " d"]] = deque(maxlen=MEMORY)
        self.taken: deque[Float[np.ndarray, " d"]] = deque(maxlen=MEMORY)

    def step(self, plain: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
        """The plain step, less what of it the steps taken are known to account for."""
        if not self.taken:
            return plain
        series = [*self.plain, plain]
        change = np.stack([b - a for a, b in pairwise(series)], axis=1)
        weight = np.linalg.lstsq(change, plain, rcond=1e-10)[0]
        return np.asarray(plain - (change + np.stack(self.taken, axis=1)) @ weight)

    def add(self, plain: Float[np.ndarray, " d"], taken: Float[np.ndarray, " d"] | None) -> None:
        """Remember a step that was taken in full; one that was cut short teaches nothing."""
        if taken is None:
            self.plain.clear()
            self.taken.clear()
        else:
            self.plain.append(plain)
            self.taken.append(taken)


def _is_slow(sizes: list[float], tolerance: float) -> bool:
    """Whether, at the rate of these steps, more than PATIENCE are still to come."""
    if len(sizes) < 4 or sizes[-1] <= tolerance:
        return False
    rate = np.log(sizes[-1] / sizes[-4]) / 3
    return bool(rate > np.log(tolerance / sizes[-1]) / PATIENCE)
