"""Unknown numbers of a model: how each is named, bounded and believed before the data speak."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from fem.mismatch.result import Parameter

#: half width of a 90 % interval in standard deviations
NINETY = 1.6448536


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """A number whose `scale` (log: positive, logit: between 0 and 1) is normal with `mean` and `sd`."""

    name: str
    unit: str
    scale: Literal["linear", "log", "logit"]
    mean: float
    sd: float

    def value(self, scaled: Float[np.ndarray, " *p"]) -> Float[np.ndarray, " *p"]:
        """The number itself."""
        if self.scale == "log":
            return np.asarray(np.exp(scaled))
        if self.scale == "logit":
            return np.asarray(1 / (1 + np.exp(-scaled)))
        return np.asarray(scaled)

    def parameter(self, scaled: float, sd: float) -> Parameter:
        """Value with standard deviation (to first order) and the 90 % interval carried from the scale."""
        low, value, high = (float(self.value(np.array(scaled + k * sd))) for k in (-NINETY, 0, NINETY))
        slope = {"linear": 1.0, "log": value, "logit": value * (1 - value)}[self.scale]
        return Parameter(value=value, sd=slope * sd, unit=self.unit, interval=(low, high))
