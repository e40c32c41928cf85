"""Where on the undeformed skin the markers sit: the skin that they touched had been displaced before.

Registration takes the point of the scanned surface that lies straight behind a marker. A marker at the rim of
a patch meets skin that the middle of the patch has moved outward by then, by a tenth of a millimetre in soft
fruit:

    X = x_registered - (u - rigid part)_t,       u = s c halfway between the touch and the frame before

t: along the skin. The rigid part over each pad is the fruit's motion or the pad's place, both unknown anyway.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.compliance_fit import rigid_motion
from fem.estimation.sensitivity import mean_normal
from fem.grasp_history import GraspHistory
from fem.mismatch.mismatch_case import GraspCase
from fem.mismatch.model.plain_model import GraspResponse, PlainModel, project_recording
from fem.parallel_map import parallel_map

FEWEST = 8
"""A pad that fewer markers touch stays as registered."""


def with_touched_skin(
    base: PlainModel, *, compliance: float, most_frames: int | None = None, workers: int = 1
) -> PlainModel:
    """The same recordings on the places where their markers touched, for 1/E = `compliance`; `most_frames` of
    each (project_recording).
    """
    scale_sd = base.case.budget.force_scale_sd

    def again(recording: GraspResponse) -> GraspResponse:
        case = touched_case(
            recording.case,
            recording.used,
            moved_mm=compliance * recording.tracks.unit_displacement,
            normal=recording.tracks.normal,
        )
        return project_recording(case, recording.solid, force_scale_sd=scale_sd, most_frames=most_frames)

    return replace(base, grasps=tuple(parallel_map(again, base.grasps, workers=workers)))


def touched_case(
    case: GraspCase,
    used: Bool[np.ndarray, " t"],
    *,
    moved_mm: Float[np.ndarray, "f n 3"],
    normal: Float[np.ndarray, "n 3"],
) -> GraspCase:
    """The recording with its markers where they touched; `moved_mm`: s c in the frames used, `normal`: of the
    skin, outward.
    """
    history = case.history
    aside = _pushed_aside(history, used, moved_mm, normal)
    pads = tuple(
        replace(pad, surface_mm=pad.surface_mm - aside[history.pad_of_marker == k])
        for k, pad in enumerate(history.pads)
    )
    return replace(case, history=replace(history, pads=pads))


def _pushed_aside(
    history: GraspHistory,
    used: Bool[np.ndarray, " t"],
    moved: Float[np.ndarray, "f n 3"],
    normal: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """The skin's motion along itself at each marker's first touch, mm; zero where it never touches."""
    touches = np.concatenate([pad.episode[used] >= 0 for pad in history.pads], axis=1)
    first, who = touches.argmax(axis=0), np.arange(touches.shape[1])
    before = np.where((first > 0)[:, None], moved[np.maximum(first - 1, 0), who], 0.0)
    there = (before + moved[first, who]) / 2
    aside = np.zeros_like(there)
    places = np.concatenate([pad.surface_mm for pad in history.pads])
    for k in range(len(history.pads)):
        own_markers = history.pad_of_marker == k
        mine = touches.any(axis=0) & own_markers
        if mine.sum() < FEWEST:
            continue
        modes = rigid_motion(places[mine]).reshape(-1, 6)
        slid = there[mine].ravel()
        slid = (slid - modes @ np.linalg.lstsq(modes, slid, rcond=None)[0]).reshape(-1, 3)
        out = mean_normal(normal[own_markers])
        aside[mine] = slid - (slid @ out)[:, None] * out
    return np.asarray(aside)
