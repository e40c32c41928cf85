"""The few frames of a recording that tell its whole path, and all the others between them.

What flesh does depends on the forces, on their path, not on time: a frame is its shares a of the recording's
force patterns. Frames are chosen where a broken line through the chosen ones strays farthest from the path of
(a, a |a|), whose second half bends where a law that is not linear does (Ramer 1972, "An iterative procedure
for the polygonal approximation of plane curves", Computer Graphics and Image Processing 1). A frame between
two chosen ones is the mix of theirs nearest to its own forces.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fem.mismatch.baseline import Seen


@dataclass(frozen=True, kw_only=True)
class PathFrames:
    """`chosen`: numbers of the frames (of those used), rising; `mix`: every frame from the chosen ones."""

    chosen: Int[np.ndarray, " k"]
    mix: Float[np.ndarray, "f k"]

    @classmethod
    def of(cls, shares: Float[np.ndarray, "f r"], count: int) -> "PathFrames":
        """At most `count` frames of a recording, the first and the last among them."""
        size = np.linalg.norm(shares, axis=1, keepdims=True)
        path = np.hstack([shares, shares * size / max(size.max(), 1e-300)])
        chosen = np.unique([0, int(size.argmax()), len(path) - 1])
        mix = _between(path, chosen)
        while len(chosen) < min(count, len(path)):
            stray = np.linalg.norm(path - mix @ path[chosen], axis=1)
            chosen = np.union1d(chosen, stray.argmax())
            mix = _between(path, chosen)
            if stray.max() == 0:
                break
        return cls(chosen=chosen, mix=mix)


def _between(path: Float[np.ndarray, "f d"], chosen: Int[np.ndarray, " k"]) -> Float[np.ndarray, "f k"]:
    """Weights of the two chosen frames around each frame: the nearest point of the line between them."""
    mix = np.zeros((len(path), len(chosen)))
    mix[chosen, np.arange(len(chosen))] = 1.0
    for a in range(len(chosen) - 1):
        inside = np.arange(chosen[a] + 1, chosen[a + 1])
        start, way = path[chosen[a]], path[chosen[a + 1]] - path[chosen[a]]
        along = (path[inside] - start) @ way / max(float(way @ way), 1e-300)
        share = np.clip(along, 0.0, 1.0)
        mix[inside, a], mix[inside, a + 1] = 1 - share, share
    return mix


def path_frames(grasps: Sequence[Seen], count: int) -> tuple[PathFrames, ...]:
    """Of every recording."""
    return tuple(PathFrames.of(seen.shares, count) for seen in grasps)
