"""The plain model's recordings on the skin that their markers touched (fem.estimation.touched_skin)."""

from dataclasses import replace

import numpy as np

from fem.estimation.touched_skin import pushed_aside
from fem.mismatch.model.baseline import Baseline, GraspResponse, project_recording
from fem.parallel_map import parallel_map


def with_touched_skin(base: Baseline, *, compliance: float, workers: int = 1) -> Baseline:
    """The same recordings on the places where their markers touched, for 1/E = `compliance`."""
    scale_sd = base.case.budget.force_scale_sd

    def again(recording: GraspResponse) -> GraspResponse:
        history = recording.case.history
        touched = np.concatenate([pad.episode[recording.used] >= 0 for pad in history.pads], axis=1)
        aside = pushed_aside(recording.tracks, touched, history.pad_of_marker, compliance=compliance)
        pads = tuple(
            replace(pad, surface_mm=pad.surface_mm - aside[history.pad_of_marker == k])
            for k, pad in enumerate(history.pads)
        )
        case = replace(recording.case, history=replace(history, pads=pads))
        return project_recording(case, base.solid_of(recording), force_scale_sd=scale_sd)

    return replace(base, grasps=tuple(parallel_map(again, base.grasps, workers=workers)))
