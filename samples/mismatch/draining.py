"""Flesh that loses juice: its resistance to losing volume fades while it is held, its shear does not."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from samples.mismatch.flesh_laws import Lame, State


@dataclass(frozen=True, kw_only=True)
class Draining:
    """sigma = 2 mu eps + lam ((1 - s) tr eps + s a) I with a' = (tr eps)' - a / tau. State: a, tr eps.

    One drainage time for all flesh, however far from the skin: poroelasticity without its length.
    """

    lame: Lame
    volume_share: float
    tau_s: float
    still: bool = False
    objective: bool = False

    def at_first(self, points: tuple[int, ...]) -> State:
        """Full of juice, unstrained."""
        return np.zeros(points), np.zeros(points)

    def excess(
        self, H: Float[np.ndarray, "*p 3 3"], state: State, pause_s: float
    ) -> tuple[Float[np.ndarray, "*p 3 3"], State]:
        """What has drained away of the volumetric stress; tr eps is taken linear over the step."""
        faded, before = state
        trace = np.trace(H, axis1=-2, axis2=-1)
        ramp = -self.tau_s / pause_s * np.expm1(-pause_s / self.tau_s)
        now = np.exp(-pause_s / self.tau_s) * faded + ramp * (trace - before)
        lost = self.lame.lam * self.volume_share * (trace - now)
        return -lost[..., None, None] * np.eye(3), (now, trace)
