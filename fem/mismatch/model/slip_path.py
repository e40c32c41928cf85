"""The slip path of the skin over the gel, from the plain model's position of the skin.

D: the gel's shear if the skin stuck, which is the skin's path over the pad since it touched; g: what the gel
can bear; w: the path slid so far. At every marker, frame by frame (return mapping; Simo and Laursen 1992, "An
augmented Lagrangian treatment of contact problems involving friction", Computers and Structures 42):

    g = D - w,      |g| <= mu (k_n / k_t) d_n,      w grows along g by as much as g would exceed that

d_n: how deep the marker is pressed into the gel. A marker that slides stays behind the skin by w. D follows
from the plain model's fit, in which w itself stands: a few rounds. D's own level is not as well known as its
changes: the touch lies between two frames, the skin's place is not known. So a level of up to LEVEL_MM at the
touch is taken as an error of these, and only what is beyond as slip.
"""

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.model.marker_equations import MarkerEquations
from fem.mismatch.model.plain_model import GraspResponse

LEVEL_MM = 0.016
"""Twice the spread of D's level at the touch on sound recordings (7-9 um)."""
WHOLE_STEPS, HALF_STEPS, STILL_MM = 8, 100, 5e-4
"""Rounds end when no path asks to change by more than this: it shows in no marker. Half steps follow the
whole ones: a marker may go to and fro between touching and not (as on open-04 of the mismatch cases)."""
FIRM = 4.0
"""A marker touches where it is pressed in by so many standard deviations of its noise."""
FAR_OFF = 2.0
"""The model's own depth is used, which noise does not reach, unless so many standard deviations too small."""
SHORTEST_STEP_MM = 0.004
"""A smaller rise of depth between two frames is noise (that of one frame of the samples' sensor), and no line
to follow back."""
FARTHEST_BACK = 1.2
"""The touch is sought in a line through the first two frames, at most so many frames back."""


def slip_path(
    recording: GraspResponse,
    equations: MarkerEquations,
    *,
    compliance: float,
    mu: float,
    spring_ratio: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "f n 3"]:
    """w, mm, in the fruit frame: how far the skin has slid ahead of each marker, zero out of contact.

    `spring_ratio`: k_t / k_n of each marker's gel. Raises FemFailure (NOT_CONVERGED) where the paths still
    change after all rounds.
    """
    tracks = recording.tracks
    pressed = -_in_pad_axes(recording, tracks.gel_displacement_mm)[..., 2]
    firm = (tracks.episode >= 0) & (pressed > FIRM * tracks.sd_mm)
    at_least = pressed - FAR_OFF * tracks.sd_mm
    path = np.zeros_like(tracks.position_mm)
    excess = tracks.position_mm - tracks.place_mm - compliance * tracks.unit_displacement
    for taken in (*[1.0] * WHOLE_STEPS, *[0.5] * HALF_STEPS):
        stuck = tracks.gel_displacement_mm - equations.residual(excess + path) + path
        local = _in_pad_axes(recording, stuck)
        depth = np.maximum(-local[..., 2], at_least)
        slid = _returned(local[..., :2], depth, firm, tracks.episode, mu / spring_ratio)
        change = _in_fruit_axes(recording, slid) - path
        path = path + taken * change
        changed_mm = float(np.abs(change).max())
        if changed_mm < STILL_MM:
            return np.asarray(path)
    raise FemFailure(
        FemProblem.NOT_CONVERGED,
        f"the slid path at a friction of {mu:.3g} still changes by {1e3 * changed_mm:.2g} µm after "
        f"{WHOLE_STEPS + HALF_STEPS} rounds, expected {1e3 * STILL_MM:.2g} µm at most",
    )


def _in_pad_axes(recording: GraspResponse, vectors: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
    """Markers' vectors of the fruit frame, each in its own pad's axes."""
    in_pad_axes = np.empty_like(vectors)
    for pad, pose in enumerate(recording.pose):
        markers = recording.pad_of_marker == pad
        in_pad_axes[:, markers] = vectors[:, markers] @ pose[:, :3, :3]
    return in_pad_axes


def _in_fruit_axes(
    recording: GraspResponse, along_pad: Float[np.ndarray, "f n 2"]
) -> Float[np.ndarray, "f n 3"]:
    """Markers' vectors along their own pad's x and y, in the fruit frame."""
    in_fruit_axes = np.empty((*along_pad.shape[:2], 3))
    for pad, pose in enumerate(recording.pose):
        markers = recording.pad_of_marker == pad
        in_fruit_axes[:, markers] = along_pad[:, markers] @ np.swapaxes(pose[:, :3, :2], 1, 2)
    return in_fruit_axes


def _returned(
    shear: Float[np.ndarray, "f n 2"],
    depth: Float[np.ndarray, "f n"],
    firm: np.ndarray,
    episode: np.ndarray,
    slope: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "f n 2"]:
    """The return mapping, frame by frame, each contact beginning without slip."""
    count = shear.shape[1]
    level, slid, contact = np.zeros((count, 2)), np.zeros((count, 2)), np.full(count, -1)
    path = np.zeros_like(shear)
    for frame in range(len(shear)):
        fresh = firm[frame] & (episode[frame] != contact)
        if fresh.any():
            level[fresh] = _excess_of_level(_at_touch(shear[:, fresh], depth[:, fresh], frame))
            slid[fresh], contact[fresh] = 0.0, episode[frame][fresh]
        asked = shear[frame] - level - slid
        size = np.linalg.norm(asked, axis=1)
        over = np.where(firm[frame], np.maximum(size - slope * depth[frame], 0.0), 0.0)
        slid = slid + asked * (over / np.maximum(size, 1e-12))[:, None]
        path[frame] = np.where(
            (episode[frame] >= 0)[:, None] & (episode[frame] == contact)[:, None], slid, 0.0
        )
    return path


def _at_touch(
    shear: Float[np.ndarray, "f n 2"], depth: Float[np.ndarray, "f n"], frame: int
) -> Float[np.ndarray, "n 2"]:
    """D where the depth was zero, in a line through this frame and the next."""
    after = min(frame + 1, len(shear) - 1)
    rise = depth[after] - depth[frame]
    back = np.clip(depth[frame] / np.maximum(rise, SHORTEST_STEP_MM), 0.0, FARTHEST_BACK)
    back = np.where(rise > SHORTEST_STEP_MM, back, 0.0)
    return np.asarray(shear[frame] - back[:, None] * (shear[after] - shear[frame]))


def _excess_of_level(level_mm: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """What of a level exceeds its own error."""
    size = np.linalg.norm(level_mm, axis=1, keepdims=True)
    return np.asarray(level_mm * np.maximum(1 - LEVEL_MM / np.maximum(size, 1e-12), 0.0))
