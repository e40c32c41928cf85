"""Sudden motion between two frames: no marker is taken for its neighbour, or it is said that it may be."""

import cv2
import numpy as np
import pytest
from drawn_gel import PITCH_PX, SHAPE, drawn
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactile.markers.tracking import FrameMarkers, follow, reference_of

STEPS = (0.0, 1.0, 1.02, 1.02)
"""Of the whole motion, in four frames."""


def beyond_the_view(rng: np.random.Generator) -> Float[np.ndarray, "n 2"]:
    """A grid, slightly turned, that goes on beyond all edges of the picture, so that no rim tells it."""
    columns, rows = np.meshgrid(np.arange(-4, 16) * PITCH_PX, np.arange(-4, 13) * PITCH_PX)
    angle = rng.uniform(-0.03, 0.03)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.stack([columns.ravel(), rows.ravel()], axis=1) @ turn.T + rng.uniform(0, PITCH_PX, 2)


def press(
    grid: Float[np.ndarray, "n 2"], rng: np.random.Generator, pitches: float, width_px: float
) -> Float[np.ndarray, "n 2"]:
    """Motion of a press somewhere in view that carries the gel `pitches` far, fading over `width_px`."""
    away = grid - rng.uniform([40, 40], [280, 200])
    angle = rng.uniform(0, 2 * np.pi)
    fade = np.exp(-(away**2).sum(axis=1, keepdims=True) / 2 / width_px**2)
    carried = pitches * np.array([np.cos(angle), np.sin(angle)])
    return np.asarray(PITCH_PX * fade * (carried + 0.3 * rng.random() * away / width_px))


def followed(
    grid: Float[np.ndarray, "n 2"], moves: list[Float[np.ndarray, "n 2"]], *, blur_px: float = 0.0
) -> tuple[list[FrameMarkers], Float[np.ndarray, "t n 2"]]:
    """Every frame's markers, and where they are in truth; the second frame is blurred."""
    pictures = [drawn(grid + move, noise=2.0, seed=k) for k, move in enumerate(moves)]
    if blur_px:
        pictures[1] = cv2.GaussianBlur(pictures[1], (0, 0), blur_px)
    reference = reference_of(pictures[0], source="drawn")
    away, which = cKDTree(grid).query(reference.lattice.rest_px)
    assert np.max(away) < 1.0
    return list(follow(reference, pictures)), np.stack([(grid + move)[which] for move in moves])


def a_pitch_off(frames: list[FrameMarkers], truth: Float[np.ndarray, "t n 2"]) -> float:
    """Share of the markers in view that are nearer to another one's place, in the worst frame."""
    position = np.stack([one.position_px for one in frames])
    off = np.linalg.norm(position - truth, axis=2) > PITCH_PX / 2
    return float(off.mean(axis=1).max())


@pytest.mark.parametrize("pitches", [0.3, 0.6, 0.9, 1.2, 1.5])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("blur_px", [0.0, 2.5])
def test_a_press_between_two_frames_leaves_every_marker_itself(pitches, seed, blur_px) -> None:
    rng = np.random.default_rng([seed, round(10 * pitches)])
    grid = beyond_the_view(rng)
    move = press(grid, rng, pitches, max(50.0, 60.0 * pitches))
    frames, truth = followed(grid, [step * move for step in STEPS], blur_px=blur_px)
    assert a_pitch_off(frames, truth) <= 0.02
    seen = np.isfinite(frames[-1].position_px[:, 0])
    inside = ((truth[-1] > 8) & (truth[-1] < [SHAPE[1] - 9, SHAPE[0] - 9])).all(axis=1)
    assert seen[inside].mean() > 0.95


@pytest.mark.parametrize(("pitches", "followed_so"), [(0.3, True), (0.45, True), (0.55, False), (0.7, False)])
def test_a_gel_that_moves_as_a_whole_is_said_and_followed_up_to_half_a_pitch(pitches, followed_so) -> None:
    """Beyond it a pitch less is the smaller motion, so that it is taken; nothing in the picture denies it."""
    grid = beyond_the_view(np.random.default_rng(5))
    move = np.full_like(grid, 1.0) * [pitches * PITCH_PX, 0.1 * PITCH_PX]
    frames, truth = followed(grid, [step * move for step in STEPS])
    assert a_pitch_off(frames, truth) == 0 if followed_so else a_pitch_off(frames, truth) > 0.5
    assert frames[1].certainty < 1


def test_a_press_that_leaves_part_of_the_gel_alone_is_certain() -> None:
    rng = np.random.default_rng(7)
    grid = beyond_the_view(rng)
    frames, _ = followed(grid, [step * press(grid, rng, 0.8, 50.0) for step in STEPS])
    assert min(one.certainty for one in frames) == 1


def test_a_gel_that_slides_on_at_its_speed_is_certain() -> None:
    """A motion that goes on is foreseen, so that nothing jumps."""
    grid = beyond_the_view(np.random.default_rng(8))
    moves = [np.full_like(grid, 1.0) * [0.15 * PITCH_PX * k, 0.0] for k in range(6)]
    frames, truth = followed(grid, moves)
    assert a_pitch_off(frames, truth) == 0
    assert min(one.certainty for one in frames) == 1
