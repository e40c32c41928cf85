"""Change of a recording's observations by one cause, in each channel.

markers   displacement of every marker in every frame, mm (R2)
balance   resultant of the pads' forces and moments, N and N mm over ARM_MM of plain_model (R1)
rest      zero drift of each pad's normal force from before the contact to after it, N/s (R4)
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float

from fem.mismatch.model.force_noise import LinearInForces


@dataclass(frozen=True, kw_only=True)
class ObservationDelta:
    """Change of one recording per unit of a cause; None for a channel that the cause does not change."""

    markers: Float[np.ndarray, "f n 3"] | None = None
    balance: Float[np.ndarray, "f 6"] | None = None
    rest: Float[np.ndarray, " p"] | None = None

    def plus(self, amount: float, other: "ObservationDelta | None") -> "ObservationDelta":
        """This and `amount` times another; a channel that neither changes is None."""
        if other is None:
            return self
        channels = {}
        for channel in fields(self):
            mine, more = getattr(self, channel.name), getattr(other, channel.name)
            if more is not None:
                mine = amount * more if mine is None else mine + amount * more
            channels[channel.name] = mine
        return ObservationDelta(**channels)


@dataclass(frozen=True, kw_only=True)
class Regressor:
    """One unknown amount: its name, prior mean and standard deviation, its field in every recording.

    A field is None if the recording does not depend on the amount. `positive`: an amount below `least` has no
    meaning. `same_as`: for a column of the model's own error, the number (from one) of the case's column with
    the same fields (fem.mismatch.evidence.model_error). `of_forces`: the linear map from the forces to the
    fields, which gives their noise (fem.mismatch.model.force_noise); None if they hardly or not linearly
    depend on the forces. `power`: of 1/E with which the prior mean and its spread grow. `measured`: prior
    mean by other data than the markers' motion; it counts where the column is fitted (`mean` always counts).
    `measured_sd`: its standard deviation. `sd` may be less, so that the fit holds the amount.
    """

    name: str
    sd: float
    fields: Sequence[ObservationDelta | None]
    positive: bool = False
    least: float = 0.0
    mean: float = 0.0
    same_as: int | None = None
    of_forces: LinearInForces | None = None
    power: float = 0.0
    measured: float = 0.0
    measured_sd: float = 0.0

    def at(self, share: float) -> "Regressor":
        """This column at so many times the 1/E."""
        if not self.power:
            return self
        return replace(self, mean=share**self.power * self.mean, sd=share**self.power * self.sd)
