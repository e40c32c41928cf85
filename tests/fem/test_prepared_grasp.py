"""Prepared recordings and the fit of a compliance to them, with an error bar that covers the truth."""

import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from recorded_pad import recorded_pad
from refusals import refused

from fem.estimation.coloured_noise import variance_inflation
from fem.estimation.compliance_fit import GAUGE_SD_MM, MarkerTracks, fit_compliance, information, rigid_motion
from fem.estimation.energy_ratio import energy_ratio
from fem.estimation.finer_patterns import MOST_FINER, SMOOTHING, with_finer_patterns
from fem.estimation.prepared_grasp import (
    FEWEST_PRESSED,
    RIM,
    PreparedGrasp,
    prepared_grasp,
    pressing_contacts,
)
from fem.estimation.unit_response import tracks_of
from fem.fem_failure import FemProblem
from fem.grasp_history import GraspHistory

COMPLIANCE = 4.0
GEL_N_PER_MM = 0.2
FORCE_SD_N, MOVED_SD_MM = 0.008, 0.004
COUNT, AIR, LOADED = 120, 12, 40
TURN = np.eye(3)[None]
PLACE = np.random.default_rng(7).uniform(-6, 6, (COUNT, 3))
NEAR = np.exp(-(((PLACE[:, None] - PLACE[None]) ** 2).sum(-1)) / 18)


def moved(force):
    """The response of a field of springs, for 1/E = 1."""
    return np.einsum("nm,tmx->tnx", NEAR, force)


def truth(peak_N=0.05):
    """Forces that grow and fade between frames in the air."""
    load = np.pad(np.sin(np.linspace(0.05, np.pi - 0.05, LOADED)), AIR)
    each = load[:, None] * np.exp(-(PLACE**2).sum(1) / 40)
    return peak_N * np.stack([0.1 * each, 0.05 * each, each], axis=2)


def recorded(rng, *, peak_N=0.05, more=0.0, moved_sd_mm=MOVED_SD_MM):
    """A recording of them by a gel of springs; `more`: forces of which neither gel nor fruit knows."""
    force = truth(peak_N)
    touching = np.linalg.norm(force, axis=2) > 0
    gel = -force / GEL_N_PER_MM + rng.normal(0, moved_sd_mm, force.shape)
    position = PLACE + COMPLIANCE * moved(force) + rng.normal(0, MOVED_SD_MM, force.shape)
    felt = force + more + rng.normal(0, FORCE_SD_N, force.shape)
    pad = recorded_pad(
        PLACE, felt, touching=touching, sd_mm=moved_sd_mm, sd_N=FORCE_SD_N, position_mm=position, gel_mm=gel
    )
    phase = ("air",) * AIR + ("load",) * LOADED + ("air",) * AIR
    return GraspHistory(time_s=0.1 * np.arange(len(force)), phase=phase, pads=(pad,))


def found_compliance(history, used):
    force = history.pads[0].force_N[used]
    tracks = tracks_of(history, used, normal=np.tile([0.0, 0, 1], (COUNT, 1)), unit_displacement=moved(force))
    return fit_compliance(tracks, scale_sd=0.004, fruit_moves=False).compliance


def test_noise_in_the_forces_lowers_the_compliance_of_a_raw_recording_and_not_of_a_prepared_one():
    raw, prepared = [], []
    for seed in range(30):
        history = recorded(np.random.default_rng(seed))
        ready = prepared_grasp(history, TURN)
        raw.append(found_compliance(history, ready.used))
        prepared.append(found_compliance(ready.history, ready.used))
    spread = np.std(prepared) / np.sqrt(len(prepared))
    assert np.mean(raw) < 0.97 * COMPLIANCE
    assert np.mean(prepared) == pytest.approx(COMPLIANCE, abs=max(3 * spread, 0.004 * COMPLIANCE))
    assert spread < 0.01 * COMPLIANCE


def test_the_patterns_are_the_forces_of_the_prepared_recording():
    ready = prepared_grasp(recorded(np.random.default_rng(1)), TURN)
    driving = np.tensordot(ready.shares, ready.patterns, axes=1)
    np.testing.assert_allclose(driving, ready.history.pads[0].force_N[ready.used], atol=1e-12)
    off = driving - truth()[ready.used]
    assert np.sqrt((off**2).mean()) < 0.15 * FORCE_SD_N
    assert ready.force_sd_N == pytest.approx(GEL_N_PER_MM * MOVED_SD_MM, rel=0.1)


