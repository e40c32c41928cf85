"""Markers are found where the pictures have them, and keep their names through motion, light and loss."""

import tracemalloc
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from drawn_gel import PITCH_PX, RADIUS_PX, SHAPE, drawn, grid
from jaxtyping import Float
from refusals import refused
from scipy.spatial import cKDTree
from turned_camera import SMALL, turned_camera

from tactile.gel_camera import project
from tactile.markers.marker_detection import Blobs, contrast, find_look, grey, markers_of, uncut
from tactile.markers.marker_lattice import lattice_of
from tactile.markers.matching import relabelled
from tactile.markers.tracking import FrameMarkers, ReferenceMarkers, follow, places_of, reference_of, track
from tactile.sensors import marker_grid
from tactile.tactile_failure import TactileProblem


def found_in(picture: np.ndarray) -> Blobs:
    intensity = grey(picture)
    look = find_look(intensity)
    return markers_of(contrast(intensity, look), look)


@pytest.mark.parametrize("dark", [True, False])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_every_marker_is_found_to_a_few_hundredths_of_a_pixel_with_its_look(dark: bool, noise: float) -> None:
    picture = drawn(grid(), dark=dark, noise=noise)
    look = find_look(grey(picture))
    assert look.dark is dark
    assert 0.7 * RADIUS_PX < look.radius_px < 1.4 * RADIUS_PX
    markers = found_in(picture)
    away, which = cKDTree(markers.centre_px).query(grid())
    assert len(markers.peak) == len(grid())
    assert len(set(which.tolist())) == len(grid())
    assert np.sqrt((away**2).mean()) < 0.04
    assert away.max() < 0.1


def test_a_large_shade_is_no_marker() -> None:
    picture = drawn(grid()).astype(float)
    rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]]
    picture *= 1 - 0.4 * np.exp(-((columns - 200) ** 2 + (rows - 120) ** 2) / 2 / 35**2)[..., None]
    assert len(found_in(picture.astype(np.uint8)).peak) == len(grid())


def test_a_speck_and_a_glint_are_no_markers() -> None:
    picture = drawn(grid())
    picture[72:74, 82:84] = 20
    picture[88:90, 127:129] = 255  # inside a marker
    assert len(found_in(picture).peak) == len(grid())


def test_a_picture_without_markers_is_refused() -> None:
    noise = np.random.default_rng(1).normal(120, 2, (240, 320, 3)).clip(0, 255).astype(np.uint8)
    with refused(TactileProblem.NO_MARKERS, r"reference\.png: found \d markers, expected at least 9"):
        reference_of(noise, source="reference.png")


CAMERA = turned_camera(0.0, **SMALL, distortion=(-0.2, 0.03, 0.0, 0.0, 0.0))
GRID = marker_grid(7, 9, pitch_mm=(1.9, 1.9), first_mm=None)


def test_markers_in_any_order_find_their_places_though_some_are_missing() -> None:
    rng = np.random.default_rng(4)
    order = rng.permutation(len(GRID))[:55]
    seen = project(CAMERA, GRID[order]) + rng.normal(scale=1.0, size=(55, 2))
    places = places_of(CAMERA, seen, GRID, shape=(240, 320), source="left")
    np.testing.assert_array_equal(places.kept, np.arange(55))
    np.testing.assert_array_equal(places.rest_mm, GRID[order])


def test_a_blob_between_the_described_markers_is_left_out() -> None:
    seen = np.vstack([project(CAMERA, GRID), project(CAMERA, GRID[30:31] + np.array([0.95, 0.95, 0.0]))])
    places = places_of(CAMERA, seen, GRID, shape=(240, 320), source="left")
    np.testing.assert_array_equal(places.kept, np.arange(len(GRID)))


def test_without_a_described_grid_a_marker_lies_where_its_ray_meets_the_face() -> None:
    places = places_of(CAMERA, project(CAMERA, GRID), None, shape=(240, 320), source="left")
    np.testing.assert_allclose(places.rest_mm, GRID, atol=1e-6)


NOT_AT_THEIR_PLACES = r"left: found .* markers at their places in the sensor's description"


@pytest.mark.parametrize(
    ("other", "shape", "words"),
    [
        (marker_grid(7, 9, pitch_mm=(1.3, 1.3), first_mm=None), (240, 320), NOT_AT_THEIR_PLACES),
        (GRID + np.array([0.9, 0.9, 0.0]), (240, 320), NOT_AT_THEIR_PLACES),
        (GRID, (480, 640), "found frames of 640 x 480 pixels, expected 320 x 240"),
    ],
    ids=["another pitch", "shifted", "frames of another size"],
)
def test_another_sensors_pictures_are_refused(other: np.ndarray, shape: tuple[int, int], words: str) -> None:
    with refused(TactileProblem.WRONG_SENSOR, words):
        places_of(CAMERA, project(CAMERA, other), GRID, shape=shape, source="left")


@pytest.mark.parametrize("s", [-0.15, 0.0, 0.3, 0.7, 1.0, 1.4])
def test_the_visible_part_tells_the_whole_discs_centre(s: float) -> None:
    radius = 5.0
    fine = np.linspace(-0.5, 30.5, 3101)
    x, y = np.meshgrid(fine, fine)
    disc = np.hypot(x - (s * radius - 0.5), y - 15.0) < radius
    centroid = np.array([[x[disc].mean(), y[disc].mean()]])
    centres = uncut(centroid, (31, 31), radius)
    np.testing.assert_allclose(centres, [[s * radius - 0.5, 15.0]], atol=0.02)


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_markers_slide_out_and_stay_themselves_to_a_third_of_a_pixel(side: str) -> None:
    reference = reference_of(drawn(grid(), noise=1.0), source="drawn")
    order = cKDTree(grid()).query(reference.lattice.rest_px)[1]
    way = {"left": (-1, 0), "right": (1, 0), "top": (0, -1), "bottom": (0, 1)}[side]
    steps = [np.multiply(way, 3.0 * k) for k in range(16)]
    position = track(reference, (drawn(grid() + s, noise=1.0, seed=k) for k, s in enumerate(steps)))
    truth = np.stack([grid()[order] + s for s in steps])
    height, width = SHAPE
    x, y = truth[..., 0], truth[..., 1]
    within = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) + 0.5
    assert np.isfinite(position[within > 0.2 * RADIUS_PX]).all()
    assert not np.isfinite(position[within < -0.6 * RADIUS_PX]).any()
    seen = np.isfinite(position[..., 0])
    assert np.abs(position - truth)[seen & (within > 0)].max() < 0.35


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
    assert np.abs(track(reference, [drawn(truth)])[0] - truth[names(reference)]).max() < 0.2


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
