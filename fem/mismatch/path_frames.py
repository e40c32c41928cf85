"""The few frames of a recording that tell its whole path, and all the others from them.

What flesh does beyond the linear law depends on the forces, and where it remembers also on the largest so
far, not on time: a frame's state is its shares a of the recording's force patterns, and max |a| up to then,
over the recording's greatest. Between states it changes smoothly, as a Gaussian process with Matern's kernel
5/2 would (Rasmussen and Williams 2006, "Gaussian Processes for Machine Learning", eq. 4.17): every frame is
the mix of the chosen ones that such a process makes of it, and the frames chosen next are those of which it
knows least. A chosen frame brings along the one at which its own peak was reached: memory needs it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

from fem.mismatch.baseline import Seen

REACH = 1.0
"""Length of the kernel, in a recording's greatest load."""
NUGGET = 1e-6


@dataclass(frozen=True, kw_only=True)
class PathFrames:
    """`chosen`: numbers of the frames (of those used), rising; `mix`: every frame from the chosen ones."""

    chosen: Int[np.ndarray, " k"]
    mix: Float[np.ndarray, "f k"]

    @classmethod
    def of(cls, shares: Float[np.ndarray, "f r"], count: int, *, remembers: bool) -> "PathFrames":
        """About `count` frames of a recording. A law that does not remember is known without load: zero."""
        size = np.linalg.norm(shares, axis=1)
        peak = np.maximum.accumulate(size)
        reached = np.searchsorted(peak, peak)
        states = np.column_stack([shares, peak * remembers]) / max(float(size.max()), 1e-300)
        known = np.zeros((0 if remembers else 1, states.shape[1]))
        chosen = np.array([int(size.argmax())])
        while True:
            mix, unknown = _process(states, np.vstack([states[chosen], known]))
            if len(chosen) >= min(count, len(states)):
                return cls(chosen=chosen, mix=mix[:, : len(chosen)])
            unknown[chosen] = -1.0
            more = int(unknown.argmax())
            chosen = np.union1d(chosen, [more, reached[more]] if remembers else [more])


def _process(
    states: Float[np.ndarray, "f d"], known: Float[np.ndarray, "k d"]
) -> tuple[Float[np.ndarray, "f k"], Float[np.ndarray, " f"]]:
    """Weights of the known states in each, and the variance that is left of each."""
    across = _matern(states, known)
    mix = np.linalg.solve(_matern(known, known) + NUGGET * np.eye(len(known)), across.T).T
    return mix, 1 - (mix * across).sum(axis=1)


def _matern(a: Float[np.ndarray, "f d"], b: Float[np.ndarray, "k d"]) -> Float[np.ndarray, "f k"]:
    x = np.sqrt(5) / REACH * cdist(a, b)
    return np.asarray((1 + x + x**2 / 3) * np.exp(-x))


def path_frames(grasps: Sequence[Seen], count: int, *, remembers: bool) -> tuple[PathFrames, ...]:
    """Of every recording."""
    return tuple(PathFrames.of(seen.shares, count, remembers=remembers) for seen in grasps)