@pytest.mark.parametrize(("moved_sd_mm", "by_displacement"), [(MOVED_SD_MM, True), (20 * MOVED_SD_MM, False)])
def test_the_amounts_of_patterns_are_off_by_the_noise_that_is_stated(moved_sd_mm, by_displacement):
    scatter, stated = [], []
    for seed in range(20):
        ready = prepared_grasp(recorded(np.random.default_rng(seed), moved_sd_mm=moved_sd_mm), TURN)
        noise = ready.history.pattern_noise
        assert bool(noise.of_displacement.any()) == by_displacement
        off = ready.history.pads[0].force_N[ready.used] - truth()[ready.used]
        scatter.append(np.tensordot(off, noise.patterns[0], axes=2).std())
        stated.append(
            np.hypot(
                moved_sd_mm * np.linalg.norm(noise.of_displacement[0]),
                FORCE_SD_N * np.linalg.norm(noise.of_force[0]),
            )
        )
    assert np.mean(scatter) == pytest.approx(np.mean(stated), rel=0.1)


def test_a_sure_drift_of_the_zero_stays_in_the_forces_that_drive_the_model():
    drift_N = np.zeros((LOADED + 2 * AIR, COUNT, 3))
    drift_N[:, :, 2] = np.linspace(0, 0.02, len(drift_N))[:, None]
    ready = prepared_grasp(recorded(np.random.default_rng(2), more=drift_N), TURN)
    between = (ready.history.pads[0].force_N - truth())[:, :, 2].mean(axis=1)
    grown = between[-AIR:].mean() - between[:AIR].mean()
    assert grown == pytest.approx(np.ptp(drift_N) * (LOADED + AIR) / (LOADED + 2 * AIR), rel=0.05)


def pressing(normal_N, *, noise_N=0.001):
    """A pad whose markers press so, all of them in one contact."""
    normal = np.asarray(normal_N, dtype=float)
    place = np.arange(3.0 * normal.shape[1]).reshape(-1, 3)
    force = normal[:, :, None] * [0.0, 0, 1]
    return recorded_pad(place, force, touching=True, sd_mm=0.001, sd_N=noise_N)


def test_markers_on_the_rim_of_a_patch_are_no_contact():
    normal = np.ones((4, 30))
    normal[:, -3:] = 0.8 * RIM
    contact = pressing_contacts(pressing(normal), TURN[0])
    assert (contact[:, :-3] == 0).all()
    assert (contact[:, -3:] == -1).all()


@pytest.mark.parametrize(
    ("released", "off", "after"),
    [
        pytest.param(slice(FEWEST_PRESSED - 1, None), slice(None), 1, id="a pad that let go counts anew"),
        pytest.param(4, 4, 0, id="a marker that stops for a frame is still in its contact"),
    ],
)
def test_a_new_contact_begins_where_the_pad_let_go(released, off, after):
    normal, expected = np.ones((6, 30)), np.zeros((6, 30))
    normal[2, released] = 0.0
    expected[2, off] = -1
    expected[3:] = after
    np.testing.assert_array_equal(pressing_contacts(pressing(normal), TURN[0]), expected)


def test_a_touch_by_too_few_markers_is_no_load():
    normal = np.zeros((5, 30))
    normal[:, : FEWEST_PRESSED - 1] = 1.0
    pad = pressing(normal)
    history = GraspHistory(time_s=np.arange(5.0), phase=("load",) * 5, pads=(pad,))
    with refused(FemProblem.NO_LOAD, f"presses on {FEWEST_PRESSED} markers at once"):
        prepared_grasp(history, TURN)
    enough = replace(history, pads=(pressing(np.ones((5, 30))),))
    assert prepared_grasp(enough, TURN).used.all()


def test_a_drift_of_the_reading_makes_no_marker_press():
    """A force that grows in all markers, sure in the air, does not count: a third of them would press by it.

    Those at the threshold change, by what the drift is known to.
    """
    time_s = 0.1 * np.arange(LOADED + 2 * AIR)
    grown = 0.04 * (time_s / time_s[-1])[:, None, None] * np.array([0.0, 0.0, 1.0])
    still, drifting = (
        prepared_grasp(recorded(np.random.default_rng(5), more=more), TURN) for more in (0.0, grown)
    )
    pressing, with_drift = (prepared.history.pads[0].episode >= 0 for prepared in (still, drifting))
    assert (pressing != with_drift).mean() < 0.06


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
    tracks, _, _ = injected_tracks(np.random.default_rng(0), noise_mm=0.004, frames=120, markers=400)
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


SIDE, PITCH_MM = 20, 1.0
GRID_MM = PITCH_MM * np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).reshape(-1, 2)


def growing_contact() -> np.ndarray:
    """A ball that rolls over a bed of springs: pressure (1 - r^2/a^2)+ in a patch that grows and wanders."""
    depth = np.pad(np.sin(np.linspace(0.05, np.pi / 2, LOADED)), (AIR, 0))
    middle = GRID_MM.mean(axis=0) + np.column_stack([4.0 * depth**3, 2.0 * depth])
    pressed = np.maximum(depth[:, None] - ((GRID_MM - middle[:, None]) ** 2).sum(axis=2) / 40.0, 0)
    return 0.05 * np.stack([0.2 * pressed * depth[:, None], 0 * pressed, pressed], axis=2)


