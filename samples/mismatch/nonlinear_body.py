"""A fruit whose flesh follows a law of its own: equilibrium by alternating contact and flesh.

The contact is solved on the dense linear stiffness, the skin's free standing shifted by what excess stress
does: p = K^-1 excess. Rounds are sped up by Anderson mixing (Walker and Ni 2011, type II) until p no longer
changes.
"""

import numpy as np
from jaxtyping import Float

from samples.anderson_mixing import AndersonMixing
from samples.mismatch.flesh_laws import FleshLaw, State
from samples.mismatch.grip import Grip, Instant, next_instant
from samples.mismatch.whole_fruit import WholeFruit
from samples.sample_failure import NotInEquilibrium

CONVERGED_MM = 4e-4
"""mm, the largest change of a skin node in a round: a tenth of a frame's noise of 4 um
(samples.sensor_noise)."""
REST_S = 1e4
"""Between two grasps."""
ROUNDS, DEPTH = 60, 8
"""Rounds before a step counts as unbalanced and is halved, and how many earlier ones are mixed (set by
hand)."""
HALVINGS = 3
"""How often a step that finds no balance is halved, without the trend and tangent of the whole one."""


class NonlinearBody:
    """Flesh with a law per point; it remembers what the law remembers, from grasp to grasp."""

    def __init__(self, whole: WholeFruit, law: FleshLaw, *, firmer: float = 1.0) -> None:
        """`firmer`: times the linear stiffness that the rounds lean on; above 1 for flesh that stiffens."""
        self._whole, self._compliance, self._law = whole, whole.compliance.scaled(1 / firmer), law
        self._firmer = firmer
        self.still = law.still
        self._state: State = law.at_first(whole.flesh.volumes.shape)
        self._shift = np.zeros(whole.flesh.unknowns)
        self._trend = np.zeros(whole.flesh.unknowns)

    def begin(self) -> Float[np.ndarray, " d"]:
        """Unloaded, where the flesh's own stress has brought the skin."""
        whole = self._whole
        shift, mixing = self._shift, AndersonMixing(DEPTH)
        for _ in range(ROUNDS):
            mapped, state = self._mapped(-shift, REST_S)
            if np.abs(mapped - shift).max() < CONVERGED_MM / 10:
                break
            shift = mixing.mixed(shift, mapped)
        self._state, self._shift, self._trend = state, mapped, np.zeros_like(mapped)
        return np.asarray(-mapped[whole.dofs])

    def advance(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float
    ) -> Instant:
        """Equilibrium of contact and flesh; a step that finds none is taken in two."""
        return self._in_steps(grip, before, origins, pause_s, HALVINGS)

    def _in_steps(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float, halvings: int
    ) -> Instant:
        try:
            return self._in_one(grip, before, origins, pause_s)
        except NotInEquilibrium:
            if not halvings:
                raise
        self._trend = np.zeros_like(self._trend)
        half = (before.origins + origins) / 2
        middle = self._in_steps(grip, before, half, pause_s / 2, halvings - 1)
        return self._in_steps(grip, middle, origins, pause_s / 2, halvings - 1)

    def _in_one(
        self, grip: Grip, before: Instant, origins: Float[np.ndarray, "2 3"], pause_s: float
    ) -> Instant:
        whole = self._whole
        shift, start = self._shift + self._trend, None
        mixing = AndersonMixing(DEPTH)
        for _ in range(ROUNDS):
            instant = next_instant(grip, before, origins, self._compliance, -shift[whole.dofs], start=start)
            q = whole.solve(whole.spread(instant.force_N)) / self._firmer - shift
            mapped, state = self._mapped(q, pause_s)
            start = instant.force_N
            if np.abs((mapped - shift)[whole.dofs]).max() < CONVERGED_MM:
                self._trend = (mapped - self._shift) if np.any(instant.force_N) else np.zeros_like(mapped)
                self._state, self._shift = state, mapped
                return instant
            shift = mixing.mixed(shift, mapped)
        raise NotInEquilibrium(f"flesh and contact found no balance in {ROUNDS} rounds: press less")

    def _mapped(self, q: Float[np.ndarray, " u"], pause_s: float) -> tuple[Float[np.ndarray, " u"], State]:
        excess, state = self._law.excess(self._whole.gradients(q), self._state, pause_s)
        shift = self._whole.solve(self._whole.forces(excess))
        return (shift + (1 - self._firmer) * q) / self._firmer, state
