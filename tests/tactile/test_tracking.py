"""Every marker keeps its name through motion, light, loss and return, or it is said that it may not."""

import tracemalloc
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from drawn_gel import PITCH_PX, SHAPE, drawn, grid
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactile.markers.marker_lattice import lattice_of
from tactile.markers.matching import relabelled
from tactile.markers.tracking import FrameMarkers, ReferenceMarkers, follow, reference_of, track

FRAMES = 12


@pytest.fixture(scope="module")
def reference() -> ReferenceMarkers:
    return reference_of(drawn(grid()), source="drawn")


def press(amplitude_px: float, centre: tuple[float, float] = (160.0, 120.0)) -> Float[np.ndarray, "n 2"]:
    """Markers drawn aside and spread by a press: a shift that fades with distance, and a spread."""
    away = grid() - centre
    fade = np.exp(-(away**2).sum(axis=1, keepdims=True) / 2 / 60.0**2)
    return grid() + amplitude_px * fade * ([0.8, 0.4] + 0.01 * away)


def names(reference: ReferenceMarkers) -> np.ndarray:
    """Which marker of the grid each marker of the reference is."""
    away, which = cKDTree(grid()).query(reference.lattice.rest_px)
    assert away.max() < 1.0
    return np.asarray(which)


def test_a_press_of_more_than_half_a_pitch_is_followed_to_hundredths_of_a_pixel() -> None:
    reference = reference_of(drawn(grid(), noise=2.0), source="drawn")
    truth = [press(s) for s in np.linspace(0, 0.8 * PITCH_PX, FRAMES)]
    position = track(reference, (drawn(t, noise=2.0, seed=k) for k, t in enumerate(truth)))
    error = position - np.stack(truth)[:, names(reference)]
    assert np.isfinite(position).all()
    assert np.sqrt((error**2).mean()) < 0.05


def test_a_press_already_there_in_the_first_frame_is_understood(reference: ReferenceMarkers) -> None:
    truth = press(0.8 * PITCH_PX)
    position = track(reference, [drawn(truth)])
    assert np.abs(position[0] - truth[names(reference)]).max() < 0.2


def test_the_whole_gel_jumps_by_most_of_a_pitch_between_two_frames(reference: ReferenceMarkers) -> None:
    truth = [grid(), grid() + np.array([0.8 * PITCH_PX, -0.6 * PITCH_PX])]
    position = track(reference, [drawn(t) for t in truth])
    seen = np.isfinite(position[1, :, 0])
    assert seen.mean() > 0.8  # the rest has left the frame
    assert np.abs(position[1] - truth[1][names(reference)])[seen].max() < 0.2


def test_no_light_moves_a_marker(reference: ReferenceMarkers) -> None:
    lights = np.linspace(1.0, 0.5, FRAMES)
    position = track(reference, (drawn(grid(), light=k, tilt=k - 0.2) for k in lights))
    assert np.abs(position - grid()[names(reference)]).max() < 0.08


def test_a_hidden_marker_is_lost_for_as_long_and_then_itself_again(reference: ReferenceMarkers) -> None:
    order = names(reference)
    truth = np.stack([press(s) for s in np.linspace(0, 15, FRAMES)])
    hidden = [22, 31, 32]
    shown = truth.copy()
    shown[4:8, hidden] = np.nan
    position = track(reference, (drawn(t) for t in shown))
    expected_lost = np.zeros((FRAMES, len(order)), dtype=bool)
    expected_lost[4:8] = np.isin(order, hidden)
    np.testing.assert_array_equal(~np.isfinite(position[..., 0]), expected_lost)
    assert np.abs(position - truth[:, order])[~expected_lost].max() < 0.2


def test_a_false_blob_in_a_torn_markers_stead_is_not_taken(reference: ReferenceMarkers) -> None:
    order = names(reference)
    shown = grid()
    shown[30] += [0.62 * PITCH_PX, 0.55 * PITCH_PX]  # came off and lies among the others
    position = track(reference, [drawn(grid()), drawn(shown)])
    lost = ~np.isfinite(position[1, :, 0])
    np.testing.assert_array_equal(order[lost], [30])
    assert np.abs(position[1] - grid()[order])[~lost].max() < 0.1


def test_memory_does_not_grow_with_the_number_of_frames(reference: ReferenceMarkers) -> None:
    picture = drawn(press(6.0))

    def peak_bytes(count: int) -> int:
        def frames() -> Iterator[np.ndarray]:
            for _ in range(count):
                yield picture.copy()

        tracemalloc.start()
        for _ in follow(reference, frames()):
            pass
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    peak_bytes(3)
    assert peak_bytes(60) < 1.2 * peak_bytes(6)


