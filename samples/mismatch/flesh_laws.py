"""Laws of flesh at finite strain: Neo-Hookean, stiffening, relaxation, drainage, damage and yield.

F = 1 + H is the deformation gradient, C = F'F, J = det F, E = (C - 1) / 2 Green's strain; mu and lam are
Lame's constants. Every law returns the first Piola stress P = F S. All start from one second Piola stress and
energy

    S = mu (1 - C^-1) + lam ln J C^-1 + axial mu E_zz (z z'),     W = mu/2 (tr C - 3 - 2 ln J) + lam/2 ln^2 J
                                                                      + axial mu/2 E_zz^2,

by Bonet and Wood 2008 (eq. 6.27, 6.28) for `axial` = 0, times the modulus' ratio at each point. `axial` adds
stiffness along the stem z. A rotation of the fruit causes no stress. State is a point's memory.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from samples.sample_failure import NotInEquilibrium

State = tuple[np.ndarray, ...]
Tensors = Float[np.ndarray, "*p 3 3"]


class FleshLaw(ABC):
    """A law per point. `still`: whether it is independent of time."""

    still: ClassVar[bool] = True

    def at_first(self, points: tuple[int, ...]) -> State:  # noqa: ARG002
        """The state of undeformed flesh; empty for a law without memory."""
        return ()

    @abstractmethod
    def stress(self, H: Tensors, state: State, pause_s: float) -> tuple[Tensors, State]:
        """First Piola stress (MPa), and the state `pause_s` after `state`. Raises NotInEquilibrium."""


@dataclass(frozen=True, kw_only=True)
class Lame:
    """Lame's constants, MPa."""

    mu: float
    lam: float

    @property
    def modulus(self) -> float:
        """Young's modulus, MPa."""
        return self.mu * (3 * self.lam + 2 * self.mu) / (self.lam + self.mu)


@dataclass(frozen=True, kw_only=True)
class PlainFlesh(FleshLaw):
    """P = F S. `ratio`: the modulus at each point over E; `axial`: added stiffness along z, over mu."""

    lame: Lame
    ratio: Float[np.ndarray, "*p"] | float = 1.0
    axial: float = 0.0

    def stress(self, H: Tensors, state: State, pause_s: float) -> tuple[Tensors, State]:  # noqa: ARG002
        """P = F S."""
        at = self.at(H)
        return at.F @ self.second(at), state

    def at(self, H: Tensors) -> "_Strained":
        """Strain measures of H for all laws. Raises NotInEquilibrium if an element is inverted."""
        F = H + np.eye(3)
        J = np.einsum("...i,...i->...", np.cross(F[..., 0], F[..., 1]), F[..., 2])
        if not J.min() > 0:
            raise NotInEquilibrium("a brick of the sample's flesh was turned inside out: press less")
        C = np.swapaxes(F, -1, -2) @ F
        return _Strained(F, C, _inverse(C), np.log(J))

    def second(self, at: "_Strained", ln: Float[np.ndarray, "*p"] | None = None) -> Tensors:
        """S; `ln` replaces ln J in its volumetric part."""
        mu, lam, ln = self.lame.mu, self.lame.lam, at.ln if ln is None else ln
        S = mu * np.eye(3) + (lam * ln - mu)[..., None, None] * at.inverse
        if self.axial:
            S[..., 2, 2] += self.axial * mu * (at.C[..., 2, 2] - 1) / 2
        return np.asarray(np.asarray(self.ratio)[..., None, None] * S)

    def energy(self, at: "_Strained") -> Float[np.ndarray, "*p"]:
        """W, MPa."""
        mu, lam = self.lame.mu, self.lame.lam
        W = mu / 2 * (np.trace(at.C, axis1=-2, axis2=-1) - 3 - 2 * at.ln) + lam / 2 * at.ln**2
        return np.asarray(self.ratio * (W + self.axial * mu / 2 * ((at.C[..., 2, 2] - 1) / 2) ** 2))


@dataclass(frozen=True)
class _Strained:
    """F, C, its inverse, ln J."""

    F: Tensors
    C: Tensors
    inverse: Tensors
    ln: Float[np.ndarray, "*p"]


@dataclass(frozen=True, kw_only=True)
class StiffeningFlesh(FleshLaw):
    """P = exp(b W/mu) F S, an exponential law as for soft tissue (Fung 1993, section 7.5)."""

    plain: PlainFlesh
    b: float

    def stress(self, H: Tensors, state: State, pause_s: float) -> tuple[Tensors, State]:  # noqa: ARG002
        """The plain stress times a factor that grows with the energy, at most e^30."""
        at = self.plain.at(H)
        factor = np.exp(np.minimum(self.b * self.plain.energy(at) / self.plain.lame.mu, 30.0))
        return factor[..., None, None] * (at.F @ self.plain.second(at)), state


@dataclass(frozen=True, kw_only=True)
class Relaxing(FleshLaw):
    """P = F ((1 - g) S + h) with h' = g S' - h / tau (Simo and Hughes 1998, section 10.3). State: h, S.

    The update is exact for S linear in time over a step.
    """

    plain: PlainFlesh
    g: float
    tau_s: float
    still: ClassVar[bool] = False

    def at_first(self, points: tuple[int, ...]) -> State:
        """Relaxed and unstrained."""
        return np.zeros((*points, 3, 3)), np.zeros((*points, 3, 3))

    def stress(self, H: Tensors, state: State, pause_s: float) -> tuple[Tensors, State]:
        """The stress without its relaxed part."""
        at = self.plain.at(H)
        S = self.plain.second(at)
        h = _faded(state[0], self.g * (S - state[1]), pause_s / self.tau_s)
        return at.F @ ((1 - self.g) * S + h), (h, S)


