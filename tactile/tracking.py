"""Markers followed through a sequence of frames."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True)
class TrackedMarkers:
    """Where every marker is in every frame of one camera, px, pixel (0, 0) being the first one's centre.

    `reference_px` are the markers in the unloaded image, distorted as the camera sees them; `position_px` is
    NaN where a marker is lost or hidden. `quality` is 0 (lost) to 1 (as clear as on the reference). `rest_mm`
    is each marker's place on the undeformed gel, gel frame: the sensor's own where it states a grid.
    """

    time_s: Float[np.ndarray, " t"]
    reference_px: Float[np.ndarray, "n 2"]
    position_px: Float[np.ndarray, "t n 2"]
    quality: Float[np.ndarray, "t n"]
    rest_mm: Float[np.ndarray, "n 3"]

    @property
    def seen(self) -> Float[np.ndarray, " t"]:
        """Share of the markers that each frame shows."""
        share: Float[np.ndarray, " t"] = np.isfinite(self.position_px[..., 0]).mean(axis=1)
        return share
