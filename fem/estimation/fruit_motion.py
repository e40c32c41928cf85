"""Rigid motion of a fruit from frame to frame, x = R X + c, fitted to its markers."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from fem.estimation.compliance_fit import MarkerTracks
from fem.grasp_history import GraspHistory

ON_A_LINE = 1e-3
"""Width over length below which markers show no rotation."""


@dataclass(frozen=True)
class FruitMotion:
    """x = R X + c of the fruit in each frame."""

    turn: Float[np.ndarray, "f 3 3"]
    shift_mm: Float[np.ndarray, "f 3"]

    def into_fruit(self, x: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """Places, transformed from the recording's axes to the fruit's."""
        return self.turned(x - self.shift_mm[:, None])

    def out_of_fruit(self, x: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """Places, transformed from the fruit's axes to the recording's."""
        return np.asarray(x @ self.turn.swapaxes(1, 2) + self.shift_mm[:, None])

    def turned(self, v: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """Vectors in the axes of the fruit."""
        return np.asarray(v @ self.turn)


def in_fruit_axes(history: GraspHistory, used: Bool[np.ndarray, " t"], motion: FruitMotion) -> GraspHistory:
    """The recording in the fruit's own axes; frames that are not used stay as they are."""
    pads = []
    for pad in history.pads:
        position, gel, force = (
            values.copy() for values in (pad.position_mm, pad.gel_displacement_mm, pad.force_N)
        )
        position[used] = motion.into_fruit(position[used])
        gel[used], force[used] = motion.turned(gel[used]), motion.turned(force[used])
        pads.append(replace(pad, position_mm=position, gel_displacement_mm=gel, force_N=force))
    return replace(history, pads=tuple(pads))


def refined_motion(
    tracks: MarkerTracks, modelled_mm: Float[np.ndarray, "f n 3"], motion: FruitMotion
) -> FruitMotion:
    """The rigid motion that fits the modelled markers to the measured ones by least squares, frame by frame.

    `tracks`: in the axes of `motion`, which this refines. A frame whose markers show no rotation moves like
    the nearest frame with one. Source: Kabsch, Acta Crystallographica A 32, 1976.
    """
    turn, shift = motion.turn.copy(), motion.shift_mm.copy()
    spanning = [frame for frame, on in enumerate(tracks.episode >= 0) if span_a_plane(modelled_mm[frame, on])]
    for frame in spanning:
        on = tracks.episode[frame] >= 0
        here, there = modelled_mm[frame, on], tracks.position_mm[frame, on]
        more = Rotation.align_vectors(there - there.mean(axis=0), here - here.mean(axis=0))[0].as_matrix()
        shift[frame] += turn[frame] @ (there.mean(axis=0) - more @ here.mean(axis=0))
        turn[frame] = turn[frame] @ more
    for frame in np.setdiff1d(np.arange(len(turn)), spanning) if spanning else ():
        nearest = spanning[int(np.abs(np.array(spanning) - frame).argmin())]
        turn[frame], shift[frame] = turn[nearest], shift[nearest]
    return FruitMotion(turn, shift)


def span_a_plane(places: Float[np.ndarray, "n 3"]) -> bool:
    """Whether places do not lie on a line."""
    if len(places) < 3:
        return False
    size = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    return bool(size[1] > ON_A_LINE * size[0])
