"""Noise in the forces pulls 1/E down; the frames in the air tell by how much."""

from dataclasses import replace

import numpy as np
import pytest

from fem.modulus_fit import MarkerTracks, fit_compliance
from fem.modulus_force_noise import without_force_noise

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


@pytest.fixture(scope="module")
def noisy():
    return noisy_grasp(11)


def test_the_plain_fit_is_attenuated_and_the_corrected_one_is_not_in_the_mean():
    plain, corrected = [], []
    for seed in range(60):
        tracks, quiet = noisy_grasp(seed)
        fit = fit_compliance(tracks, **FIT)
        plain.append(fit.compliance)
        corrected.append(without_force_noise(fit, tracks, quiet, **FIT)[0].compliance)
    spread = np.std(corrected) / np.sqrt(len(corrected))
    assert np.mean(plain) < COMPLIANCE - 4 * spread
    assert np.mean(corrected) == pytest.approx(COMPLIANCE, abs=3 * spread)
    assert spread < 0.01 * COMPLIANCE


def test_what_is_left_is_what_noise_in_both_explains(noisy):
    tracks, quiet = noisy
    corrected, noise_mm = without_force_noise(fit_compliance(tracks, **FIT), tracks, quiet, **FIT)
    assert corrected.residual_rms_mm == pytest.approx(np.hypot(0.004, noise_mm), rel=0.1)


def test_without_air_frames_the_fit_stays_as_it_is(noisy):
    tracks, _ = noisy
    plain = fit_compliance(tracks, **FIT)
    assert without_force_noise(plain, tracks, None, **FIT) == (plain, 0.0)


def test_noise_as_large_as_the_signal_is_not_corrected_for(noisy):
    tracks, quiet = noisy
    loud = replace(quiet, unit_displacement=30 * quiet.unit_displacement)
    plain = fit_compliance(tracks, **FIT)
    assert without_force_noise(plain, tracks, loud, **FIT) == (plain, 0.0)


def test_a_given_compliance_is_held(noisy):
    tracks, _ = noisy
    assert fit_compliance(tracks, **FIT, compliance=3.3).compliance == pytest.approx(3.3, rel=1e-9)
