"""The fit finds the injected compliance, and its error bar covers it."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from fem.estimation.coloured_noise import variance_inflation
from fem.estimation.compliance_fit import (
    GAUGE_SD_MM,
    MarkerTracks,
    fit_compliance,
    information,
    rigid_motion,
)
from fem.estimation.energy_ratio import energy_ratio

E_MPA = 0.7


def injected_tracks(rng, *, noise_mm=0.0, scale_sd=0.0, moves=True, frames=12, markers=40):
    """Two patches that touch one after another, a compliance field of their own, everything else random."""
    flat = rng.uniform(-6, 6, (2, markers, 2))
    place = np.vstack(
        [
            np.column_stack([flat[0], np.full(markers, 25.0)]),
            np.column_stack([flat[1], np.full(markers, -25.0)]),
        ]
    )
    side = np.sign(place[:, 2])
    load = np.concatenate([np.linspace(0.1, 1, frames // 2), np.linspace(1, 0.2, frames - frames // 2)])
    bowl = 1.2 - (place[:, :2] ** 2).sum(axis=1) / 60
    unit = np.zeros((frames, len(place), 3))
    unit[:, :, 2] = -np.outer(load**1.3, side * bowl)
    unit[:, :, :2] = 0.1 * load[:, None, None] * place[:, :2] / 6
    first = rng.integers(0, 4, len(place))
    episode = np.where(np.arange(frames)[:, None] >= first, 0, -1)
    motion = rng.normal(size=(frames, 6)) * 0.3 * moves
    gel = np.zeros_like(unit)
    gel[:, :, 2] = np.outer(load, side * (0.6 + 0.1 * rng.normal(size=len(place))))
    scale = scale_sd * rng.normal(size=len(place))
    truth = unit / E_MPA + np.einsum("nxk,tk->tnx", rigid_motion(place), motion)
    anywhere = rng.normal(size=(1, len(place), 3)) * 0.2
    seen = place + anywhere + truth + scale[:, None] * gel + noise_mm * rng.normal(size=truth.shape)
    force = np.zeros_like(unit)
    force[:, :, 2] = -np.outer(load, side)
    normal = np.zeros_like(place)
    normal[:, 2] = side
    tracks = MarkerTracks(
        place_mm=place,
        normal=normal,
        position_mm=seen,
        unit_displacement=unit,
        gel_displacement_mm=gel,
        episode=episode,
        sd_mm=np.full(len(place), noise_mm or 1e-3),
        lag1=np.zeros(len(place)),
    )
    return tracks, force, np.einsum("nxk,tk->tnx", rigid_motion(place), motion)


def compliance_sd(tracks, scale_sd):
    """Of 1/E, by the information of the response."""
    columns = tracks.unit_displacement[None]
    return information(tracks, columns, scale_sd=scale_sd, fruit_moves=True).normal[0, 0] ** -0.5


@pytest.mark.parametrize(("moves", "rel"), [(True, 1e-4), (False, 1e-9)], ids=["it moves", "on a base"])
def test_the_injected_modulus_is_found_whatever_the_surface_and_the_motion(moves, rel):
    tracks, _, _ = injected_tracks(np.random.default_rng(0), moves=moves)
    fit = fit_compliance(tracks, scale_sd=1e-9, fruit_moves=moves)
    assert 1 / fit.compliance == pytest.approx(E_MPA, rel=rel)
    assert fit.residual_rms_mm < 1e-5
    assert fit.motion_mm.any() == moves


def test_the_error_bar_covers_the_truth():
    scores = []
    for seed in range(60):
        tracks, _, _ = injected_tracks(np.random.default_rng(100 + seed), noise_mm=0.004, scale_sd=0.004)
        fit = fit_compliance(tracks, scale_sd=0.004, fruit_moves=True)
        scores.append((fit.compliance - 1 / E_MPA) / compliance_sd(tracks, 0.004))
    assert 0.8 < np.std(scores) < 1.2
    assert np.mean(np.abs(scores) < 1.645) > 0.82


def dense_fit(tracks, scale_sd):
    """The same least squares with every unknown written out: 1 + 6 T + n scales + 3 per contact's place."""
    frames, n = tracks.episode.shape
    rigid = rigid_motion(tracks.place_mm)
    contacts = [(i, e) for i in range(n) for e in np.unique(tracks.episode[:, i]) if e >= 0]
    first_place = 1 + 6 * frames + n
    rows, values = [], []
    for t, i in zip(*np.nonzero(tracks.episode >= 0), strict=True):
        for x in range(3):
            row = np.zeros(first_place + 3 * len(contacts))
            row[0] = tracks.unit_displacement[t, i, x]
            row[1 + 6 * t : 7 + 6 * t] = rigid[i, x]
            row[1 + 6 * frames + i] = tracks.gel_displacement_mm[t, i, x]
            row[first_place + 3 * contacts.index((i, tracks.episode[t, i])) + x] = 1
            rows.append(row / tracks.sd_mm[i])
            values.append((tracks.position_mm[t, i, x] - tracks.place_mm[i, x]) / tracks.sd_mm[i])
    a = np.array(rows)
    prior = np.zeros(a.shape[1])
    prior[1 : 1 + 6 * frames] = 1 / GAUGE_SD_MM**2
    prior[1 + 6 * frames : first_place] = 1 / scale_sd**2
    inverse = np.linalg.inv(a.T @ a + np.diag(prior))
    return (inverse @ a.T @ np.array(values))[0], np.sqrt(inverse[0, 0])


