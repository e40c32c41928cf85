"""What the fitted model makes of a recording, for people to see: travel under each force, E by frame."""

import numpy as np
from jaxtyping import Float

from fem.estimation.energy_ratio import since_first_touch
from fem.estimation.modulus import ModulusEstimate
from fem.estimation.modulus_by_frame import BOTH
from fem.grasp_history import GraspHistory
from pipeline.batch.records import FrameRecord, ModelCurveRecord

OWN_SHARE = 0.95
"""Quantile over a pad's markers that stands for the skin's deepest way, whatever one marker's noise. Set by
hand, as tactile.plain_jaw.DEEPEST."""


def model_curves(
    found: ModulusEstimate,
    history: GraspHistory,
    axes: Float[np.ndarray, "p t 3"],
    travel_mm: Float[np.ndarray, " t"],
    normal_N: Float[np.ndarray, "p t"],
) -> list[ModelCurveRecord]:
    """For each pad the travel that the model has under the recorded force, in the frames that were used.

    Recorded travel less the mean residual of each pad's markers along its axis into the fruit (`axes`), the
    pads' summed. `sd_mm`: what E's error makes of it, the fruit's own part of the travel times E's relative
    error; that part is the deepest way of each pad's skin since first touch, the pads' summed.
    """
    used = np.flatnonzero(found.loaded)
    missed, own = np.zeros(len(used)), np.zeros(len(used))
    for k, pad in enumerate(history.pads):
        along = axes[k][used]
        residual = np.einsum("fnx,fx->fn", found.residual_mm[:, history.pad_of_marker == k], along)
        known = np.isfinite(residual)
        missed += np.where(known, residual, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        moved_mm = since_first_touch(pad.position_mm, pad.episode)[used]
        touching = pad.episode[used] >= 0
        way = np.where(touching, np.einsum("fnx,fx->fn", moved_mm, along), np.nan)
        anywhere = touching.any(axis=1)
        own[anywhere] += np.nanquantile(way[anywhere], OWN_SHARE, axis=1)
    relative = found.E_sd_MPa / found.E_MPa
    return [
        ModelCurveRecord(
            travel_mm=np.round(travel_mm[used] - missed, 4).tolist(),
            force_N=np.round(force[used], 4).tolist(),
            sd_mm=np.round(relative * np.abs(own), 4).tolist(),
        )
        for force in normal_N
    ]


def frame_records(found: ModulusEstimate, travel_mm: Float[np.ndarray, " t"]) -> list[FrameRecord]:
    """E by each frame alone, from all pads, where it carries a signal."""
    return [
        FrameRecord(
            travel_mm=round(float(travel_mm[one.frame]), 4),
            E_MPa=float(f"{one.E_MPa:.4g}"),
            E_sd_MPa=float(f"{one.E_sd_MPa:.3g}"),
            unloading=one.phase == "unload",
        )
        for one in found.frames
        if one.pad == BOTH and np.isfinite(one.E_MPa) and one.E_MPa > 0
    ]
