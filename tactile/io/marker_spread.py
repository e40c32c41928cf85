"""How well each marker's displacement and force are known: optional datasets of a recording.

`displacement_sd_mm` and `force_sd_N`: standard deviations of single values, noise and prior, not the scales
that all markers share (`force_scale_sd`). `joint_covariance`: of [displacement; force] of one frame, markers
then x, y, z in each, mm and N; both fields come from the same pixels.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tactile.io.recording_fields import ANY, GroupReader

SD_FIELDS = ("displacement_sd_mm", "force_sd_N")
"""Datasets of a pad, both or none."""


@dataclass(frozen=True, kw_only=True)
class JointCovariance:
    """Of frame number `frame`; symmetric, 6 numbers a marker."""

    frame: int
    values: Float[np.ndarray, "d d"]


@dataclass(frozen=True, kw_only=True)
class MarkerSpread:
    """Per frame, marker and axis of the pad frame."""

    displacement_sd_mm: Float[np.ndarray, "t n 3"]
    force_sd_N: Float[np.ndarray, "t n 3"]
    joint: JointCovariance | None = None


def read_spread(pad: GroupReader, *, frames: int, markers: int) -> MarkerSpread | None:
    """From a pad's group; None where it has none. Raises TactileFailure for one without the other, a negative
    deviation, a frame that is not there.
    """
    if not any(name in pad for name in SD_FIELDS):
        return None
    sds = [pad.array(name, (frames, markers, 3), limit=ANY) for name in SD_FIELDS]
    for name, values in zip(SD_FIELDS, sds, strict=True):
        pad.refuse_negative(name, values)
    joint = None
    if "joint_covariance" in pad:
        values = pad.array("joint_covariance", (6 * markers, 6 * markers), limit=ANY)
        frame = int(pad.group.attrs.get("covariance_frame", -1))
        beyond = f"{frame}", f"0 to {frames - 1}, the frame it is of", "write covariance_frame again"
        pad.refuse("joint_covariance", None if 0 <= frame < frames else beyond)
        joint = JointCovariance(frame=frame, values=values)
    return MarkerSpread(displacement_sd_mm=sds[0], force_sd_N=sds[1], joint=joint)


def write_spread(group: Any, spread: MarkerSpread) -> None:
    """Into a pad's HDF5 group, in single precision."""
    for name in SD_FIELDS:
        values = getattr(spread, name).astype(np.float32)
        group.create_dataset(name, data=values, compression="gzip", shuffle=True)
    if spread.joint is not None:
        values = spread.joint.values.astype(np.float32)
        group.create_dataset("joint_covariance", data=values, compression="gzip", shuffle=True)
        group.attrs["covariance_frame"] = spread.joint.frame
