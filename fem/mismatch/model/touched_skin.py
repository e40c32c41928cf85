"""Where on the undeformed skin the markers sit: the skin that they touched had been displaced before.

Registration takes the point of the scanned surface that lies straight behind a marker. A marker at the rim of
a patch meets skin that the middle of the patch has moved outward by then, by a tenth of a millimetre in soft
fruit:

    X = x_registered - (u - rigid part)_t,       u = s c halfway between the touch and the frame before

t: along the skin. The rigid part over each pad is the fruit's motion or the pad's place, both unknown anyway.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fem.estimation.compliance_fit import rigid_motion
from fem.estimation.sensitivity import mean_normal
from fem.mismatch.model.baseline import Baseline, GraspResponse, project_recording
from fem.parallel_map import parallel_map

FEWEST = 8
"""A pad that fewer markers touch stays as registered."""


def with_touched_skin(base: Baseline, *, compliance: float, workers: int = 1) -> Baseline:
    """The same recordings on the places where their markers touched, for 1/E = `compliance`."""
    scale_sd = base.case.budget.force_scale_sd

    def again(recording: GraspResponse) -> GraspResponse:
        aside = _pushed_aside(recording, compliance)
        history = recording.case.history
        pads = tuple(
            replace(pad, surface_mm=pad.surface_mm - aside[history.pad_of_marker == k])
            for k, pad in enumerate(history.pads)
        )
        case = replace(recording.case, history=replace(history, pads=pads))
        return project_recording(case, base.solid_of(recording), force_scale_sd=scale_sd)

    return replace(base, grasps=tuple(parallel_map(again, base.grasps, workers=workers)))


def _pushed_aside(recording: GraspResponse, compliance: float) -> Float[np.ndarray, "n 3"]:
    """The skin's motion along itself at each marker's first touch, mm; zero where it never touches."""
    moved = compliance * recording.tracks.unit_displacement
    touches = np.concatenate(
        [pad.episode[recording.used] >= 0 for pad in recording.case.history.pads], axis=1
    )
    first, who = touches.argmax(axis=0), np.arange(touches.shape[1])
    before = np.where((first > 0)[:, None], moved[np.maximum(first - 1, 0), who], 0.0)
    there = (before + moved[first, who]) / 2
    aside = np.zeros_like(there)
    for k, link in enumerate(recording.links):
        mine = touches.any(axis=0) & (recording.pad_of_marker == k)
        if mine.sum() < FEWEST:
            continue
        modes = rigid_motion(recording.tracks.place_mm[mine]).reshape(-1, 6)
        own = there[mine].ravel()
        own = (own - modes @ np.linalg.lstsq(modes, own, rcond=None)[0]).reshape(-1, 3)
        normal = mean_normal(link.place.normal)
        aside[mine] = own - (own @ normal)[:, None] * normal
    return np.asarray(aside)
