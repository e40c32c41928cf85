"""The fitted model's prediction of a recording, for display: travel under each force, E by frame, and where
on the skin they differ.
"""

import numpy as np
from jaxtyping import Float

from fem.estimation.energy_ratio import since_first_touch
from fem.estimation.modulus import ModulusEstimate
from fem.estimation.modulus_by_frame import BOTH
from fem.grasp_history import GraspHistory
from reports.grasp_record import FrameRecord, ModelCurveRecord

OWN_SHARE = 0.95
"""Quantile over a pad's markers used for the skin's deepest travel, so that no single marker's noise decides.
Set by hand, as tactile.plain_jaw.DEEPEST."""

FULL_LOAD = 0.9
"""Share of the greatest force: frames above it are averaged to reduce noise. Set by hand."""


def model_curves(
    estimate: ModulusEstimate,
    history: GraspHistory,
    axes: Float[np.ndarray, "p t 3"],
    travel_mm: Float[np.ndarray, " t"],
    normal_N: Float[np.ndarray, "p t"],
) -> list[ModelCurveRecord]:
    """For each pad the travel that the model predicts under the recorded force, in the frames used.

    It is the recorded travel minus the mean residual of each pad's markers along its axis into the fruit
    (`axes`), summed over the pads. `sd_mm`: E's relative error times the fruit's own part of the travel. That
    part is the deepest travel of each pad's skin since first touch, summed over the pads.
    """
    used = np.flatnonzero(estimate.loaded)
    missed, skin_mm = np.zeros(len(used)), np.zeros(len(used))
    for k, pad in enumerate(history.pads):
        along = axes[k][used]
        residual = np.einsum("fnx,fx->fn", estimate.residual_mm[:, history.pad_of_marker == k], along)
        known = np.isfinite(residual)
        missed += np.where(known, residual, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        moved_mm = since_first_touch(pad.position_mm, pad.episode)[used]
        touching = pad.episode[used] >= 0
        way = np.where(touching, np.einsum("fnx,fx->fn", moved_mm, along), np.nan)
        anywhere = touching.any(axis=1)
        skin_mm[anywhere] += np.nanquantile(way[anywhere], OWN_SHARE, axis=1)
    relative = estimate.E_sd_MPa / estimate.E_MPa
    return [
        ModelCurveRecord(
            travel_mm=np.round(travel_mm[used] - missed, 4).tolist(),
            force_N=np.round(force[used], 4).tolist(),
            sd_mm=np.round(relative * np.abs(skin_mm), 4).tolist(),
        )
        for force in normal_N
    ]


def frame_records(estimate: ModulusEstimate, travel_mm: Float[np.ndarray, " t"]) -> list[FrameRecord]:
    """E from each single frame that carries a signal, from all pads."""
    return [
        FrameRecord(
            travel_mm=round(float(travel_mm[frame.frame]), 4),
            E_MPa=float(f"{frame.E_MPa:.4g}"),
            E_sd_MPa=float(f"{frame.E_sd_MPa:.3g}"),
            unloading=frame.phase == "unload",
        )
        for frame in estimate.frames
        if frame.pad == BOTH and np.isfinite(frame.E_MPa) and frame.E_MPa > 0
    ]


def residual_at_full_load(
    estimate: ModulusEstimate,
    history: GraspHistory,
    axes: Float[np.ndarray, "p t 3"],
    normal_N: Float[np.ndarray, "p t"],
) -> dict[str, tuple[Float[np.ndarray, "_k 3"], Float[np.ndarray, " _k"]]]:
    """By pad: places on the skin (mm) of the markers that touch at FULL_LOAD, and their mean residual, um.

    Along each pad's axis into the fruit: positive where the skin went farther in than the model predicts.
    """
    used = np.flatnonzero(estimate.loaded)
    force = normal_N.sum(axis=0)[used]
    full = force >= FULL_LOAD * force.max()
    by_pad = {}
    for k, pad in enumerate(history.pads):
        residual_mm = estimate.residual_mm[:, history.pad_of_marker == k][full]
        along = np.einsum("fnx,fx->fn", residual_mm, axes[k][used][full])
        touching = np.isfinite(along).all(axis=0)
        by_pad[pad.name] = pad.surface_mm[touching], 1e3 * along[:, touching].mean(axis=0)
    return by_pad
