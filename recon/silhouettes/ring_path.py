"""Closed paths of greatest gain round a ring, for many rings at once."""

import numpy as np
from jaxtyping import Float, Int


def best_rings(gain: Float[np.ndarray, "v n k"], *, bend: float, steepest: int) -> Int[np.ndarray, "v n"]:
    """Of each ring of n samples the path over k states with the greatest sum of gains, closed on itself.

    Neighbouring samples may differ by at most `steepest` states, at a cost of `bend` a state. A first run
    from the ring's far side finds the state at sample 0, a second one starts and ends there (dynamic
    programming, Viterbi 1967): all but exact, since only that state is taken from an open path.
    """
    count = gain.shape[1]
    middle = count // 2
    free = _paths(np.roll(gain, middle, axis=1), None, bend, steepest)
    return _paths(gain, free[:, middle], bend, steepest)


def _paths(
    gain: Float[np.ndarray, "v n k"], fixed: Int[np.ndarray, " v"] | None, bend: float, steepest: int
) -> Int[np.ndarray, "v n"]:
    """The best path of each ring by dynamic programming, its two ends at `fixed` or free."""
    rings, count, width = gain.shape
    every = np.arange(rings)
    low = np.float32(-1e9)
    best = gain[:, 0].astype(np.float32)
    if fixed is not None:
        best = np.full_like(best, low)
        best[every, fixed] = gain[every, 0, fixed]
    back = np.zeros((count, rings, width), np.int8)
    wide = np.full((rings, width + 2 * steepest), low)
    for i in range(1, count):
        wide[:, steepest : steepest + width] = best
        for move in range(1, steepest + 1):
            for way in (-move, move):
                other = wide[:, steepest + way : steepest + way + width] - np.float32(bend * move)
                np.copyto(back[i], way, where=other > best)
                np.maximum(best, other, out=best)
        best += gain[:, i]
    path = np.zeros((rings, count), int)
    path[:, -1] = best.argmax(axis=1) if fixed is None else fixed
    for i in range(count - 1, 0, -1):
        path[:, i - 1] = path[:, i] + back[i, every, path[:, i]]
    return path
