"""Which frames of a recording were written, and its times and apertures without what the logger did."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from tactile.preparation.frames import prepare_frames
from tactile.preparation.logged_trace import NotPrepared
from tactile.preparation.logger_correction import LoggerCorrection, Words
from tactile.readers.recording_fields import FramesRead, GroupReader, Limit

WORDS = Words(row="frame", units=(("time", "s"), ("aperture_mm", "mm")))


@dataclass(frozen=True, kw_only=True)
class WrittenFrames:
    """`count`: frames that are read, as the first length of each field; `corrections`: what was put right."""

    count: FramesRead
    time_s: Float[np.ndarray, " t"]
    aperture_mm: Float[np.ndarray, " t"]
    corrections: tuple[LoggerCorrection, ...]


def written_frames(
    root: GroupReader, pads: Sequence[str], *, time_limit: Limit, aperture_limit: Limit
) -> WrittenFrames:
    """Times strictly increasing and within their limits; raises TactileFailure (unreadable-recording)."""
    time_s = root.array("time_s", (None,), holes=True)
    aperture_mm = root.array("aperture_mm", (len(time_s),), holes=True)

    @cache
    def force_N() -> Float[np.ndarray, " t"]:
        total = np.zeros(len(time_s))
        for name in pads:
            pad = root.child("pads").child(name)
            bare = "force_z_N" in pad and "rest_mm" not in pad
            shape = (len(time_s),) if bare else (len(time_s), None, 3)
            felt = pad.array("force_z_N" if bare else "force_N", shape, holes=True)
            total += felt if bare else felt[:, :, 2].sum(axis=1)
        return total

    try:
        done = prepare_frames(WORDS, time_s, {"aperture_mm": aperture_mm}, first_row=0, force=force_N)
    except NotPrepared as cause:
        expected, _, advice = cause.expected.partition("; ")
        root.refuse("time_s", (cause.fault, expected, advice))
        raise
    aperture = done.columns["aperture_mm"]
    root.require_within("time_s", done.time_s, time_limit)
    root.require_within("aperture_mm", aperture, aperture_limit)
    root.require_increasing("time_s", done.time_s)
    return WrittenFrames(
        count=FramesRead(done.part, len(time_s)),
        time_s=done.time_s,
        aperture_mm=aperture,
        corrections=done.corrections,
    )
