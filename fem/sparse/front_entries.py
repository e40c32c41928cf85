"""Which numbers of the matrix go where in the dense fronts."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from scipy.sparse import csr_array


@dataclass(frozen=True)
class Entries:
    """Number `source` of the matrix goes to the place `target` of its front.

    Those of front s are bounds[s] to bounds[s + 1]. Places are counted through the square of the front's
    pivots and then the rows below, both column by column.
    """

    source: Int[np.ndarray, " e"]
    target: Int[np.ndarray, " e"]
    bounds: list[int]


NO_ENTRIES = Entries(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), [])
"""Those of a factorised matrix, which needs none."""


def ranges(start: Int[np.ndarray, " k"], length: Int[np.ndarray, " k"]) -> Int[np.ndarray, " n"]:
    """start[0], start[0] + 1, ... (length[0] of them), start[1], ..."""
    end = np.cumsum(length)
    return np.asarray(np.arange(end[-1] if len(end) else 0) + np.repeat(start - (end - length), length))


def front_entries(
    matrix: csr_array,
    *,
    order: Int[np.ndarray, " d"],
    start: list[int],
    rows: list[Int[np.ndarray, " _"]],
) -> Entries:
    """Of a symmetric pattern; `order`, `start` and `rows` are those of fem.sparse.fronts.

    The row of a dof is read as its column.
    """
    position = np.empty(len(order), dtype=np.int32)
    position[order] = np.arange(len(order))
    length = np.diff(matrix.indptr)[order]
    where = np.empty(len(order), dtype=np.int64)
    sources, targets, bounds = [], [], [0]
    for s, changed in enumerate(rows):
        first, last = start[s], start[s + 1]
        p, q = last - first, len(changed)
        where[first:last] = np.arange(p)
        where[changed] = np.arange(p * p, p * p + q)
        source = ranges(matrix.indptr[order[first:last]], length[first:last])
        column = np.repeat(np.arange(p), length[first:last])
        at = position[matrix.indices[source]]
        keep = at >= first
        local, column = where[at[keep]], column[keep]
        sources.append(source[keep])
        targets.append(local + np.where(local < p, p, q) * column)
        bounds.append(bounds[-1] + len(local))
    return Entries(np.concatenate(sources), np.concatenate(targets), bounds)
