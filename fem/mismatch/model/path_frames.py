"""A few representative frames of a recording, and the interpolation of all others from them.

The excess over the linear law depends on the forces, and for history-dependent laws also on the largest so
far, not on time: a frame's state is its shares a of the recording's force patterns, and max |a| up to then,
over the recording's greatest. Between states it changes smoothly, as a Gaussian process with Matern's kernel
5/2 would (Rasmussen and Williams 2006, "Gaussian Processes for Machine Learning", eq. 4.17): every frame is
the prediction of such a process from the chosen ones, and the next frame chosen is that of greatest variance.
A chosen frame brings along the one at which its own peak was reached, on which its history depends.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

from fem.mismatch.model.plain_model import GraspResponse

REACH = 2.0
"""Length of the kernel, in a recording's greatest load."""
NUGGET = 1e-6
"""On the kernel's diagonal, of a variance of 1: keeps frames that are alike from making it singular."""


@dataclass(frozen=True, kw_only=True)
class PathFrames:
    """`chosen`: numbers of the frames (of those used), rising; `mix`: every frame from the chosen ones."""

    chosen: Int[np.ndarray, " k"]
    mix: Float[np.ndarray, "f k"]


def path_frames(grasps: Sequence[GraspResponse], count: int, *, remembers: bool) -> tuple[PathFrames, ...]:
    """About `count` frames in all, of every recording as many as its path needs.

    A law that does not depend on history has no excess without load.
    """
    paths = [_Path.of(recording.shares, remembers=remembers) for recording in grasps]
    count = min(count, sum(len(path.states) for path in paths))
    while sum(len(path.chosen) for path in paths) < count:
        path = max(paths, key=lambda path: path.unknown.max())
        path.learn(int(path.unknown.argmax()))
    return tuple(PathFrames(chosen=path.chosen, mix=path.mix) for path in paths)


@dataclass
class _Path:
    """One recording while its frames are chosen. `unknown`: variance left of each frame, chosen ones -1."""

    states: Float[np.ndarray, "f d"]
    brought: Int[np.ndarray, " f"]
    known: Float[np.ndarray, "e d"]
    chosen: Int[np.ndarray, " k"]
    mix: Float[np.ndarray, "f k"]
    unknown: Float[np.ndarray, " f"]

    @classmethod
    def of(cls, shares: Float[np.ndarray, "f r"], *, remembers: bool) -> "_Path":
        """With the frame of greatest load chosen."""
        size = np.linalg.norm(shares, axis=1)
        peak = np.maximum.accumulate(size)
        states = np.column_stack([shares, peak * remembers]) / max(float(size.max()), 1e-300)
        path = cls(
            states=states,
            brought=np.searchsorted(peak, peak) if remembers else np.arange(len(states)),
            known=np.zeros((0 if remembers else 1, states.shape[1])),
            chosen=np.zeros(0, dtype=np.int64),
            mix=np.zeros((len(states), 0)),
            unknown=np.ones(len(states)),
        )
        path.learn(int(size.argmax()))
        return path

    def learn(self, frame: int) -> None:
        """Chooses one more frame, and the one at which its peak was reached."""
        self.chosen = np.union1d(self.chosen, [frame, self.brought[frame]])
        mix, self.unknown = _process(self.states, np.vstack([self.states[self.chosen], self.known]))
        self.mix = mix[:, : len(self.chosen)]
        self.unknown[self.chosen] = -1.0


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
