"""Markers' places on the undeformed skin, corrected for its displacement before each marker's touch.

Registration takes the point of the scanned surface straight behind a marker. When a marker at the rim of a
patch touches, the middle of the patch has already moved the skin there aside:

    X = x_registered - (u - rigid part)_t,       u halfway between the touch and the frame before

t: tangential part. The rigid part over each pad is the fruit's motion or the pad's place, both unknown. In
soft fruit s c moves the skin along the pad by a tenth of a millimetre, and large deformation moves most of it
back. u includes both: without the second, places are 30 to 40 um off, and 1/E changes by 0.4 %.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.compliance_fit import rigid_motion
from fem.estimation.sensitivity import mean_normal
from fem.grasp_history import GraspHistory
from fem.mismatch.mismatch_case import GraspCase
from fem.mismatch.model.plain_model import Fields, GraspResponse, PlainModel, project_recording
from fem.parallel_map import parallel_map

FEWEST = 8
"""A pad with fewer touching markers keeps its registration."""


def with_touched_skin(
    base: PlainModel, moved_mm: Fields, *, most_frames: int | None = None, workers: int = 1
) -> PlainModel:
    """The same recordings with markers at the places that they touched; `moved_mm`: displacement u of the
    markers in the frames used; `most_frames`: see project_recording.
    """
    scale_sd = base.case.budget.force_scale_sd

    def again(k: int) -> GraspResponse:
        recording = base.grasps[k]
        case = touched_case(
            recording.case, recording.used, moved_mm=moved_mm[k], normal=recording.tracks.normal
        )
        return project_recording(case, recording.solid, force_scale_sd=scale_sd, most_frames=most_frames)

    grasps = parallel_map(again, range(len(base.grasps)), workers=workers)
    return replace(base, grasps=tuple(grasps))


def touched_case(
    case: GraspCase,
    used: Bool[np.ndarray, " t"],
    *,
    moved_mm: Float[np.ndarray, "f n 3"],
    normal: Float[np.ndarray, "n 3"],
) -> GraspCase:
    """The recording with markers at the places that they touched; `moved_mm`: u in the frames used;
    `normal`: of the skin, outward.
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
    """Tangential skin displacement at each marker's first touch, mm, less the pad's rigid part; else zero."""
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
