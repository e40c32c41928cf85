"""What a child's elimination leaves over is added to its parent's front, in long stretches."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

#: stretches longer than this on average are added block by block, shorter ones are first spread out
LONG_STRETCH = 60
#: numbers in the buffer that spreads: half a megabyte stays near the processor
BUFFER = 65536


@dataclass(frozen=True)
class RelativeIndices:
    """Where the update of one front lands in its parent's.

    place: position of each row among the parent's pivots and rows, ascending.
    runs: (start, stop, place of the first) of stretches of rows that stay together; none has both pivots and
    rows of the parent.
    """

    place: Int[np.ndarray, " q"]
    runs: list[tuple[int, int, int]]

    @classmethod
    def at(cls, place: Int[np.ndarray, " q"], *, n_pivots: int) -> "RelativeIndices":
        """Find the stretches; the parent's first n_pivots places are pivots."""
        cut = np.flatnonzero((np.diff(place) != 1) | (place[1:] == n_pivots)) + 1
        starts = [0, *cut.tolist()]
        return cls(place, list(zip(starts, [*cut.tolist(), len(place)], place[starts].tolist(), strict=True)))


@dataclass(frozen=True)
class Front:
    """A front's three parts, transposed as they are stored: only the upper halves of the squares count."""

    triangle: Float[np.ndarray, "p p"]
    below: Float[np.ndarray, "p q"]
    schur: Float[np.ndarray, "q q"]


def extend_add(
    front: Front,
    update: Float[np.ndarray, "c c"],
    relative_indices: RelativeIndices,
    *,
    buffer: Float[np.ndarray, " b"],
) -> None:
    """Add the update of a child to its parent's front; the buffer, of BUFFER numbers, is overwritten."""
    wide = len(front.triangle) + len(front.schur) > BUFFER
    if wide or len(update) > LONG_STRETCH * len(relative_indices.runs):
        _add_blocks(front, update, relative_indices)
    else:
        _add_spread(front, update, relative_indices, buffer)


def _add_blocks(front: Front, update: np.ndarray, relative_indices: RelativeIndices) -> None:
    """Stretch by stretch: every pair of runs is one block of the parent's front."""
    p = len(front.triangle)
    for k, (a, b, row) in enumerate(relative_indices.runs):
        for c, d, column in relative_indices.runs[k:]:
            if column < p:
                target = front.triangle[row : row + b - a, column : column + d - c]
            elif row < p:
                target = front.below[row : row + b - a, column - p : column - p + d - c]
            else:
                target = front.schur[row - p : row - p + b - a, column - p : column - p + d - c]
            np.add(target, update[a:b, c:d], out=target)


def _add_spread(
    front: Front, update: np.ndarray, relative_indices: RelativeIndices, buffer: np.ndarray
) -> None:
    """Some rows at a time: first to the parent's columns, zeros between, then stretch by stretch."""
    place = relative_indices.place
    p, count = len(front.triangle), len(place)
    size = p + len(front.schur)
    step = min(count, BUFFER // size)
    spread = buffer[: step * size].reshape(step, size)
    spread[:] = 0
    for low in range(0, count, step):
        high = min(count, low + step)
        spread[: high - low, place[low:]] = update[low:high, low:]
        first = int(place[low])
        for a, b, row in relative_indices.runs:
            if b <= low or a >= high:
                continue
            start, stop = max(a, low), min(b, high)
            to = slice(row + start - a, row + stop - a)
            rows = spread[start - low : stop - low]
            if row < p:
                target = front.triangle[to, first:]
                np.add(target, rows[:, first:p], out=target)
                target = front.below[to]
                np.add(target, rows[:, p:], out=target)
            else:
                beyond = max(first, p)
                target = front.schur[to.start - p : to.stop - p, beyond - p :]
                np.add(target, rows[:, beyond:], out=target)