@dataclass(frozen=True, kw_only=True)
class Draining(FleshLaw):
    """S with lam ((1 - s) ln J + s a) for lam ln J, a' = (ln J)' - a / tau. State: a, ln J.

    All flesh has one drainage time at any depth: poroelasticity without its length scale.
    """

    plain: PlainFlesh
    volume_share: float
    tau_s: float
    still: ClassVar[bool] = False

    def at_first(self, points: tuple[int, ...]) -> State:
        """Undrained and unstrained."""
        return np.zeros(points), np.zeros(points)

    def stress(self, H: Tensors, state: State, pause_s: float) -> tuple[Tensors, State]:
        """The stress without the drained part of the volumetric stress; ln J is linear over the step."""
        at = self.plain.at(H)
        left = _faded(state[0], at.ln - state[1], pause_s / self.tau_s)
        ln = (1 - self.volume_share) * at.ln + self.volume_share * left
        return at.F @ self.plain.second(at, ln), (left, at.ln)


@dataclass(frozen=True, kw_only=True)
class Damaged(FleshLaw):
    """P = (1 - dmax (1 - exp(-Wmax/W0))) F S; Wmax is the largest energy density so far.

    After Mullins (Ogden and Roxburgh 1999). State: Wmax.
    """

    plain: PlainFlesh
    dmax: float
    W0_MPa: float

    def at_first(self, points: tuple[int, ...]) -> State:
        """Undamaged."""
        return (np.zeros(points),)

    def stress(self, H: Tensors, state: State, pause_s: float) -> tuple[Tensors, State]:  # noqa: ARG002
        """The plain stress reduced by the damage."""
        at = self.plain.at(H)
        largest = np.maximum(state[0], self.plain.energy(at))
        left = 1 + self.dmax * np.expm1(-largest / self.W0_MPa)
        return left[..., None, None] * (at.F @ self.plain.second(at)), (largest,)


@dataclass(frozen=True, kw_only=True)
class Yielding(FleshLaw):
    """F = Fe Fp, the plain law for Fe; J2 flow, linear isotropic hardening, exponential map (Simo 1992).

    It flows if the equivalent Mandel stress Ce Se exceeds yield_MPa + hardening_MPa times the plastic strain.
    The flow of a step is that of small elastic strain (Simo and Hughes 1998, box 3.1), accurate to first
    order in the elastic strain. State: Fp less 1, and the equivalent plastic strain so far.
    """

    plain: PlainFlesh
    yield_MPa: float
    hardening_MPa: float

    def at_first(self, points: tuple[int, ...]) -> State:
        """No plastic strain."""
        return np.zeros((*points, 3, 3)), np.zeros(points)

    def stress(self, H: Tensors, state: State, pause_s: float) -> tuple[Tensors, State]:  # noqa: ARG002
        """P of the elastic part, pulled back to the reference shape."""
        F, plastic, so_far = H + np.eye(3), state[0] + np.eye(3), state[1]
        at = self.plain.at(F @ np.linalg.inv(plastic) - np.eye(3))
        mandel = at.C @ self.plain.second(at)
        deviator = mandel - np.trace(mandel, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
        deviator = (deviator + np.swapaxes(deviator, -1, -2)) / 2
        trial = np.sqrt(1.5 * np.einsum("...ik,...ik->...", deviator, deviator))
        over = np.maximum(trial - (self.yield_MPa + self.hardening_MPa * so_far), 0.0)
        grown = over / (3 * self.plain.ratio * self.plain.lame.mu + self.hardening_MPa)
        flow = (1.5 * grown / np.maximum(trial, 1e-12))[..., None, None] * deviator
        values, axes = np.linalg.eigh(flow)
        plastic = (axes * np.exp(values)[..., None, :]) @ np.swapaxes(axes, -1, -2) @ plastic
        inverse = np.linalg.inv(plastic)
        at = self.plain.at(F @ inverse - np.eye(3))
        P = at.F @ self.plain.second(at) @ np.swapaxes(inverse, -1, -2)
        return P, (plastic - np.eye(3), so_far + grown)


def _inverse(C: Tensors) -> Tensors:
    """Inverse of symmetric tensors by minors: ten times as fast as elimination."""
    a, b, c, d, e, f = (C[..., i, k] for i, k in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    minors = (d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b)
    size = a * minors[0] + b * minors[1] + c * minors[2]
    inverse = np.stack([minors[k] for k in (0, 1, 2, 1, 3, 4, 2, 4, 5)], axis=-1) / size[..., None]
    return np.asarray(inverse.reshape(C.shape))


def _faded(memory: np.ndarray, change: np.ndarray, pauses: float) -> np.ndarray:
    """Solution of m' = c' - m / tau after `pauses` times tau, for c linear in time."""
    return np.asarray(np.exp(-pauses) * memory - np.expm1(-pauses) / pauses * change)
