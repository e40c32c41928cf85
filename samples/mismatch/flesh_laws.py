"""What flesh does beyond the small-strain law: stiffens, yields, is damaged. Stress less the linear stress.

H is the displacement gradient (H_ik = du_i/dx_k), eps its symmetric part, mu and lam Lame's constants, W an
energy density. State is what a point of the flesh remembers.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from samples.sample_failure import NotInEquilibrium

State = tuple[np.ndarray, ...]


class FleshLaw(Protocol):
    """A law per point, with its constants `lame`."""

    @property
    def lame(self) -> "Lame":
        """Of the linear law that it tends to."""
        ...

    @property
    def objective(self) -> bool:
        """Whether a turn of the flesh is no strain to it; a law of small strain takes it for one."""
        ...

    def at_first(self, points: tuple[int, ...]) -> State:
        """The state of virgin flesh."""
        ...

    @property
    def still(self) -> bool:
        """Whether it does not depend on time."""
        ...

    def excess(
        self, H: Float[np.ndarray, "*p 3 3"], state: State, pause_s: float
    ) -> tuple[Float[np.ndarray, "*p 3 3"], State]:
        """Stress less that of the linear law, and the state `pause_s` after `state`."""
        ...


@dataclass(frozen=True, kw_only=True)
class Lame:
    """Lame's constants, MPa."""

    mu: float
    lam: float

    def linear(self, eps: Float[np.ndarray, "*p 3 3"]) -> Float[np.ndarray, "*p 3 3"]:
        """sigma = 2 mu eps + lam tr(eps) I."""
        trace = np.trace(eps, axis1=-2, axis2=-1)
        return np.asarray(2 * self.mu * eps + self.lam * trace[..., None, None] * np.eye(3))


@dataclass(frozen=True, kw_only=True)
class StiffeningFlesh:
    """P = exp(b W/mu) (mu (F - F^-T) + lam ln J F^-T), W = mu/2 (tr F'F - 3 - 2 ln J) + lam/2 ln^2 J.

    An exponential law as for soft tissue (Fung 1993, section 7.5) on the Neo-Hookean energy of Bonet and Wood
    2008, eq. 6.27.
    """

    lame: Lame
    b: float
    still: bool = True
    objective: bool = True

    def at_first(self, points: tuple[int, ...]) -> State:  # noqa: ARG002
        """Nothing is remembered."""
        return ()

    def excess(
        self, H: Float[np.ndarray, "*p 3 3"], state: State, pause_s: float  # noqa: ARG002
    ) -> tuple[Float[np.ndarray, "*p 3 3"], State]:  # fmt: skip
        """P less the linear stress."""
        mu, lam = self.lame.mu, self.lame.lam
        F = H + np.eye(3)
        J = np.linalg.det(F)
        if J.min() <= 0:
            raise NotInEquilibrium("a brick of the sample's flesh was turned inside out: press less")
        inverse_t = np.swapaxes(np.linalg.inv(F), -1, -2)
        ln = np.log(J)
        energy = mu / 2 * (np.einsum("...ik,...ik->...", F, F) - 3 - 2 * ln) + lam / 2 * ln**2
        P = mu * (F - inverse_t) + lam * ln[..., None, None] * inverse_t
        factor = np.exp(np.minimum(self.b * energy / mu, 30.0))
        return factor[..., None, None] * P - linear_stress(self.lame, H), state


@dataclass(frozen=True, kw_only=True)
class Yielding:
    """J2 plasticity, linear isotropic hardening, backward Euler (Simo and Hughes 1998, box 3.1).

    Yields where the von Mises stress exceeds yield_MPa + hardening_MPa times the plastic strain. State:
    plastic strain (tensor) and its equivalent so far.
    """

    lame: Lame
    yield_MPa: float
    hardening_MPa: float
    still: bool = True
    objective: bool = False

    def at_first(self, points: tuple[int, ...]) -> State:
        """No plastic strain."""
        return np.zeros((*points, 3, 3)), np.zeros(points)

    def excess(
        self, H: Float[np.ndarray, "*p 3 3"], state: State, pause_s: float  # noqa: ARG002
    ) -> tuple[Float[np.ndarray, "*p 3 3"], State]:  # fmt: skip
        """-2 mu times the plastic strain."""
        mu = self.lame.mu
        plastic, so_far = state
        elastic = _sym(H) - plastic
        deviator = elastic - np.trace(elastic, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
        trial = 2 * mu * np.sqrt(1.5 * np.einsum("...ik,...ik->...", deviator, deviator))
        over = trial - (self.yield_MPa + self.hardening_MPa * so_far)
        grown = np.maximum(over, 0.0) / (3 * mu + self.hardening_MPa)
        flow = 3 * mu * deviator / np.maximum(trial, 1e-12)[..., None, None]
        now = plastic + grown[..., None, None] * flow
        return -2 * mu * now, (now, so_far + grown)


@dataclass(frozen=True, kw_only=True)
class Damaged:
    """sigma = (1 - dmax (1 - exp(-Wmax/W0))) times the linear stress, Wmax the largest energy density so far.

    After Mullins (Ogden and Roxburgh 1999). State: Wmax.
    """

    lame: Lame
    dmax: float
    W0_MPa: float
    still: bool = True
    objective: bool = False

    def at_first(self, points: tuple[int, ...]) -> State:
        """Never strained."""
        return (np.zeros(points),)

    def excess(
        self, H: Float[np.ndarray, "*p 3 3"], state: State, pause_s: float  # noqa: ARG002
    ) -> tuple[Float[np.ndarray, "*p 3 3"], State]:  # fmt: skip
        """Minus the lost share of the linear stress."""
        eps = _sym(H)
        sigma = self.lame.linear(eps)
        energy = 0.5 * np.einsum("...ik,...ik->...", sigma, eps)
        largest = np.maximum(state[0], energy)
        lost = self.dmax * -np.expm1(-largest / self.W0_MPa)
        return -lost[..., None, None] * sigma, (largest,)


def linear_stress(lame: Lame, H: Float[np.ndarray, "*p 3 3"]) -> Float[np.ndarray, "*p 3 3"]:
    """The linear law's stress (MPa) of a displacement gradient."""
    return lame.linear(_sym(H))


def _sym(H: Float[np.ndarray, "*p 3 3"]) -> Float[np.ndarray, "*p 3 3"]:
    return np.asarray((H + np.swapaxes(H, -1, -2)) / 2)
