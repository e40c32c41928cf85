"""How the fruit behind its skin patches goes from one instant to the next."""

from dataclasses import replace
from typing import Protocol

import numpy as np
from jaxtyping import Float

from samples.gel_contact import Gel
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
    """Linear flesh: always the same compliance, nothing to remember. Unknowns beside the skin's, if any, are
    those of an inner contact.
    """

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


class SofteningGelBody:
    """A body whose gels soften: their stiffness goes as 1 - g + g exp(-t/tau), t the time of contact."""

    still = False

    def __init__(self, body: GrippedBody, *, g: float, tau_s: float) -> None:
        self._body, self._g, self._tau_s = body, g, tau_s
        self._pressed_s = 0.0

    def begin(self) -> Float[np.ndarray, " d"]:
        """Rested."""
        self._pressed_s = 0.0
        return self._body.begin()

    def advance(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float
    ) -> Instant:
        """Equilibrium with the gel as soft as it is now."""
        self._pressed_s = self._pressed_s + pause_s if np.any(before.force_N) else 0.0
        left, right = grip.gels
        soft = replace(grip, gels=(self._softened(left), self._softened(right)))
        return self._body.advance(soft, before, origins, pause_s)

    def _softened(self, gel: Gel) -> Gel:
        left = 1 - self._g + self._g * float(np.exp(-self._pressed_s / self._tau_s))
        return replace(gel, kn_MPa_per_mm=gel.kn_MPa_per_mm * left, kt_MPa_per_mm=gel.kt_MPa_per_mm * left)