def rolled(rng: np.random.Generator, *, sd_mm: float = MOVED_SD_MM) -> GraspHistory:
    force = growing_contact()
    place = np.column_stack([GRID_MM, np.zeros(len(GRID_MM))])
    noise = rng.normal(0, sd_mm, force.shape)
    felt, gel = force + rng.normal(0, GEL_N_PER_MM * sd_mm, force.shape), -force / GEL_N_PER_MM + noise
    pad = recorded_pad(
        place, felt, touching=force[:, :, 2] > 0, sd_mm=sd_mm, sd_N=GEL_N_PER_MM * sd_mm,
        position_mm=place + noise, gel_mm=gel,
    )  # fmt: skip
    phase = ("air",) * AIR + ("load",) * LOADED
    return GraspHistory(time_s=0.1 * np.arange(len(force)), phase=phase, pads=(pad,))


def off_N(ready: PreparedGrasp) -> np.ndarray:
    """How far the forces of the patterns are from the true ones."""
    return np.asarray(np.tensordot(ready.shares, ready.patterns, axes=1) - growing_contact()[ready.used])


def smooth(values: np.ndarray) -> np.ndarray:
    """Mean over squares of three by three markers."""
    grid = values.reshape(len(values), SIDE, SIDE, 3)
    return np.asarray(sum(np.roll(grid, (i, j), axis=(1, 2)) for i in (-1, 0, 1) for j in (-1, 0, 1)) / 9)


def test_what_the_leading_patterns_leave_out_is_smaller_at_hardly_more_noise() -> None:
    """Of the sums over some markers: their mean error over draws of the noise, and its spread."""
    before, after, used = [], [], None
    for seed in range(16):
        history = rolled(np.random.default_rng(seed))
        ready = prepared_grasp(history, TURN)
        used = ready.used if used is None else used
        if np.array_equal(ready.used, used):
            finer, _ = with_finer_patterns(ready, history)
            before.append(off_N(ready))
            after.append(off_N(finer))
    assert len(before) > 4
    left_out, left = (mean_error([smooth(error) for error in errors]) for errors in (before, after))
    assert left < 0.75 * left_out
    assert np.std(after, axis=0).mean() < 1.05 * np.std(before, axis=0).mean()


def mean_error(errors: list[np.ndarray]) -> float:
    """Root mean square of the errors' mean, less what their noise leaves in it."""
    drawn_errors = np.stack(errors)
    return float(
        np.sqrt(
            (drawn_errors.mean(axis=0) ** 2).mean()
            - (drawn_errors.var(axis=0, ddof=1) / len(drawn_errors)).mean()
        )
    )


def test_a_contact_that_grows_in_one_shape_has_no_finer_patterns_but_by_chance(monkeypatch) -> None:
    """What its leading pattern leaves is noise."""
    last = growing_contact()[-1]
    grows = np.pad(np.sin(np.linspace(0.05, np.pi / 2, LOADED)), (AIR, 0))
    monkeypatch.setattr(sys.modules[__name__], "growing_contact", lambda: grows[:, None, None] * last)
    counts = []
    for seed in range(20):
        history = rolled(np.random.default_rng(seed))
        counts.append(with_finer_patterns(prepared_grasp(history, TURN), history)[1].count)
    assert np.mean(counts) < 0.4


def test_finer_patterns_come_between_the_leading_ones_and_those_of_a_drift() -> None:
    history = rolled(np.random.default_rng(0))
    ready = prepared_grasp(history, TURN)
    drift = np.full((1, *ready.patterns.shape[1:]), 0.1)
    drifting = replace(
        ready,
        patterns=np.concatenate([ready.patterns, drift]),
        shares=np.column_stack([ready.shares, np.zeros(len(ready.shares))]),
    )
    finer, which = with_finer_patterns(drifting, history)
    assert which.first == len(ready.patterns)
    assert 0 < which.count <= MOST_FINER
    np.testing.assert_array_equal(finer.patterns[: which.first], ready.patterns)
    np.testing.assert_array_equal(finer.patterns[-1:], drift)


def test_noise_of_the_finer_patterns_alone_is_smoothed() -> None:
    history = rolled(np.random.default_rng(0))
    _, which = with_finer_patterns(prepared_grasp(history, TURN), history)
    noise = np.random.default_rng(1).normal(size=(500, which.first + which.count, len(GRID_MM), 3))
    smoothed = which.of_noise(noise)
    np.testing.assert_array_equal(smoothed[:, : which.first], noise[:, : which.first])
    left = smoothed[:, which.first :, int(np.argmax(growing_contact()[-1, :, 2]))].var()
    assert left == pytest.approx(1 / (4 * np.pi * SMOOTHING**2), rel=0.15)
