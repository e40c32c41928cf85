"""How the fruit behind its skin patches goes from one instant to the next."""

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
