"""Gels that soften while they are pressed, whatever the fruit."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from samples.gel_contact import Gel
from samples.mismatch.bodies import GrippedBody
from samples.mismatch.grip import Grip, Instant


class SofteningGelBody:
    """A body; the gel's stiffnesses go as 1 - g + g exp(-t/tau), t the time it has been pressed."""

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
