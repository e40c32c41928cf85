"""Gels that soften while they are pressed, against a fruit of plain linear flesh."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from samples.gel_contact import Gel
from samples.mismatch.grip import Grip, Instant, next_instant
from samples.mismatch.skin_compliance import SkinCompliance


class SofteningGelBody:
    """Linear flesh; the gel's stiffnesses go as 1 - g + g exp(-t/tau), t the time it has been pressed."""

    still = False

    def __init__(self, compliance: SkinCompliance, *, g: float, tau_s: float) -> None:
        self._compliance, self._g, self._tau_s = compliance, g, tau_s
        self._pressed_s = 0.0

    def begin(self) -> Float[np.ndarray, " d"]:
        """Rested."""
        self._pressed_s = 0.0
        return np.zeros(len(self._compliance))

    def advance(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float
    ) -> Instant:
        """Equilibrium with the gel as soft as it is now."""
        self._pressed_s = self._pressed_s + pause_s if np.any(before.force_N) else 0.0
        soft = replace(grip, gel=self._softened(grip.gel))
        return next_instant(soft, before, origins, self._compliance, np.zeros(len(self._compliance)))

    def _softened(self, gel: Gel) -> Gel:
        left = 1 - self._g + self._g * float(np.exp(-self._pressed_s / self._tau_s))
        return replace(gel, kn_MPa_per_mm=gel.kn_MPa_per_mm * left, kt_MPa_per_mm=gel.kt_MPa_per_mm * left)
