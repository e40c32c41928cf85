"""Finer patterns: what the leading ones leave of a growing contact, without most of the noise."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from recorded_pad import recorded_pad

from fem.estimation.finer_patterns import MOST_FINER, SMOOTHING, with_finer_patterns
from fem.estimation.prepared_grasp import PreparedGrasp, prepared_grasp
from fem.grasp_history import GraspHistory

TURN = np.eye(3)[None]
SIDE, PITCH_MM, GEL_N_PER_MM, MOVED_SD_MM = 20, 1.0, 0.2, 0.004
PLACE = PITCH_MM * np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).reshape(-1, 2)
AIR, LOADED = 12, 40


def growing_contact() -> np.ndarray:
    """A ball that rolls over a bed of springs: pressure (1 - r^2/a^2)+ in a patch that grows and wanders."""
    depth = np.pad(np.sin(np.linspace(0.05, np.pi / 2, LOADED)), (AIR, 0))
    middle = PLACE.mean(axis=0) + np.column_stack([4.0 * depth**3, 2.0 * depth])
    r2 = ((PLACE - middle[:, None]) ** 2).sum(axis=2)
    pressed = np.maximum(depth[:, None] - r2 / 40.0, 0)
    return 0.05 * np.stack([0.2 * pressed * depth[:, None], 0 * pressed, pressed], axis=2)


def recorded(rng: np.random.Generator, *, sd_mm: float = MOVED_SD_MM) -> GraspHistory:
    force = growing_contact()
    place = np.column_stack([PLACE, np.zeros(len(PLACE))])
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
        history = recorded(np.random.default_rng(seed))
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
        history = recorded(np.random.default_rng(seed))
        counts.append(with_finer_patterns(prepared_grasp(history, TURN), history)[1].count)
    assert np.mean(counts) < 0.4


def test_finer_patterns_come_between_the_leading_ones_and_those_of_a_drift() -> None:
    history = recorded(np.random.default_rng(0))
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
    history = recorded(np.random.default_rng(0))
    _, which = with_finer_patterns(prepared_grasp(history, TURN), history)
    noise = np.random.default_rng(1).normal(size=(500, which.first + which.count, len(PLACE), 3))
    smoothed = which.of_noise(noise)
    np.testing.assert_array_equal(smoothed[:, : which.first], noise[:, : which.first])
    middle = int(np.argmax(growing_contact()[-1, :, 2]))
    left = smoothed[:, which.first :, middle].var()
    assert left == pytest.approx(1 / (4 * np.pi * SMOOTHING**2), rel=0.15)
