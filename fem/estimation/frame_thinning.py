"""The loaded frames from which a modulus is estimated: all, or those of a long recording thinned evenly."""

import numpy as np
from jaxtyping import Bool

from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory

MOST_FRAMES = 120
"""Each frame costs one solve of the whole fruit and six unknown motions; more frames add no information."""


def loaded_frames(history: GraspHistory) -> Bool[np.ndarray, " t"]:
    """The frames from which a modulus is estimated; raises NO_LOAD if no marker ever touches."""
    loaded = np.any([(pad.episode >= 0).any(axis=1) for pad in history.pads], axis=0)
    if not loaded.any():
        raise FemFailure(FemProblem.NO_LOAD, "no frame has a marker in contact; expected a contact")
    return thinned(loaded)


def thinned(loaded: Bool[np.ndarray, " t"], *, most: int = MOST_FRAMES) -> Bool[np.ndarray, " t"]:
    """At most `most` of the `loaded` frames, evenly spread, the first and the last among them.

    A marker's contact keeps its number: the others are compared with its first frame in use, for both
    measured and computed displacement.

    >>> thinned(np.ones(7, dtype=bool), most=3)
    array([ True, False, False,  True, False, False,  True])
    """
    frames = np.flatnonzero(loaded)
    if len(frames) <= most:
        return loaded
    used = np.zeros_like(loaded)
    used[frames[np.round(np.linspace(0, len(frames) - 1, most)).astype(np.int64)]] = True
    return used


def spacing(used: Bool[np.ndarray, " t"]) -> float:
    """Median number of frames from one used frame to the next (pauses between contacts hardly matter)."""
    steps = np.diff(np.flatnonzero(used))
    return float(np.median(steps)) if len(steps) else 1.0
