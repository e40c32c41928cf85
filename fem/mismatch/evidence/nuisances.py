"""Nuisances, never reported as effects: what is not known exactly of fruit, pad and mesh, with priors.

Common to all recordings: the pit's place and size within the category's spread, Poisson's ratio within
its own, the dents' depth, the shares of what large deformation adds and of what the mesh withholds. Each
recording's own: undulations of the scanned surface, the pads' places on it, how far they come at each load.
And, since no model is right to the last micrometre, each pad of each recording may deviate by
NORMAL_DISCREPANCY of its response in any smooth pattern over its patch that grows with the load, or with its
square. An effect acts on all recordings by one law; these do not, which separates them.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fem.estimation.compliance_fit import rigid_motion
from fem.estimation.error_budget import ErrorBudget
from fem.estimation.sensitivity import POISSON_RATIO, SURFACE, mean_normal, tangents
from fem.mismatch.evidence.large_deformation import (
    LARGE_DEFORMATION,
    MEAN,
    SD,
    at_finite_strain,
    large_deformation,
)
from fem.mismatch.evidence.turned_fruit import TURNED_FRUIT, turned_fruit
from fem.mismatch.evidence.withheld_response import WITHHELD, WITHHELD_SD, withheld_response
from fem.mismatch.model.baseline import GraspResponse
from fem.mismatch.model.force_products import OfResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.inner_changes import OfInnerChange, inner_changes
from fem.mismatch.model.observation_delta import ObservationDelta, Regressor
from fem.mismatch.model.pads import own_markers, slid_response

NORMAL_DISCREPANCY, TANGENTIAL_DISCREPANCY = 0.005, 0.003
"""Standard deviations of a pad's own discrepancies along its normal and along the skin, as shares of its
response at the greatest load."""
SMALLEST_POISSON_SD = 0.005
"""Least spread of Poisson's ratio, however sure its source: a third of the categories' 0.015
(recon/pit/priors). Set by hand."""
DENT = 0.04
"""Standard deviation of the depth of the dent under a patch, as a share of it: markers a millimetre apart see
the pressure at a patch's rim, where it is steepest, and their own places there, to a few hundredths."""
APPROACH = 0.003
"""Standard deviation of how far a pad comes at one load, as a share of its response at the greatest: while a
patch spans a few markers they say its pressure to some percent only."""
LOADS = (0.07, 0.14, 0.25, 0.42, 0.65, 1.0)
"""Loads, as shares of the greatest, at which it departs independently; in a line between."""
FEWEST = 8
"""Markers of a pad that touch in a frame, at least: below it a smooth pattern cannot be told from its rigid
motion."""


def common_nuisances(forward: ForwardModel) -> list[Regressor]:
    """Those that all recordings share."""
    budget = forward.base.case.budget
    inner = [_inner(forward, recording) for recording in forward.base.grasps]
    names = dict.fromkeys(name for changes in inner for name in changes if name not in SURFACE)
    columns = [
        Regressor(
            name=name,
            sd=_sd(name, budget),
            fields=[changes.get(name) for changes in inner],
            of_forces=OfInnerChange(name),
        )
        for name in names
    ]
    dents = [
        ObservationDelta(markers=forward.compliance * _dent(recording, recording.tracks.unit_displacement))
        for recording in forward.base.grasps
    ]
    columns.append(Regressor(name="dent", sd=DENT, fields=dents, of_forces=OfResponse(_dent)))
    withheld = [withheld_response(forward, recording) for recording in forward.base.grasps]
    if any(response is not None for response in withheld):
        added = [
            None if response is None else ObservationDelta(markers=forward.compliance * response)
            for response in withheld
        ]
        columns.append(Regressor(name=WITHHELD, mean=1.0, sd=WITHHELD_SD, fields=added))
    beyond = beyond_small_strain(forward)
    if beyond is None:
        return columns + _turned(forward)
    held = at_finite_strain(forward)
    fields = [
        None if recording.case.name in held else ObservationDelta(markers=added)
        for recording, added in zip(forward.base.grasps, beyond, strict=True)
    ]
    return [*columns, Regressor(name=LARGE_DEFORMATION, mean=MEAN, sd=SD, fields=fields)]


def beyond_small_strain(forward: ForwardModel) -> list[Float[np.ndarray, "_f _n 3"]] | None:
    """Displacement of the markers, mm, that large deformation and the fruit's turn add at the plain 1/E; None
    where the plain model holds it already, or where it cannot be computed.
    """
    large = large_deformation(forward)
    if not isinstance(large, list):
        return None
    moved = [forward.compliance * unit for unit in large]
    for turned in _turned(forward):
        moved = [
            displacement + _at_markers(turn, displacement)
            for displacement, turn in zip(moved, turned.fields, strict=True)
        ]
    return moved


def turn_alone(forward: ForwardModel) -> list[Float[np.ndarray, "_f _n 3"]] | None:
    """Displacement of the markers, mm, by the fruit's turn, where the law of the flesh holds large
    deformation; None without a turn.
    """
    for turned in _turned(forward):
        plain = (recording.tracks.unit_displacement for recording in forward.base.grasps)
        return [
            _at_markers(turn, displacement) for displacement, turn in zip(plain, turned.fields, strict=True)
        ]
    return None


def _at_markers(
    field: ObservationDelta | None, like: Float[np.ndarray, "f n 3"]
) -> Float[np.ndarray, "f n 3"]:
    return np.zeros_like(like) if field is None or field.markers is None else field.markers


