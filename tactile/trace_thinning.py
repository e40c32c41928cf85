"""Thins a long force-displacement curve; ramps, holds and sudden falls keep their recorded frames."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.noise import noise_sd

MOST_FRAMES, KEPT = 1200, 700
"""Frames above which a curve is thinned, and their number after it at first. Explaining a curve takes time
and memory with the square of them (700: 4 s and 240 MB; 2440: 24 s and 470 MB)."""
LIMIT_KEPT = 1000
"""Most frames, whatever the bound: a curve that shakes all the time is not followed everywhere."""
BOUND = 3.0
"""Most standard deviations of the force's noise between a straight line through kept frames and the mean of a
block (set by hand: a kept frame has a noise of one)."""
BLOCKS_PER_KEPT = 6
"""Blocks per kept frame; the recording is averaged over blocks to find what would be lost."""


@dataclass(frozen=True, kw_only=True)
class Thinned:
    """`kept`: indices of the frames; `off`: the largest deviation of the recording's block means from
    straight lines between kept frames, in standard deviations `noise_N` of one frame; `frames`: their number
    before.
    """

    kept: Int[np.ndarray, " k"]
    off: float
    noise_N: float
    frames: int

    def said(self, source: str) -> str:
        """One sentence for people."""
        return (
            f"{source}: drupe thinned {self.frames} frames to {len(self.kept)}, each as recorded. "
            "Linear interpolation of the force between them deviates from the recording by at most "
            f"{self.off:.1f} standard deviations of its noise ({self.noise_N:.2g} N)."
        )


def thin(
    time_s: Float[np.ndarray, " t"], travel_mm: Float[np.ndarray, " t"], force_N: Float[np.ndarray, " t"]
) -> Thinned | None:
    """Which frames of a long curve suffice; None if it has no more than MOST_FRAMES.

    A third of them are spread over time, a third over the force's path (beyond its noise), a third over the
    travel's: a step of 0.1 s in an hour keeps its share. Then, where a straight line between two of them
    deviates by more than BOUND, the worst frame between is kept too, until none does. Source of the second
    step: Douglas and Peucker, "Algorithms for the reduction of the number of points required to represent a
    digitized line", Cartographica 10, 1973, 112-122.
    """
    frames = len(time_s)
    if frames <= MOST_FRAMES:
        return None
    noise_N, noise_mm = noise_sd(force_N), noise_sd(travel_mm)
    starts = np.linspace(0, frames, BLOCKS_PER_KEPT * KEPT + 1).astype(int)[:-1]
    starts = np.unique(starts)
    size = np.diff(np.r_[starts, frames])
    middle = starts + size // 2
    mean_N = np.add.reduceat(force_N, starts) / size
    share = (
        _path(np.add.reduceat(time_s, starts) / size, 0.0)
        + _path(mean_N, noise_N / np.sqrt(size.mean()))
        + _path(np.add.reduceat(travel_mm, starts) / size, noise_mm / np.sqrt(size.mean()))
    ) / 3
    clock = np.interp(np.arange(frames), middle, share)
    kept = np.unique(np.searchsorted(clock, np.linspace(0, 1, KEPT)).clip(0, frames - 1))
    kept = np.unique(np.r_[0, kept, frames - 1])
    allowed = BOUND * np.sqrt(1 + 1 / size) * noise_N
    while True:
        line_N = np.interp(time_s, time_s[kept], force_N[kept])
        apart = np.abs(np.add.reduceat(force_N - line_N, starts)) / size
        worst = _worst_between(kept, middle, apart, apart > allowed)
        more = np.union1d(kept, worst[: LIMIT_KEPT - len(kept)])
        if len(more) == len(kept):
            break
        kept = more
    return Thinned(kept=kept, off=float(apart.max() / noise_N), noise_N=noise_N, frames=frames)


def _path(value: Float[np.ndarray, " b"], noise: float) -> Float[np.ndarray, " b"]:
    """Path length of the value up to each block over its whole path: 0 to 1; steps within noise count as
    0."""
    steps = np.maximum(np.abs(np.diff(value)) - 3 * noise, 0.0)
    gone = np.r_[0.0, np.cumsum(steps)]
    return np.asarray(gone / gone[-1] if gone[-1] > 0 else np.linspace(0, 1, len(value)))


def _worst_between(
    kept: Int[np.ndarray, " k"],
    middle: Int[np.ndarray, " b"],
    apart: Float[np.ndarray, " b"],
    over: Bool[np.ndarray, " b"],
) -> Int[np.ndarray, " w"]:
    """For each gap between kept frames with a block beyond the bound, the frame of its worst block; the worst
    gap comes first.
    """
    gap = np.searchsorted(kept, middle, side="right")
    order = np.lexsort([-apart, gap])
    order = order[over[order]]
    first = order[np.unique(gap[order], return_index=True)[1]]
    return np.asarray(middle[first[np.argsort(-apart[first])]])
