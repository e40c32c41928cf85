"""Normal equations of markers and balances: every eliminated unknown written out as a column instead."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from injected_mismatch import injected_case, only_grasp

from fem.estimation.coloured_noise import variance_inflation
from fem.estimation.compliance_fit import GAUGE_SD_MM, rigid_motion
from fem.mismatch.model.marker_equations import (
    DESIGN_EFFECT,
    LEAST_NOISE_SHARE,
    MARKER_VARIANCE_INFLATION,
    BalanceEquations,
    MarkerEquations,
)
from fem.mismatch.model.plain_model import ARM_MM, GraspResponse, plain_model
from fem.mismatch.selection.cross_validation import noise_left_mm2

COMPLIANCE, SCALE_SD = 4.0, 0.004


@cache
def recording() -> GraspResponse:
    """One recording, noise and all."""
    return plain_model(only_grasp(injected_case(), 0)).grasps[0]


@cache
def dense() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Which samples touch (flat), their weights, all unknowns' columns (flat rows), their priors' weights.

    Unknown: each contact's place along x, y, z; each marker's gel scale and its shift with the load; each
    frame's rigid motion and its noise in each force pattern.
    """
    grasp = recording()
    tracks = grasp.tracks
    episode = tracks.episode
    frames, count = episode.shape
    columns, prior = [], []

    def add(column: np.ndarray, weight: float) -> None:
        columns.append(column[episode >= 0].ravel())
        prior.append(weight)

    def blank() -> np.ndarray:
        return np.zeros((frames, count, 3))

    for marker in range(count):
        for contact in np.unique(episode[:, marker][episode[:, marker] >= 0]):
            for way in range(3):
                column = blank()
                column[episode[:, marker] == contact, marker, way] = 1
                add(column, 0.0)
        column = blank()
        column[:, marker] = tracks.gel_displacement_mm[:, marker]
        add(column, SCALE_SD**-2)
        for way in range(3):
            column = blank()
            column[:, marker, way] = grasp.load
            add(column, (COMPLIANCE * grasp.uneven[marker, way]) ** -2.0)
    rigid = rigid_motion(tracks.place_mm)
    felt = COMPLIANCE * grasp.force_sd_N * grasp.response
    for frame in range(frames):
        for mode in range(6):
            column = blank()
            column[frame] = rigid[:, :, mode]
            add(column, GAUGE_SD_MM**-2)
        for pattern in felt:
            column = blank()
            column[frame] = pattern
            add(column, 1.0)
    weight = np.broadcast_to(
        tracks.sd_mm[None, :, None] ** -2.0 / (MARKER_VARIANCE_INFLATION * DESIGN_EFFECT), (frames, count, 3)
    )
    return episode >= 0, weight[episode >= 0].ravel(), np.array(columns), np.array(prior)


@cache
def equations() -> MarkerEquations:
    """The product's own."""
    return MarkerEquations.of(recording(), compliance=COMPLIANCE, gel_scale_sd=SCALE_SD)


def left_by_least_squares(field: np.ndarray) -> np.ndarray:
    """What ridge regression on all unknowns leaves, samples in contact, flat."""
    touching, weight, columns, prior = dense()
    y = field[touching].ravel()
    normal = (columns * weight) @ columns.T + np.diag(prior)
    amounts = np.linalg.lstsq(normal, (columns * weight) @ y, rcond=1e-13)[0]
    return y - amounts @ columns


@pytest.mark.parametrize("seed", [0, 1])
def test_what_is_left_is_what_least_squares_on_every_unknown_leaves(seed):
    rng = np.random.default_rng(seed)
    grasp = recording()
    field = rng.normal(size=grasp.tracks.position_mm.shape) + grasp.tracks.unit_displacement
    touching, weight, _, _ = dense()
    expected = left_by_least_squares(field)
    np.testing.assert_allclose(equations().residual(field)[touching].ravel(), expected, atol=2e-6)
    np.testing.assert_allclose(
        equations().weighed(field)[touching].ravel(), weight * expected, atol=2e-6 * weight.max()
    )


