"""Displacement of the markers by the measured forces on a fruit of unit modulus, in chosen frames."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.compliance_fit import MarkerTracks
from fem.estimation.frame_thinning import spacing
from fem.estimation.grasp_model import GraspModel
from fem.grasp_history import GraspHistory, PadHistory


def marker_tracks(
    history: GraspHistory, model: GraspModel, frames: Bool[np.ndarray, " t"]
) -> tuple[MarkerTracks, Float[np.ndarray, "f n 3"]]:
    """The chosen frames of all pads side by side, with the model's response to them, and the forces.

    The forces of all pads act together in a frame. Markers' places are on the scanned surface, not on the
    skin of a mesh, which cuts its corners. Noise of chosen frames that are k apart correlates by r^k, with r
    between neighbours.
    """
    force_N = np.concatenate([pad.force_N[frames] for pad in history.pads], axis=1)
    beyond = 0.0 if model.displacement_correction is None else model.displacement_correction[frames]
    unit_displacement = model.unit_displacement(force_N) + beyond
    return tracks_of(history, frames, normal=model.normal, unit_displacement=unit_displacement), force_N


def tracks_of(
    history: GraspHistory,
    frames: Bool[np.ndarray, " t"],
    *,
    normal: Float[np.ndarray, "n 3"],
    unit_displacement: Float[np.ndarray, "f n 3"],
) -> MarkerTracks:
    """The chosen frames of all pads side by side, with a response to their forces."""
    return MarkerTracks(
        place_mm=np.concatenate([pad.surface_mm for pad in history.pads]),
        normal=normal,
        position_mm=np.concatenate([pad.position_mm[frames] for pad in history.pads], axis=1),
        unit_displacement=unit_displacement,
        gel_displacement_mm=np.concatenate([pad.gel_displacement_mm[frames] for pad in history.pads], axis=1),
        episode=np.concatenate([pad.episode[frames] for pad in history.pads], axis=1),
        sd_mm=per_marker(history, lambda pad: pad.displacement_sd_mm),
        lag1=per_marker(history, lambda pad: pad.lag1 ** spacing(frames)),
    )


def per_marker(history: GraspHistory, value: Callable[[PadHistory], float]) -> Float[np.ndarray, " n"]:
    """A number of each pad, repeated for its markers, all pads side by side."""
    return np.concatenate([np.full(len(pad.rest_mm), value(pad)) for pad in history.pads])
