"""What noise in the forces does to the least-squares fit, and the fit without it.

The fit's regressor is the displacement that the measured forces cause. Noise in the forces is noise in the
regressor, and a regression on a noisy regressor is attenuated (errors in variables; Fuller 1987, Measurement
Error Models, section 1.2): 1/E comes out too small, the more so the softer the flesh and the lighter the
press.
The frames in the air hold that noise and nothing else, so they are sent through the same fit: with S the
information about 1/E that the fit has and S_n what the air alone would give,

    1/E = (S s - S_n s_n) / (S - S_n)

(method of moments). s_n, the slope that the air shows, takes care of noise that displacement and force share.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fem.estimation.compliance_fit import CompliantFit, MarkerTracks, about_episode_mean, fit_compliance
from fem.estimation.grasp_model import GraspModel
from fem.estimation.unit_response import marker_tracks
from fem.grasp_history import GraspHistory

FEWEST_NO_CONTACT_FRAMES, MOST_NO_CONTACT_FRAMES = 5, 24
"""Frames before the first touch: fewer hardly tell a variance, more than MOST_NO_CONTACT_FRAMES cost
solutions and tell it little better. Set by hand."""
LARGEST_SHARE = 0.5
"""Beyond this share of noise in the information the correction would be a guess: the fit stays as it is."""


@dataclass(frozen=True, kw_only=True)
class ForceNoise:
    """The loaded frames as if the sensor felt only what it feels in the air, sent through the fit.

    `information` and `compliance`: S_n and s_n. `moved_mm`: motion that this noise feigns for E = 1 (rms).
    """

    tracks: MarkerTracks
    force_N: Float[np.ndarray, "t n 3"]
    information: float
    compliance: float
    moved_mm: float
    scale_sd: float
    fruit_moves: bool

    def taken_out(self, fit: CompliantFit, tracks: MarkerTracks) -> CompliantFit:
        """The fit of `tracks` without the noise's share; as it is where that share is too large to trust."""
        information = fit.compliance_sd**-2
        left = information - self.information
        if self.information > LARGEST_SHARE * information:
            return fit
        compliance = (information * fit.compliance - self.information * self.compliance) / left
        corrected = fit_compliance(
            tracks, scale_sd=self.scale_sd, fruit_moves=self.fruit_moves, compliance=float(compliance)
        )
        return replace(corrected, compliance_sd=float(left**-0.5))


def force_noise(
    history: GraspHistory,
    model: GraspModel,
    tracks: MarkerTracks,
    loaded: Bool[np.ndarray, " t"],
    *,
    scale_sd: float,
) -> ForceNoise | None:
    """What the air before the first touch tells of the noise in the forces.

    Frames in the air follow each other as they were recorded, over and over. None where there are fewer than
    FEWEST_NO_CONTACT_FRAMES before the first touch, or where they carry no noise (a deadband).
    """
    first = int(np.argmax(loaded))
    no_contact = np.arange(max(0, first - 1 - MOST_NO_CONTACT_FRAMES), max(0, first - 1))
    if len(no_contact) < FEWEST_NO_CONTACT_FRAMES:
        return None
    quiet, force = marker_tracks(history, model, np.isin(np.arange(len(loaded)), no_contact))
    if not np.any(force):
        return None
    turn: Int[np.ndarray, " f"] = np.arange(len(tracks.episode)) % len(no_contact)
    felt = replace(
        tracks,
        position_mm=tracks.place_mm + _centred(quiet.gel_displacement_mm)[turn],
        unit_displacement=_centred(quiet.unit_displacement)[turn],
    )
    felt_N = np.where((tracks.episode >= 0)[:, :, None], _centred(force)[turn], 0.0)
    return noise_in_fit(felt, felt_N, scale_sd=scale_sd, fruit_moves=model.fruit_moves)


def noise_in_fit(
    noise: MarkerTracks, force_N: Float[np.ndarray, "t n 3"], *, scale_sd: float, fruit_moves: bool
) -> ForceNoise:
    """The record of noise that comes as tracks: S_n, s_n, and the motion that it feigns."""
    alone = fit_compliance(noise, scale_sd=scale_sd, fruit_moves=fruit_moves)
    moved = about_episode_mean(noise.unit_displacement, noise.episode)[noise.episode >= 0]
    return ForceNoise(
        tracks=noise,
        force_N=force_N,
        information=alone.compliance_sd**-2,
        compliance=alone.compliance,
        moved_mm=float(np.sqrt(np.mean(moved**2))),
        scale_sd=scale_sd,
        fruit_moves=fruit_moves,
    )


def _centred(values: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
    return np.asarray(values - values.mean(axis=0))
