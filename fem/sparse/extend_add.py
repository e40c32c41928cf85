"""What a child's elimination leaves over is added to its parent's front."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

LONG_STRETCH = 15
"""Stretches longer than this on average are added block by block, shorter ones number by number."""


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

    def add(self, update: Float[np.ndarray, "c c"], relative_indices: RelativeIndices) -> None:
        """The update of a child, in whole blocks where its rows lie together in long stretches."""
        p, place = len(self.triangle), relative_indices.place
        if len(update) > LONG_STRETCH * len(relative_indices.runs):
            self._add_blocks(update, relative_indices)
            return
        k = int(np.searchsorted(place, p))
        pivots, rows = place[:k], place[k:] - p
        self.triangle[pivots[:, None], pivots] += update[:k, :k]
        self.below[pivots[:, None], rows] += update[:k, k:]
        self.schur[rows[:, None], rows] += update[k:, k:]

    def _add_blocks(self, update: Float[np.ndarray, "c c"], relative_indices: RelativeIndices) -> None:
        """Every pair of runs is one block."""
        p = len(self.triangle)
        for k, (a, b, row) in enumerate(relative_indices.runs):
            for c, d, column in relative_indices.runs[k:]:
                if column < p:
                    target = self.triangle[row : row + b - a, column : column + d - c]
                elif row < p:
                    target = self.below[row : row + b - a, column - p : column - p + d - c]
                else:
                    target = self.schur[row - p : row - p + b - a, column - p : column - p + d - c]
                target += update[a:b, c:d]
