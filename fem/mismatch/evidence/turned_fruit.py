"""What a fruit that turns between its pads adds to the plain model.

Markers of flesh that turns by Q(t) as a whole, under forces f that do not turn with it, are at

    y = Q (X + s C Q' f) + c

X their places, C the unit-modulus compliance, c any shift. Of Q = I + W + W^2/2 + ... the plain model has
W X, each frame's own rigid motion, and s C f. To second order there remain

    W^2 X / 2 + s (W C f - C W f)

the shortening of what turns, and the compliance that has turned with the fruit; by a shear of a millimetre
fruit turn by two degrees, which is 16 um at 27 mm. W is known from the markers themselves.
"""

import numpy as np
from jaxtyping import Float, Int

from fem.mismatch.evidence.equation_cache import marker_equations
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.inner_changes import LEADING
from fem.mismatch.model.pads import response_to

TURNED_FRUIT = "turned fruit"
"""Name of its column."""
HARDLY_RAD = 0.002
"""Turn below which nothing is added. Set by hand: W C f is then below 1 um under half a millimetre of
indentation, W^2 X / 2 below 0.1 um."""
LOADED = 0.1
"""Share of the greatest load from which on a frame counts for that: in lighter ones few markers touch."""
FIRST_LOADING = 0.5
"""Turns count from their mean until so much of a contact's greatest load is reached, frames weighed by their
load: a fruit turns as it is sheared, hardly as pads close. Set by hand."""


def turned_fruit(forward: ForwardModel, recording: GraspResponse) -> Float[np.ndarray, "f n 3"] | None:
    """What the turn seen in a recording adds at its markers, mm; None where it is held or hardly turns.

    Candidates of the next grasp (fem.mismatch.design) are predicted without a turn, also where they shear.
    """
    tracks, s = recording.tracks, forward.compliance
    excess = tracks.position_mm - tracks.place_mm - s * tracks.unit_displacement
    seen = marker_equations(forward, recording).turns(excess)
    turn = from_first_loading(seen, recording.load, tracks.episode.max(axis=1))
    loaded = recording.load > LOADED
    if np.linalg.norm(turn[loaded], axis=1).max(initial=0.0) < HARDLY_RAD:
        return None
    arm = tracks.place_mm - tracks.place_mm.mean(axis=0)
    w = turn[:, None]
    shortened = np.cross(w, np.cross(w, arm)) / 2
    turned_compliance = np.cross(w, tracks.unit_displacement) - _under_turned_forces(forward, recording, turn)
    return np.asarray(shortened + s * turned_compliance)


def from_first_loading(
    turn: Float[np.ndarray, "f 3"], load: Float[np.ndarray, " f"], contact: Int[np.ndarray, " f"]
) -> Float[np.ndarray, "f 3"]:
    """Turns from where the pads first held the fruit in each contact (numbered; -1: none), zero out of it."""
    since_first = np.zeros_like(turn)
    for number in np.unique(contact[contact >= 0]):
        frames = np.flatnonzero(contact == number)
        first = frames[: int(np.argmax(load[frames] >= FIRST_LOADING * load[frames].max())) + 1]
        since_first[frames] = turn[frames] - np.average(turn[first], axis=0, weights=load[first])
    return since_first


def _under_turned_forces(
    forward: ForwardModel, recording: GraspResponse, turn: Float[np.ndarray, "f 3"]
) -> Float[np.ndarray, "f n 3"]:
    """C W f at the markers, mm MPa: the leading patterns turned about each axis, solved for once."""
    patterns = recording.patterns[:LEADING]

    def compute() -> Float[np.ndarray, "3 r n 3"]:
        turned = np.cross(np.eye(3)[:, None, None], patterns[None]).reshape(-1, *patterns.shape[1:])
        return response_to(forward, recording, turned).reshape(3, *patterns.shape)

    response = forward.memoised(("turned forces", recording.case.name), compute)
    shares = recording.shares[:, : len(patterns)]
    return np.asarray(np.einsum("fa,fr,arnx->fnx", turn, shares, response, optimize=True))
