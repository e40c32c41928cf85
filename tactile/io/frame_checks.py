"""What is wrong with frames, seen while they pass by."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int, UInt8

from tactile.io.pictures import unusable
from tactile.tactile_failure import TactileFailure, TactileProblem

WHITE = 250
"""Grey level of 255 from which a pixel counts as full white: JPEG leaves a few levels."""
SATURATED = 0.1
"""More of the frame than this share at full white: nothing can be seen there."""
GAP = 1.6
"""A step this many times the usual one means that frames between are lost."""
EVERY = 4
"""Every so many rows and columns are looked at: a share needs no more."""


@dataclass
class Watch:
    """Passes frames on and keeps, for each, whether it is the one before it written again; and the latest."""

    source: str
    shape: tuple[int, int]
    doubled: list[bool] = field(default_factory=list)
    latest: UInt8[np.ndarray, "h w 3"] | None = None

    def over(self, frames: Iterable[UInt8[np.ndarray, "h w 3"]]) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        """The same frames; raises TactileFailure for one that is over-exposed or of another size."""
        before = None
        for k, frame in enumerate(frames):
            if frame.shape[:2] != self.shape:
                found = f"frame {k} of {frame.shape[1]} x {frame.shape[0]} pixels"
                raise unusable(self.source, found, f"{self.shape[1]} x {self.shape[0]} as the reference")
            refuse_saturated(frame, f"{self.source}: frame {k}")
            self.doubled.append(before is not None and np.array_equal(frame, before))
            before = self.latest = frame
            yield frame


def refuse_saturated(frame: UInt8[np.ndarray, "h w 3"], source: str) -> None:
    """Refuses a frame of which more than a tenth is white in every channel."""
    share = float((frame[::EVERY, ::EVERY].min(axis=2) >= WHITE).mean())
    if share > SATURATED:
        raise TactileFailure(
            TactileProblem.SATURATED,
            f"{source}: found {share:.0%} of the gel over-exposed, expected at most {SATURATED:.0%}; "
            "reduce the sensor's lights or exposure.",
        )


def gaps_said(
    time_s: Float[np.ndarray, " t"], source: str, *, numbers: Int[np.ndarray, " t"] | None = None
) -> list[str]:
    """A note where frames are missing: by their `numbers` if they have any, else where time steps are long.

    Frames that are numbered without a gap are all there, however unevenly they were taken.
    """
    if len(time_s) < 3:
        return []
    step = np.diff(time_s)
    usual = float(np.median(step))
    long = np.flatnonzero(step > GAP * usual if numbers is None else np.diff(numbers) > 1)
    if not len(long):
        return []
    steps = step[long] / usual if numbers is None else np.diff(numbers)[long]
    return [
        (
            f"{source}: about {int(np.rint(steps).sum() - len(long))} frames are missing in {len(long)} "
            f"gaps, the first after {time_s[long[0]]:.3f} s (usual step {usual * 1e3:.1f} ms)."
        )
    ]
