"""The modulus of each frame and pad: a table that shows deviations from the model first."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from fem.estimation.compliance_fit import CompliantFit, MarkerTracks
from fem.estimation.energy_ratio import since_first_touch
from fem.grasp_history import GraspHistory

BOTH = "all"


@dataclass(frozen=True, kw_only=True)
class FrameModulus:
    """The secant modulus of one frame from the markers of one pad, or of "all"; `sd` from displacement noise.

    `E_MPa` is NaN where the frame carries no signal (the markers have only just touched).
    """

    frame: int
    time_s: float
    phase: str
    pad: str
    force_N: float
    E_MPa: float
    E_sd_MPa: float


def modulus_per_frame(
    history: GraspHistory, tracks: MarkerTracks, fit: CompliantFit, loaded: Bool[np.ndarray, " t"]
) -> tuple[FrameModulus, ...]:
    """1/E = sum c . u / sum c . c over one frame's markers; c and u are since each one's first touch, less
    rigid motion."""
    c = since_first_touch(tracks.unit_displacement, tracks.episode)
    u = since_first_touch(tracks.position_mm - fit.motion_mm, tracks.episode)
    pad_of_marker = history.pad_of_marker
    groups = [(BOTH, np.ones(len(pad_of_marker), dtype=bool))]
    groups += [(pad.name, pad_of_marker == k) for k, pad in enumerate(history.pads)]
    totals = [np.linalg.norm(pad.force_N.sum(axis=1), axis=1) for pad in history.pads]
    table = []
    for pad, (name, chosen) in enumerate(groups, start=-1):
        weight = 1 / tracks.sd_mm[chosen] ** 2
        signal = np.einsum("n,tnx,tnx->t", weight, c[:, chosen], c[:, chosen])
        match = np.einsum("n,tnx,tnx->t", weight, c[:, chosen], u[:, chosen])
        force = np.mean(totals, axis=0) if pad < 0 else totals[pad]
        with np.errstate(divide="ignore", invalid="ignore"):
            modulus = np.where(match > 0, signal / match, np.nan)
            sd = modulus**2 * np.sqrt(2 / signal)  # two frames' noise enters each difference
        for row, frame in enumerate(np.flatnonzero(loaded)):
            table.append(
                FrameModulus(
                    frame=int(frame),
                    time_s=float(history.time_s[frame]),
                    phase=str(history.phase[frame]),
                    pad=name,
                    force_N=float(force[frame]),
                    E_MPa=float(modulus[row]),
                    E_sd_MPa=float(sd[row]),
                )
            )
    return tuple(table)
