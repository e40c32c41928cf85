"""How the fruit behind its skin patches goes from one instant to the next: elastic, or relaxing."""

from typing import Protocol

import numpy as np
from jaxtyping import Float

from samples.mismatch.grip import Grip, Instant, next_instant
from samples.mismatch.skin_compliance import SkinCompliance


class GrippedBody(Protocol):
    """A fruit under load. `still`: an instant with unmoved pads is the same as the one before."""

    @property
    def still(self) -> bool:
        """Whether nothing creeps in it."""
        ...

    def begin(self) -> Float[np.ndarray, " d"]:
        """Rested since its last grasp: how far off its first place the unloaded skin is, mm."""
        ...

    def advance(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float
    ) -> Instant:
        """The instant `pause_s` later with the pads at `origins`. Raises NotInEquilibrium."""
        ...


class ElasticBody:
    """Linear flesh: always the same compliance, nothing to remember."""

    still = True

    def __init__(self, compliance: SkinCompliance) -> None:
        self._compliance, self._nowhere = compliance, np.zeros(len(compliance))

    def begin(self) -> Float[np.ndarray, " d"]:
        """Where it always was."""
        return self._nowhere

    def advance(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float  # noqa: ARG002
    ) -> Instant:  # fmt: skip
        """Equilibrium with the pads."""
        return next_instant(grip, before, origins, self._compliance, self._nowhere)


class RelaxingBody:
    """Flesh whose modulus relaxes as 1 - sum g + sum g exp(-t/tau), Poisson's ratio constant.

    With h' = -h/tau + (K u)' per arm, the forces are f = (1 - sum g) K u + sum g h (Simo and Hughes 1998,
    section 10.3); K u is taken linear in time over a step, for which the update is exact. An arm is kept as
    the displacement K^-1 h. Between two grasps it forgets everything.
    """

    still = False

    def __init__(self, compliance: SkinCompliance, *, arms: tuple[tuple[float, float], ...]) -> None:
        self._compliance = compliance
        self._g = np.array([g for g, _ in arms])
        self._tau = np.array([tau for _, tau in arms])
        self.begin()

    def begin(self) -> Float[np.ndarray, " d"]:
        """All arms empty."""
        count = len(self._compliance)
        self._arms = np.zeros((len(self._g), count))
        return np.zeros(count)

    def advance(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float
    ) -> Instant:
        """f = a K u + K known over the step, hence compliance C / a, and unloaded skin at -known / a."""
        decay = np.exp(-pause_s / self._tau)
        ramp = -self._tau / pause_s * np.expm1(-pause_s / self._tau)
        now = 1 - self._g.sum() + self._g @ ramp
        known = (self._g * decay) @ self._arms - (self._g @ ramp) * before.u
        instant = next_instant(grip, before, origins, self._compliance.scaled(1 / now), -known / now)
        self._arms = decay[:, None] * self._arms + ramp[:, None] * (instant.u - before.u)
        return instant