def test_eliminating_places_and_scales_changes_nothing():
    tracks, _, _ = injected_tracks(np.random.default_rng(3), noise_mm=0.004, scale_sd=0.004, frames=8)
    every_third = slice(None, None, 3)
    episode = tracks.episode[:, every_third].copy()
    episode[4, ::2] = -1
    episode[5:, ::2] = 1
    few = replace(
        tracks,
        place_mm=tracks.place_mm[every_third],
        normal=tracks.normal[every_third],
        position_mm=tracks.position_mm[:, every_third],
        unit_displacement=tracks.unit_displacement[:, every_third],
        gel_displacement_mm=tracks.gel_displacement_mm[:, every_third],
        episode=episode,
        sd_mm=tracks.sd_mm[every_third] * np.linspace(0.5, 2, episode.shape[1]),
        lag1=tracks.lag1[every_third],
    )
    fit = fit_compliance(few, scale_sd=0.004, fruit_moves=True)
    compliance, sd = dense_fit(few, 0.004)
    assert fit.compliance == pytest.approx(compliance, rel=1e-7)
    assert compliance_sd(few, 0.004) == pytest.approx(sd, rel=1e-6)


def test_a_long_recording_fits_in_memory():
    """800 markers in 120 frames: one (n, t, t) array alone would hold 92 MB, the fit stays below 60."""
    rng = np.random.default_rng(0)
    tracks, _, _ = injected_tracks(rng, noise_mm=0.004, frames=120, markers=400)
    tracemalloc.start()
    fit = fit_compliance(tracks, scale_sd=0.004, fruit_moves=True)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert 1 / fit.compliance == pytest.approx(E_MPA, rel=0.01)
    assert peak < 60e6


def coloured(rng, shape, lag1):
    """First-order autoregressive noise of unit spread along the first axis."""
    noise = rng.normal(size=shape)
    for t in range(1, len(noise)):
        noise[t] = lag1 * noise[t - 1] + np.sqrt(1 - lag1**2) * noise[t]
    return noise


def test_the_variance_of_a_mean_of_coloured_noise():
    for lag1 in (0.0, 0.5, 0.8):
        means = coloured(np.random.default_rng(0), (400, 20000), lag1).mean(axis=0)
        expected = variance_inflation(np.array([lag1]))[0]
        assert 400 * means.var() == pytest.approx(expected, rel=0.04)


@pytest.mark.parametrize("lag1", [0.4, 0.8])
def test_the_error_bars_know_of_coloured_noise(lag1):
    by_squares, by_energy = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        tracks, force, motion = injected_tracks(rng, frames=60)
        seen = tracks.position_mm + 0.01 * coloured(rng, tracks.position_mm.shape, lag1)
        n = len(tracks.place_mm)
        tracks = replace(tracks, position_mm=seen, sd_mm=np.full(n, 0.01), lag1=np.full(n, lag1))
        fit = fit_compliance(tracks, scale_sd=1e-9, fruit_moves=True)
        by_squares.append((fit.compliance - 1 / E_MPA) / compliance_sd(tracks, 1e-9))
        energy = energy_ratio(tracks, force, motion, gel_scale_sd=0.0)
        by_energy.append((energy.modulus_MPa - E_MPA) / (energy.modulus_MPa * energy.displacement_noise))
    assert 0.7 < np.std(by_squares) < 1.2
    assert 0.7 < np.std(by_energy) < 1.2


def test_residuals_are_the_noise():
    tracks, _, _ = injected_tracks(np.random.default_rng(0), noise_mm=0.004)
    fit = fit_compliance(tracks, scale_sd=0.004, fruit_moves=True)
    assert 0.75 * 0.004 < fit.residual_rms_mm < 1.02 * 0.004
    assert np.isnan(fit.residual_mm[tracks.episode < 0]).all()


def test_the_energy_ratios_error_bar_covers_the_truth():
    scores = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        energy = energy_ratio(*injected_tracks(rng, noise_mm=0.02, scale_sd=0.02), gel_scale_sd=0.02)
        sd = energy.modulus_MPa * np.hypot(energy.displacement_noise, energy.gel_scale)
        scores.append((energy.modulus_MPa - E_MPA) / sd)
    assert 0.75 < np.std(scores) < 1.25
