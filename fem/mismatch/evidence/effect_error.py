"""The error of an effect's own model: it grows with the effect, and sound recordings do not show it.

An effect's change of the observations is right to a share of itself only. That share may differ from
recording to recording, grow with the load, and vary over the patch: one column for each, the change times
that factor, with mean zero and a standard deviation of MODEL_ERROR. What is proportional to the plain
response is no part of it: 1/E takes that up. Without these columns a second effect stands for what the
first one's model misses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fem.mismatch.effect import Response
from fem.mismatch.effect_spec import Family
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.response_changes import changes_by

MODEL_ERROR: Mapping[Family, float] = {"object": 0.1, "interaction": 0.1, "measurement": 0.01}
"""Standard deviation of each factor, as a share of the effect's change, by family. Set by hand: a law of
flesh at small strain is off by a tenth in a grasp that strains it by a fifth; a sensor's fault has one law."""


def effect_error_columns(
    forward: ForwardModel, recorded: Sequence[GraspEquations], response: Response, *, share: float
) -> list[Regressor]:
    """Columns of a model with this response."""
    changes = _without_modulus(forward, changes_by(forward, response))
    count = len(changes)
    columns = []
    for k, change in enumerate(changes):
        fields: list[ObservationDelta | None] = [None] * count
        fields[k] = change
        columns.append(Regressor(name=f"effect error, recording {k}", sd=share, fields=fields))
    for name, factors in _factors(recorded).items():
        fields = [_times(change, factor) for change, factor in zip(changes, factors, strict=True)]
        columns.append(Regressor(name=f"effect error, {name}", sd=share, fields=fields))
    return columns


def _without_modulus(forward: ForwardModel, changes: Sequence[ObservationDelta]) -> list[ObservationDelta]:
    """The changes less their least-squares multiple of the plain response."""
    along, square = 0.0, 0.0
    for recording, change in zip(forward.base.grasps, changes, strict=True):
        touching = recording.tracks.episode >= 0
        plain = recording.tracks.unit_displacement[touching]
        along += 0.0 if change.markers is None else float((change.markers[touching] * plain).sum())
        square += float((plain**2).sum())
    return [
        change
        if change.markers is None
        else replace(change, markers=change.markers - along / square * recording.tracks.unit_displacement)
        for recording, change in zip(forward.base.grasps, changes, strict=True)
    ]


def _factors(recorded: Sequence[GraspEquations]) -> dict[str, list[Float[np.ndarray, "_f _n"]]]:
    """Of every recording from -1 to 1: the load, and the place across and along the patch of each pad."""
    factors: dict[str, list[np.ndarray]] = {"load": [], "across": [], "along": []}
    for equations in recorded:
        recording = equations.recording
        place, pads = recording.tracks.place_mm, recording.pad_of_marker
        frames = len(recording.load)
        factors["load"].append(np.repeat(2 * recording.load[:, None] - 1, len(place), axis=1))
        across, along = np.zeros(len(place)), np.zeros(len(place))
        for pad in range(len(recording.links)):
            mine = pads == pad
            turn = recording.pose[pad][0, :3, :3]
            local = (place[mine] - place[mine].mean(axis=0)) @ turn[:, :2]
            across[mine], along[mine] = (local / np.maximum(np.abs(local).max(axis=0), 1e-9)).T
        factors["across"].append(np.repeat(across[None], frames, axis=0))
        factors["along"].append(np.repeat(along[None], frames, axis=0))
    return factors


def _times(change: ObservationDelta, factor: Float[np.ndarray, "f n"]) -> ObservationDelta | None:
    """The markers' part of a change times a factor."""
    if change.markers is None:
        return None
    return replace(change, markers=change.markers * factor[:, :, None], balance=None, rest=None)
