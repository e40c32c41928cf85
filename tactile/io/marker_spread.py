"""How well each marker's displacement and force are known: optional datasets of a recording.

`displacement_sd_mm` and `force_sd_N`: standard deviations of single values, noise and prior, not the scales
that all markers share (`force_scale_sd`).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactile.io.recording_fields import ANY, GroupReader

SD_FIELDS = ("displacement_sd_mm", "force_sd_N")
"""Datasets of a pad, both or none."""


@dataclass(frozen=True, kw_only=True)
class MarkerSpread:
    """Per frame, marker and axis of the pad frame."""

    displacement_sd_mm: Float[np.ndarray, "t n 3"]
    force_sd_N: Float[np.ndarray, "t n 3"]


def read_spread(pad: GroupReader, *, frames: int, markers: int) -> MarkerSpread | None:
    """From a pad's group; None where it has none. Raises TactileFailure for one without the other, or a
    negative deviation.
    """
    if not any(name in pad for name in SD_FIELDS):
        return None
    sds = [pad.array(name, (frames, markers, 3), limit=ANY) for name in SD_FIELDS]
    for name, values in zip(SD_FIELDS, sds, strict=True):
        pad.refuse_negative(name, values)
    return MarkerSpread(displacement_sd_mm=sds[0], force_sd_N=sds[1])


def write_spread(group: Any, spread: MarkerSpread) -> None:
    """Into a pad's HDF5 group, in single precision."""
    for name in SD_FIELDS:
        values = getattr(spread, name).astype(np.float32)
        group.create_dataset(name, data=values, compression="gzip", shuffle=True)