def stand_ins(forward: ForwardModel) -> list[Regressor]:
    """Those that stand in for a common one in models that hold part of it by a law of their own: the fruit's
    turn alone, for large deformation.
    """
    alone = _turned(forward) if isinstance(large_deformation(forward), list) else []
    return [replace(column, stands_in=True) for column in alone]


def _turned(forward: ForwardModel) -> list[Regressor]:
    """One column at most."""

    def compute() -> list[Regressor]:
        held = at_finite_strain(forward)
        turned = [
            None if recording.case.name in held else turned_fruit(forward, recording)
            for recording in forward.base.grasps
        ]
        if all(displacement is None for displacement in turned):
            return []
        added = [
            None if displacement is None else ObservationDelta(markers=displacement)
            for displacement in turned
        ]
        return [Regressor(name=TURNED_FRUIT, mean=MEAN, sd=SD, fields=added)]

    return forward.memoised(TURNED_FRUIT, compute)


def own_nuisances(
    forward: ForwardModel, recording: GraspResponse
) -> list[tuple[str, float, ObservationDelta]]:
    """Those of one recording: name, prior standard deviation, field."""
    budget = forward.base.case.budget
    nuisances = [
        (name, budget.sd_of(name, history=recording.case.history), field)
        for name, field in _inner(forward, recording).items()
        if name in SURFACE
    ]
    nuisances += [(name, budget.pose_sd_mm, field) for name, field in _places(forward, recording)]
    return nuisances + _discrepancies(forward, recording) + _approaches(forward, recording)


def _sd(name: str, budget: ErrorBudget) -> float:
    sd = budget.sd_of(name)
    return max(sd, SMALLEST_POISSON_SD) if name == POISSON_RATIO else sd


def _inner(forward: ForwardModel, recording: GraspResponse) -> dict[str, ObservationDelta]:
    return {
        cause: ObservationDelta(markers=forward.compliance * change)
        for cause, change in inner_changes(forward, recording).items()
    }


def _places(forward: ForwardModel, recording: GraspResponse) -> list[tuple[str, ObservationDelta]]:
    """Each pad along its own x and y over the skin."""
    return [
        (f"{name} {axis}", ObservationDelta(markers=forward.compliance * moved))
        for pad, name in enumerate(recording.pad_names)
        for axis, moved in zip("xy", slid_response(forward, recording, pad), strict=True)
    ]


def _dent(recording: GraspResponse, response: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
    """c without each pad's own rigid motion in each frame: the dent's shape, not how far the pads come."""
    touching = recording.tracks.episode >= 0
    dent = np.zeros_like(response)
    for pad in range(len(recording.links)):
        mine = recording.pad_of_marker == pad
        modes = rigid_motion(recording.tracks.place_mm[mine])
        for frame, on in enumerate(touching[:, mine]):
            if on.sum() < FEWEST:
                continue
            pressed = np.flatnonzero(mine)[on]
            rigid = modes[on].reshape(-1, 6)
            here = response[frame, pressed].ravel()
            motion = np.linalg.lstsq(rigid, here, rcond=None)[0]
            dent[frame, pressed] = (here - rigid @ motion).reshape(-1, 3)
    return dent


def _discrepancies(
    forward: ForwardModel, recording: GraspResponse
) -> list[tuple[str, float, ObservationDelta]]:
    """Polynomials of second degree over each patch, along three directions, times load and its square."""
    discrepancies = []
    for pad, name in enumerate(recording.pad_names):
        mine = own_markers(recording, pad)[0, :, 0]
        normal = mean_normal(recording.links[pad].place.normal)
        axes = np.vstack([tangents(recording.links[pad].place.normal), normal])
        size = _greatest_response(forward, recording, pad)
        x, y = ((recording.tracks.place_mm - recording.tracks.place_mm[mine].mean(axis=0)) @ axes[:2].T).T
        x, y = x / np.abs(x[mine]).max(), y / np.abs(y[mine]).max()
        shapes = np.stack([np.ones_like(x), x, y, x**2 - 1 / 3, x * y, y**2 - 1 / 3]) * mine
        for way, axis in enumerate(axes):
            sd = size * (NORMAL_DISCREPANCY if way == 2 else TANGENTIAL_DISCREPANCY)
            for k, shape in enumerate(shapes):
                for power in (1, 2):
                    field = (recording.load**power)[:, None, None] * (shape[:, None] * axis)
                    discrepancies.append(
                        (f"{name} discrepancy {way}{k}{power}", sd, ObservationDelta(markers=field))
                    )
    return discrepancies


def _greatest_response(forward: ForwardModel, recording: GraspResponse, pad: int) -> float:
    """Root mean square over a pad's markers of their response at the greatest load, mm."""
    mine = own_markers(recording, pad)[0, :, 0]
    response = forward.compliance * recording.tracks.unit_displacement[int(np.argmax(recording.load)), mine]
    return float(np.sqrt((response**2).sum(axis=1).mean()))


def _approaches(forward: ForwardModel, recording: GraspResponse) -> list[tuple[str, float, ObservationDelta]]:
    """Each pad along its normal, near each of LOADS, loading and unloading alike."""
    approaches = []
    near = [np.interp(recording.load, LOADS, unit) for unit in np.eye(len(LOADS))]
    for pad, name in enumerate(recording.pad_names):
        mine = own_markers(recording, pad)[0, :, 0]
        normal = mean_normal(recording.links[pad].place.normal)
        sd = APPROACH * _greatest_response(forward, recording, pad)
        for k, share in enumerate(near):
            field = share[:, None, None] * (mine[:, None] * normal)
            approaches.append((f"{name} approach {k}", sd, ObservationDelta(markers=field)))
    return approaches
