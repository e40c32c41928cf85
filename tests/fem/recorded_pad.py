"""A pad of a recording, of what tests say of it; the rest is usual."""

import numpy as np

from fem.grasp_history import PadHistory


def recorded_pad(
    place_mm, force_N, *, touching, sd_mm, sd_N, name="left", rest_mm=None, position_mm=None, gel_mm=0.0
) -> PadHistory:
    """`place_mm` (n, 3): its markers on the skin at rest; `touching` (t, n): while they are in one contact.

    `sd_mm`, `sd_N`: white noise of displacement and force. Markers that are nowhere else stay in their place.
    """
    return PadHistory(
        name=name,
        rest_mm=place_mm if rest_mm is None else rest_mm,
        surface_mm=place_mm,
        position_mm=np.zeros(force_N.shape) + (place_mm if position_mm is None else position_mm),
        gel_displacement_mm=np.zeros(force_N.shape) + gel_mm,
        force_N=force_N,
        episode=np.where(np.broadcast_to(touching, force_N.shape[:2]), 0, -1),
        displacement_sd_mm=sd_mm,
        force_sd_N=sd_N,
        lag1=0.0,
    )