STEPS = (0.0, 1.0, 1.02, 1.02)
"""Of the whole motion, in four frames."""


def beyond_the_view(rng: np.random.Generator) -> Float[np.ndarray, "n 2"]:
    """A grid, slightly turned, that goes on beyond all edges of the picture, so that no rim tells it."""
    columns, rows = np.meshgrid(np.arange(-4, 16) * PITCH_PX, np.arange(-4, 13) * PITCH_PX)
    angle = rng.uniform(-0.03, 0.03)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.stack([columns.ravel(), rows.ravel()], axis=1) @ turn.T + rng.uniform(0, PITCH_PX, 2)


def press_somewhere(
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
    position = np.stack([frame.position_px for frame in frames])
    off = np.linalg.norm(position - truth, axis=2) > PITCH_PX / 2
    return float(off.mean(axis=1).max())


@pytest.mark.parametrize("pitches", [0.3, 0.6, 0.9, 1.2, 1.5])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("blur_px", [0.0, 2.5])
def test_a_press_between_two_frames_leaves_every_marker_itself(pitches, seed, blur_px) -> None:
    rng = np.random.default_rng([seed, round(10 * pitches)])
    grid = beyond_the_view(rng)
    move = press_somewhere(grid, rng, pitches, max(50.0, 60.0 * pitches))
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
    frames, _ = followed(grid, [step * press_somewhere(grid, rng, 0.8, 50.0) for step in STEPS])
    assert min(frame.certainty for frame in frames) == 1


def test_a_gel_that_slides_on_at_its_speed_is_certain() -> None:
    """A motion that goes on is foreseen, so that nothing jumps."""
    grid = beyond_the_view(np.random.default_rng(8))
    moves = [np.full_like(grid, 1.0) * [0.15 * PITCH_PX * k, 0.0] for k in range(6)]
    frames, truth = followed(grid, moves)
    assert a_pitch_off(frames, truth) == 0
    assert min(frame.certainty for frame in frames) == 1


LATTICE = lattice_of(grid(), PITCH_PX, shape=SHAPE, margin_px=0.0)
JUMPS_AT, HEALS_AT, SLIP_FRAMES = 4, 8, 14
FADE = np.exp(-((grid() - [215.0, 120.0]) ** 2).sum(axis=1) / 2 / 70.0**2)
PATCH = np.flatnonzero(FADE > 0.6)


def truth() -> Float[np.ndarray, "t n 2"]:
    """A patch jumps right by most of a pitch and slowly comes back; the gel around it follows smoothly."""
    where = np.broadcast_to(grid(), (SLIP_FRAMES, 63, 2)).copy()
    rng = np.random.default_rng(4)
    for t in range(JUMPS_AT, SLIP_FRAMES):
        where[t, :, 0] += (0.8 - 0.02 * (t - JUMPS_AT)) * PITCH_PX * FADE
    where += rng.normal(scale=0.05, size=where.shape)
    where[where[..., 0] > SHAPE[1] - 1] = np.nan
    return where


def blobs(where: Float[np.ndarray, "t n 2"]) -> list[Float[np.ndarray, "m 2"]]:
    return [frame[np.isfinite(frame[:, 0])] for frame in where]


def slipped(where: Float[np.ndarray, "t n 2"], first: int, end: int) -> Float[np.ndarray, "t n 2"]:
    """In frames `first` to `end` each marker of the patch has the blob of its left neighbour."""
    wrong = where.copy()
    for n in PATCH:
        left = np.flatnonzero(np.linalg.norm(grid() - grid()[n] + [PITCH_PX, 0], axis=1) < 1)
        inside = len(left) > 0 and left[0] in PATCH
        wrong[first:end, n] = where[first:end, left[0]] if inside else np.nan
    return wrong


def test_names_wrong_between_two_jumps_are_set_right() -> None:
    right = truth()
    wrong = slipped(right, JUMPS_AT, HEALS_AT)
    positions = relabelled(LATTICE, wrong, blobs(right))
    both = np.isfinite(positions) & np.isfinite(right)
    assert np.abs(wrong - right)[np.isfinite(wrong) & np.isfinite(right)].max() > 0.9 * PITCH_PX
    assert np.abs(positions - right)[both].max() == 0.0
    assert both.mean() > 0.97 * np.isfinite(right).mean()


def test_true_jumps_there_and_back_are_left_alone() -> None:
    right = truth()
    np.testing.assert_array_equal(relabelled(LATTICE, right, blobs(right)), right)
    right[HEALS_AT:] = right[:1]
    np.testing.assert_array_equal(relabelled(LATTICE, right, blobs(right)), right)
