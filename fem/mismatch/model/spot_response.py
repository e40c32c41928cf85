"""The response with a softer ball in the flesh: to first order, and in full."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csr_array

from fem.mismatch.model.baseline import Baseline, GraspResponse
from fem.solid.inclusion import Softened, times

LEAST_SHARE = 1e-5
"""A pattern of force that does less than this share of a recording's work in the ball is taken as
unchanged.
"""


def to_first_order(base: Baseline, inside: csr_array) -> list[Float[np.ndarray, "_f _n 3"] | None]:
    """K0^-1 K1 U at each recording's markers, for E = 1 MPa; None where nothing bears on the ball."""
    chosen = [_bearing(recording, inside) for recording in base.grasps]
    moved = _given_way(base, inside, _of_chosen(base, chosen))
    changes: list[Float[np.ndarray, "_f _n 3"] | None] = []
    for recording, bearing, field in zip(base.grasps, chosen, moved, strict=True):
        if not bearing.any():
            changes.append(None)
            continue
        at_markers = recording.at_markers(field[:, base.solid_of(recording).contact_nodes])
        changes.append(np.tensordot(recording.shares[:, bearing], at_markers, axes=(1, 0)))
    return changes


def softened(
    base: Baseline, inside: csr_array, ratios: Sequence[float]
) -> list[list[Float[np.ndarray, "_f _n 3"]]]:
    """Each recording's markers, for E = 1 MPa outside the ball and each of these ratios of it inside."""
    chosen = [_bearing(recording, inside) for recording in base.grasps]
    plain = _of_chosen(base, chosen)
    first = _given_way(base, inside, plain)
    second = _given_way(base, inside, first)
    return [
        _of_recording(base, recording, inside, ratios, bearing, fields)
        if bearing.any()
        else _as_it_is(recording, ratios)
        for recording, bearing, *fields in zip(base.grasps, chosen, plain, first, second, strict=True)
    ]


def _of_recording(
    base: Baseline,
    recording: GraspResponse,
    inside: csr_array,
    ratios: Sequence[float],
    chosen: Bool[np.ndarray, " r"],
    fields: Sequence[Float[np.ndarray, "c m 3"]],
) -> list[Float[np.ndarray, "f n 3"]]:
    """`fields`: U of the chosen patterns, K0^-1 K1 U, and that once more."""
    reduced = Softened.of(inside, *fields, work=_work(base, recording)[np.ix_(chosen, chosen)])
    skin = base.solid_of(recording).contact_nodes
    at_markers = np.stack([recording.at_markers(field[:, skin]) for field in fields])
    responses = []
    for ratio in ratios:
        amounts = reduced.amounts(ratio)
        amounts[0] -= np.eye(len(amounts[0]))
        more = np.einsum("fs,prs,prnx->fnx", recording.shares[:, chosen], amounts, at_markers, optimize=True)
        responses.append(np.asarray(recording.tracks.unit_displacement + more))
    return responses


def _as_it_is(recording: GraspResponse, ratios: Sequence[float]) -> list[Float[np.ndarray, "f n 3"]]:
    return [recording.tracks.unit_displacement] * len(ratios)


def _given_way(
    base: Baseline, inside: csr_array, moved: Sequence[Float[np.ndarray, "_ m 3"]]
) -> list[Float[np.ndarray, "_ m 3"]]:
    """K0^-1 K1 of each recording's fields."""
    return base.displacements([times(inside, field) for field in moved])


def _of_chosen(base: Baseline, chosen: Sequence[Bool[np.ndarray, " _"]]) -> list[Float[np.ndarray, "_ m 3"]]:
    return [recording.moved[bearing] for recording, bearing in zip(base.grasps, chosen, strict=True)]


def _bearing(recording: GraspResponse, inside: csr_array) -> Bool[np.ndarray, " r"]:
    """Which patterns do work inside the ball that counts."""
    work_inside = (recording.moved * times(inside, recording.moved)).sum(axis=(1, 2)) * (
        recording.shares**2
    ).sum(axis=0)
    whole = float((recording.tracks.unit_displacement * recording.force_N).sum())
    return np.asarray(work_inside > LEAST_SHARE * whole)


def _work(base: Baseline, recording: GraspResponse) -> Float[np.ndarray, "r r"]:
    """U_r' f_s."""
    skin = base.solid_of(recording).contact_nodes
    work = np.tensordot(
        recording.moved[:, skin], recording.nodal_of(recording.patterns), axes=([1, 2], [1, 2])
    )
    return np.asarray((work + work.T) / 2)
