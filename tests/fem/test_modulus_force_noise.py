"""Noise in the forces pulls 1/E down; the frames in the air tell by how much."""

from dataclasses import replace

import numpy as np
import pytest

from fem.estimation.compliance_fit import MarkerTracks, fit_compliance
from fem.estimation.force_noise import FEWEST_NO_CONTACT_FRAMES, force_noise, noise_in_fit
from fem.estimation.grasp_model import GraspModel
from fem.estimation.sensitivity import Sensitivity
from fem.grasp_history import GraspHistory, PadHistory

COMPLIANCE = 4.0
FIT = {"scale_sd": 0.004, "fruit_moves": False}


def noisy_grasp(seed):
    """Markers on a spring field pressed up and down, forces with noise; and the same noise alone."""
    rng = np.random.default_rng(seed)
    n, t = 120, 40
    place = rng.uniform(-6, 6, (n, 3))
    near = np.exp(-(((place[:, None] - place[None]) ** 2).sum(-1)) / 18)
    load = np.sin(np.linspace(0, np.pi, t))[:, None] * np.exp(-(place**2).sum(1) / 40)
    force = np.stack([0.1 * load, 0.05 * load, load], axis=2) * 0.02

    def moved(at_markers):
        return np.einsum("nm,tmx->tnx", near, at_markers)

    felt, air = (rng.normal(0, 0.008, (t, n, 3)) for _ in range(2))
    sd = 0.004
    tracks = MarkerTracks(
        place_mm=place,
        normal=np.tile([0.0, 0.0, 1.0], (n, 1)),
        position_mm=place + COMPLIANCE * moved(force) + rng.normal(0, sd, (t, n, 3)),
        unit_displacement=moved(force + felt),
        gel_displacement_mm=np.zeros((t, n, 3)),
        episode=np.zeros((t, n), int),
        sd_mm=np.full(n, sd),
        lag1=np.zeros(n),
    )
    quiet = replace(tracks, position_mm=place + rng.normal(0, sd, (t, n, 3)), unit_displacement=moved(air))
    return tracks, quiet


def noise_of(quiet):
    return noise_in_fit(quiet, np.zeros_like(quiet.position_mm), **FIT)


@pytest.fixture(scope="module")
def noisy():
    return noisy_grasp(11)


def test_the_plain_fit_is_attenuated_and_the_corrected_one_is_not_in_the_mean():
    plain, corrected = [], []
    for seed in range(60):
        tracks, quiet = noisy_grasp(seed)
        fit = fit_compliance(tracks, **FIT)
        plain.append(fit.compliance)
        corrected.append(noise_of(quiet).taken_out(fit, tracks).compliance)
    spread = np.std(corrected) / np.sqrt(len(corrected))
    assert np.mean(plain) < COMPLIANCE - 4 * spread
    assert np.mean(corrected) == pytest.approx(COMPLIANCE, abs=3 * spread)
    assert spread < 0.01 * COMPLIANCE


def test_what_is_left_is_what_noise_in_both_explains(noisy):
    tracks, quiet = noisy
    noise = noise_of(quiet)
    corrected = noise.taken_out(fit_compliance(tracks, **FIT), tracks)
    feigned_mm = corrected.compliance * noise.moved_mm
    assert corrected.residual_rms_mm == pytest.approx(np.hypot(0.004, feigned_mm), rel=0.1)


def in_the_air(frames, force_N):
    """A recording that ends with one frame of contact after `frames` in the air."""
    episode = np.full((frames + 1, 8), -1)
    episode[-1] = 0
    still = np.zeros((frames + 1, 8, 3))
    place = np.random.default_rng(0).normal(size=(8, 3))
    pad = PadHistory(
        name="left",
        rest_mm=place,
        surface_mm=place,
        position_mm=place + still,
        gel_displacement_mm=still,
        force_N=force_N + still,
        episode=episode,
        displacement_sd_mm=0.004,
        force_sd_N=0.0,
        lag1=0.0,
    )
    return GraspHistory(time_s=np.arange(frames + 1.0), phase=("air",) * frames + ("load",), pads=(pad,))


@pytest.mark.parametrize(("frames", "force_N"), [(FEWEST_NO_CONTACT_FRAMES, 1.0), (20, 0.0)])
def test_too_little_air_or_air_behind_a_deadband_tells_nothing(noisy, frames, force_N):
    """The frame just before the first touch is not counted as air."""
    history = in_the_air(frames, force_N)
    place = history.pads[0].rest_mm
    model = GraspModel(
        place_mm=place,
        normal=place,
        compliance=np.eye(3 * len(place)),
        sensitivity=Sensitivity(causes=(), values=np.zeros((0, 1, len(place), 3))),
        discretisation=0.0,
        fruit_moves=False,
    )
    loaded = np.arange(frames + 1) == frames
    assert force_noise(history, model, noisy[0], loaded, scale_sd=0.004) is None


def test_noise_as_large_as_the_signal_is_not_corrected_for(noisy):
    tracks, quiet = noisy
    loud = replace(quiet, unit_displacement=30 * quiet.unit_displacement)
    plain = fit_compliance(tracks, **FIT)
    assert noise_of(loud).taken_out(plain, tracks) is plain


def test_a_given_compliance_is_held(noisy):
    tracks, _ = noisy
    assert fit_compliance(tracks, **FIT, compliance=3.3).compliance == pytest.approx(3.3, rel=1e-9)