def test_noise_leaves_what_the_dense_projection_of_its_covariance_leaves():
    tracks = recording().tracks
    touching, weight, columns, prior = dense()
    normal = (columns * weight) @ columns.T + np.diag(prior)
    left = np.eye(len(weight)) - columns.T @ (np.linalg.pinv(normal, rcond=1e-13) @ (columns * weight))
    frame, marker, way = np.nonzero(touching[:, :, None] & np.ones(3, dtype=bool))
    same = (marker[:, None] == marker) & (way[:, None] == way)
    covariance = same * tracks.lag1.mean() ** np.abs(frame[:, None] - frame) * tracks.sd_mm[marker] ** 2
    expected = np.einsum("ij,jk,ik->", left, covariance, left, optimize=True)
    assert expected < 0.97 * np.trace(covariance)
    assert noise_left_mm2(equations(), np.random.default_rng(1)) == pytest.approx(expected, rel=0.02)


def test_balance_counts_as_the_dense_marginal_of_noise_and_nuisances():
    grasp = recording()
    balance = BalanceEquations.of(grasp)
    flat = balance.nuisances.reshape(len(balance.nuisances), -1)
    noise = np.diag(1 / balance.weight.ravel())
    spread = np.linalg.inv(balance.inverse) - (flat * balance.weight.ravel()) @ flat.T
    covariance = noise + flat.T @ np.linalg.inv(spread) @ flat
    field = np.random.default_rng(4).normal(size=balance.measured.shape)
    expected = np.linalg.solve(covariance, field.ravel()).reshape(field.shape)
    np.testing.assert_allclose(
        balance.weighed(field), expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max()
    )


def test_noise_of_the_balance_is_that_of_all_markers_forces_together():
    grasp = recording()
    rng = np.random.default_rng(5)
    position = grasp.tracks.position_mm
    centre = position.mean(axis=(0, 1))
    drawn = []
    for _ in range(300):
        force = grasp.force_sd_N * rng.normal(size=position.shape[1:])
        drawn.append([*force.sum(axis=0), *(np.cross(position[5] - centre, force).sum(axis=0) / ARM_MM)])
    scatter = np.std(drawn, axis=0) * np.sqrt(BalanceEquations.of(grasp).weight[5])
    assert (np.abs(scatter - 1) < 0.25).all()


def test_the_weight_of_the_fruit_is_no_imbalance():
    grasp = recording()
    pull = np.tile([0.3, 0.0, -1.2, 0.0, 0.2, 0.0], (len(grasp.force_N), 1))
    without, with_weight = (
        float((pull * BalanceEquations.of(grasp, weight_N=weight).weighed(pull)).sum())
        for weight in (0.0, 1.5)
    )
    assert with_weight < 3.0 < 1e-3 * without


def test_a_sensor_without_noise_counts_as_if_it_had_a_share_of_the_response():
    grasp = recording()
    episode, response = grasp.tracks.episode, COMPLIANCE * grasp.tracks.unit_displacement
    squares = []
    for marker in range(episode.shape[1]):
        for contact in np.unique(episode[:, marker][episode[:, marker] >= 0]):
            moved = response[episode[:, marker] == contact, marker]
            squares.append(((moved - moved.mean(axis=0)) ** 2).ravel())
    share_mm = LEAST_NOISE_SHARE * np.sqrt(np.concatenate(squares).mean())
    counted = MARKER_VARIANCE_INFLATION * DESIGN_EFFECT * variance_inflation(grasp.tracks.lag1)
    for noise_mm, expected_mm in ((1e-6, share_mm), (0.5 * share_mm, share_mm), (3 * share_mm, 3 * share_mm)):
        seen = replace(grasp, tracks=replace(grasp.tracks, sd_mm=np.full(episode.shape[1], noise_mm)))
        weight = MarkerEquations.of(seen, compliance=COMPLIANCE, gel_scale_sd=SCALE_SD).weight
        np.testing.assert_allclose(weight, 1 / (counted * expected_mm**2), rtol=1e-9)
