"""Markers that were confused with their neighbours are labelled again, backwards from later frames.

After a jump of about one spacing between two frames markers can be matched with their neighbours' blobs, for
as long as that looks smoother; when the labels become right again, all of them jump by a spacing. Labelling
backwards from there finds the frames between. Of the two labellings the one that moves the markers less in
total is right: with d the true jump and p the spacing, a wrong label moves by |d - p| at first and by p when
it is corrected, and |d - p| + p >= d.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tactile.markers.marker_lattice import Lattice, neighbours_say
from tactile.markers.matching import match

JUMP = 0.5
"""In spacings: a marker that moves further between two frames may have changed its label."""
FEWEST = 3
"""Markers that must jump together to be looked at again. Set by hand."""
LOOK_BACK = 25
"""Frames that are gone back, at most: bounds time and memory. Set by hand."""


def relabelled(
    lattice: Lattice,
    position: Float[np.ndarray, "t n 2"],
    blobs_px: Sequence[Float[np.ndarray, "_ 2"]],
) -> Float[np.ndarray, "t n 2"]:
    """`position` (px, NaN where lost) with the right labels between a jump and the jump back.

    `blobs_px`: each frame's blobs. Labels that stay wrong for more than LOOK_BACK frames are not found.
    """
    whole = position.copy()
    for t in range(2, len(position)):
        if _differ(lattice, whole[t - 1], whole[t]) < FEWEST:
            continue
        back: list[np.ndarray] = []
        after = whole[t]
        for k in range(t - 1, max(-1, t - 1 - LOOK_BACK), -1):
            now = _relabelled_frame(lattice, after, blobs_px[k])
            if _differ(lattice, now, whole[k]) < FEWEST:
                if back and _path(whole[k : t + 1], back) < 0:
                    whole[k + 1 : t] = back[::-1]
                break
            back.append(now)
            after = np.where(np.isfinite(now), now, after)
    return whole


def _relabelled_frame(
    lattice: Lattice,
    after: Float[np.ndarray, "n 2"],
    blobs_px: Float[np.ndarray, "m 2"],
) -> Float[np.ndarray, "n 2"]:
    """The blobs labelled from where the markers are one frame later."""
    known = np.isfinite(after[:, 0])
    moved = np.where(known[:, None], after - lattice.rest_px, 0.0)
    moved = np.where(known[:, None], moved, neighbours_say(lattice, moved, known, of=~known))
    best = match(lattice, [moved, np.zeros_like(moved)], blobs_px)
    return np.where(best.found[:, None], blobs_px[best.blob] if len(blobs_px) else np.nan, np.nan)


def _differ(lattice: Lattice, one: Float[np.ndarray, "n 2"], two: Float[np.ndarray, "n 2"]) -> int:
    """How many markers are elsewhere by more than half a spacing."""
    apart = np.linalg.norm(one - two, axis=1)
    return int((np.nan_to_num(apart) > JUMP * lattice.spacing_px).sum())


def _path(forward: Float[np.ndarray, "k n 2"], back: list[Float[np.ndarray, "n 2"]]) -> float:
    """How much further markers move by the second labelling, over those that both follow throughout."""
    other = np.stack([forward[0], *back[::-1], forward[-1]])
    both = np.isfinite(forward).all(axis=(0, 2)) & np.isfinite(other).all(axis=(0, 2))
    lengths = [np.linalg.norm(np.diff(way[:, both], axis=0), axis=2).sum() for way in (forward, other)]
    return float(lengths[1] - lengths[0])
