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
from jaxtyping import Float

from fem.mismatch.evidence.equation_cache import marker_equations
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.inner_changes import LEADING

HARDLY_RAD = 0.005
"""Turn below which nothing is added: the shortening is then below 0.4 um at 27 mm."""
FIRST_LOADING = 0.5
"""Turns count from their mean until so much of the greatest load is reached, frames weighed by their load:
a fruit turns as it is sheared, hardly as pads close. Set by hand."""


def turned_fruit(forward: ForwardModel, recording: GraspResponse) -> Float[np.ndarray, "f n 3"] | None:
    """What the turn seen in a recording adds at its markers, mm; None where the fruit hardly turns."""
    turn = _turns(forward, recording)
    if np.abs(turn).max(initial=0.0) < HARDLY_RAD:
        return None
    tracks, s = recording.tracks, forward.compliance
    arm = tracks.place_mm - tracks.place_mm.mean(axis=0)
    w = turn[:, None]
    shortened = np.cross(w, np.cross(w, arm)) / 2
    return np.asarray(
        shortened
        + s * (np.cross(w, tracks.unit_displacement) - _under_turned_forces(forward, recording, turn))
    )


def _turns(forward: ForwardModel, recording: GraspResponse) -> Float[np.ndarray, "f 3"]:
    """The fruit's turn from where its pads first held it, frame by frame, rad."""
    tracks, load = recording.tracks, recording.load
    excess = tracks.position_mm - tracks.place_mm - forward.compliance * tracks.unit_displacement
    turn = marker_equations(forward, recording).turns(excess)
    first = slice(0, int(np.argmax(load > FIRST_LOADING)) + 1)
    return np.asarray(turn - np.average(turn[first], axis=0, weights=load[first]))


def _under_turned_forces(
    forward: ForwardModel, recording: GraspResponse, turn: Float[np.ndarray, "f 3"]
) -> Float[np.ndarray, "f n 3"]:
    """C W f at the markers, mm MPa: the leading patterns turned about each axis, solved for once."""
    patterns = recording.patterns[:LEADING]
    axes = np.eye(3)[:, None, None]
    turned = np.cross(axes, patterns[None]).reshape(-1, *patterns.shape[1:])
    solid = forward.base.solid_of(recording)
    loads = np.zeros((len(turned), len(solid.mesh.nodes_mm), 3))
    loads[:, solid.contact_nodes] = recording.nodal_of(turned)
    response = forward.base.marker_response(recording, loads).reshape(3, len(patterns), *patterns.shape[1:])
    return np.asarray(
        np.einsum("fa,fr,arnx->fnx", turn, recording.shares[:, : len(patterns)], response, optimize=True)
    )
