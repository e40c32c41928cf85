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

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fem.forward import UnitModulusSolid
from fem.modulus_fit import CompliantFit, MarkerTracks, about_episode_mean, fit_compliance
from fem.modulus_inputs import GraspHistory
from fem.modulus_response import marker_tracks

FEWEST_AIR_FRAMES, MOST_AIR_FRAMES = 5, 24
LARGEST_SHARE = 0.5
"""Beyond this share of noise in the information the correction would be a guess: the fit stays as it is."""


def noise_tracks(
    history: GraspHistory, solid: UnitModulusSolid, tracks: MarkerTracks, loaded: Bool[np.ndarray, " t"]
) -> tuple[MarkerTracks, Float[np.ndarray, "t n 3"]] | None:
    """The loaded frames of `tracks`, and their forces, as if the sensor felt only what it feels in the air.

    Frames in the air follow each other as they were recorded, over and over. None where there are fewer than
    FEWEST_AIR_FRAMES before the first touch, or where they carry no noise (a deadband).
    """
    first = int(np.argmax(loaded))
    air = np.arange(max(0, first - 1 - MOST_AIR_FRAMES), max(0, first - 1))
    if len(air) < FEWEST_AIR_FRAMES:
        return None
    quiet, force = marker_tracks(history, solid, np.isin(np.arange(len(loaded)), air))
    if not np.any(force):
        return None
    turn: Int[np.ndarray, " f"] = np.arange(len(tracks.episode)) % len(air)
    felt = replace(
        tracks,
        position_mm=tracks.place_mm + _centred(quiet.gel_displacement_mm)[turn],
        unit_displacement=_centred(quiet.unit_displacement)[turn],
    )
    return felt, np.where((tracks.episode >= 0)[:, :, None], _centred(force)[turn], 0.0)


def without_force_noise(
    fit: CompliantFit, tracks: MarkerTracks, noise: MarkerTracks | None, *, scale_sd: float, fruit_moves: bool
) -> tuple[CompliantFit, float]:
    """The fit with the noise's share taken out of 1/E, and that noise as marker motion (rms, mm)."""
    if noise is None:
        return fit, 0.0
    alone = fit_compliance(noise, scale_sd=scale_sd, fruit_moves=fruit_moves)
    information, share = fit.compliance_sd**-2, alone.compliance_sd**-2
    if share > LARGEST_SHARE * information:
        return fit, 0.0
    compliance = (information * fit.compliance - share * alone.compliance) / (information - share)
    corrected = fit_compliance(
        tracks, scale_sd=scale_sd, fruit_moves=fruit_moves, compliance=float(compliance)
    )
    moved = about_episode_mean(noise.unit_displacement, noise.episode)[noise.episode >= 0]
    noise_mm = abs(float(compliance)) * float(np.sqrt(np.mean(moved**2)))
    return replace(corrected, compliance_sd=float((information - share) ** -0.5)), noise_mm


def _centred(values: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
    return np.asarray(values - values.mean(axis=0))
