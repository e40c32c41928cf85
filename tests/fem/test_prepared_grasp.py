"""Prepared recordings: noise in the forces pulls 1/E down no longer, and only markers that press count."""

from dataclasses import replace

import numpy as np
import pytest
from recorded_pad import recorded_pad

from fem.estimation.compliance_fit import fit_compliance
from fem.estimation.prepared_grasp import (
    FEWEST_PRESSED,
    RIM,
    prepared_grasp,
    pressing_contacts,
)
from fem.estimation.unit_response import tracks_of
from fem.fem_failure import FemFailure, FemProblem
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
        history = recorded(np.random.default_rng(seed), moved_sd_mm=moved_sd_mm)
        ready = prepared_grasp(history, TURN)
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
    history = recorded(np.random.default_rng(2), more=drift_N)
    ready = prepared_grasp(history, TURN)
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
    with pytest.raises(FemFailure, match=f"presses on {FEWEST_PRESSED} markers at once") as caught:
        prepared_grasp(history, TURN)
    assert caught.value.problem is FemProblem.NO_LOAD
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
