"""What one cause adds to a recording, channel by channel.

markers   displacement of every marker in every frame, mm (R2)
balance   what the pads' forces and moments do not balance, N and N mm over ARM_MM (R1)
rest      growth of each pad's normal force from the air before the contact to the air after it, N/s (R4)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect_spec import EffectSpec

ARM_MM = 20.0
"""Length that brings moments to forces."""


@dataclass(frozen=True, kw_only=True)
class ObservationDelta:
    """One cause's mark on one recording, per unit of the cause; a channel that it leaves alone is None."""

    markers: Float[np.ndarray, "f n 3"] | None = None
    balance: Float[np.ndarray, "f 6"] | None = None
    rest: Float[np.ndarray, " p"] | None = None


@dataclass(frozen=True, kw_only=True)
class Regressor:
    """One unknown amount: its name, prior mean (zero) and standard deviation, its field in every recording.

    None: this recording does not show it. `positive`: an amount below zero makes no sense. `discrepancy_of`:
    the effect that the model's own error looks like, where the amount is that of such an error.
    """

    name: str
    sd: float
    fields: Sequence[ObservationDelta | None]
    positive: bool = False
    mean: float = 0.0
    discrepancy_of: EffectSpec | None = None


def wrench(
    force_N: Float[np.ndarray, "f n 3"],
    position_mm: Float[np.ndarray, "f n 3"],
    *,
    centre_mm: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "f 6"]:
    """Sum of forces (N) and of their moments about the centre over ARM_MM (N)."""
    moment = np.cross(position_mm - centre_mm, force_N).sum(axis=1)
    return np.hstack([force_N.sum(axis=1), moment / ARM_MM])
