"""Which numbers of the matrix go where in the dense fronts."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from scipy.sparse import csr_array

from fem.sparse.elimination_order import Groups

#: entries looked up together: few enough to stay near the processor
_BATCH = 100_000


@dataclass(frozen=True)
class Entries:
    """Number `source` of the matrix goes to the place `target` of its front.

    Those of front s are bounds[s] to bounds[s + 1]. Places are counted through the square of the front's
    pivots and then the rows below, both column by column.
    """

    source: Int[np.ndarray, " e"]
    target: Int[np.ndarray, " e"]
    bounds: list[int]


def ranges(start: Int[np.ndarray, " k"], length: Int[np.ndarray, " k"]) -> Int[np.ndarray, " n"]:
    """start[0], start[0] + 1, ... (length[0] of them), start[1], ..."""
    end = np.cumsum(length)
    return np.asarray(np.arange(end[-1] if len(end) else 0) + np.repeat(start - (end - length), length))


def front_entries(
    matrix: csr_array,
    groups: Groups,
    group: Int[np.ndarray, " g"],
    *,
    order: Int[np.ndarray, " d"],
    start: list[int],
    rows: list[Int[np.ndarray, " _"]],
) -> list[Entries]:
    """The first entries are those of the first dof of each group, the second of the second, and so on.

    `group` lists the groups in the order of elimination; `order`, `start` and `rows` are those of
    fem.sparse.fronts.
    A place is looked up for the first dof only: the columns of a group lie side by side.
    """
    position = np.empty(len(order), dtype=np.int64)
    position[order] = np.arange(len(order))
    size = groups.size[group]
    width = int(size.max())
    length = np.diff(groups.entry_start)[group]
    begin = groups.entry_start[group]
    column = np.cumsum(size) - size
    member = np.minimum(groups.start[group] + np.arange(width)[:, None], len(order) - 1)
    row_start = matrix.indptr[groups.members[member]].astype(np.int64)
    border = np.searchsorted(column, start).tolist()  # of fronts, counted in groups
    total = np.concatenate([[0], np.cumsum(length)])
    where = np.empty(len(order), dtype=np.int64)
    pairs_of_member: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in range(width)]
    counts = np.zeros((width, len(rows) + 1), dtype=np.int64)
    first = 0
    while first < len(rows):
        full = int(np.searchsorted(total, total[border[first]] + _BATCH))
        last = max(first + 1, int(np.searchsorted(border, full, side="right")) - 1)
        here = np.arange(border[first], border[last])
        at = position[groups.entry_dof[ranges(begin[here], length[here])]]
        offset = ranges(np.zeros_like(here), length[here])
        of_group = np.repeat(here, length[here])
        front_start = np.repeat(start[first:last], np.diff(border[first : last + 1]))
        keep = np.flatnonzero(at >= np.repeat(front_start, length[here]))
        at, offset, of_group = at[keep], offset[keep], of_group[keep]
        cuts = np.searchsorted(of_group, border[first : last + 1])
        stride = np.empty_like(at)
        for k, s in enumerate(range(first, last)):
            p, q = start[s + 1] - start[s], len(rows[s])
            where[start[s] : start[s + 1]] = np.arange(p)
            where[rows[s]] = np.arange(p * p, p * p + q)
            mine = slice(cuts[k], cuts[k + 1])
            local = where[at[mine]]
            stride[mine] = np.where(local < p, p, q)
            at[mine] = local + stride[mine] * (column[of_group[mine]] - start[s])
        for m in range(width):
            has = np.flatnonzero(size[of_group] > m)
            pairs_of_member[m].append((row_start[m, of_group[has]] + offset[has], (at + m * stride)[has]))
            counts[m, first + 1 : last + 1] = np.diff(np.searchsorted(has, cuts))
        first = last
    return [
        Entries(
            np.concatenate([sources for sources, _ in pairs]),
            np.concatenate([targets for _, targets in pairs]),
            until,
        )
        for pairs, until in zip(pairs_of_member, np.cumsum(counts, axis=1).tolist(), strict=True)
    ]
