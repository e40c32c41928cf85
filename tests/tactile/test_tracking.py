"""Every marker keeps its name through motion, light, loss and return."""

import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest
from drawn_gel import PITCH_PX, drawn, grid
from jaxtyping import Float
from scipy.spatial import cKDTree

from tactile.markers.tracking import ReferenceMarkers, follow, reference_of, track

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
    position, quality = track(reference, (drawn(t, noise=2.0, seed=k) for k, t in enumerate(truth)))
    error = position - np.stack(truth)[:, names(reference)]
    assert np.isfinite(position).all()
    assert np.sqrt((error**2).mean()) < 0.05
    assert quality.min() > 0.7


def test_a_press_already_there_in_the_first_frame_is_understood(reference: ReferenceMarkers) -> None:
    truth = press(0.8 * PITCH_PX)
    position, _ = track(reference, [drawn(truth)])
    assert np.abs(position[0] - truth[names(reference)]).max() < 0.2


def test_the_whole_gel_jumps_by_most_of_a_pitch_between_two_frames(reference: ReferenceMarkers) -> None:
    truth = [grid(), grid() + np.array([0.8 * PITCH_PX, -0.6 * PITCH_PX])]
    position, _ = track(reference, [drawn(t) for t in truth])
    seen = np.isfinite(position[1, :, 0])
    assert seen.mean() > 0.8  # the rest has left the frame
    assert np.abs(position[1] - truth[1][names(reference)])[seen].max() < 0.2


def test_no_light_moves_a_marker(reference: ReferenceMarkers) -> None:
    lights = np.linspace(1.0, 0.5, FRAMES)
    position, _ = track(reference, (drawn(grid(), light=k, tilt=k - 0.5) for k in lights))
    assert np.abs(position - grid()[names(reference)]).max() < 0.1


def test_a_hidden_marker_is_lost_for_as_long_and_then_itself_again(reference: ReferenceMarkers) -> None:
    order = names(reference)
    truth = np.stack([press(s) for s in np.linspace(0, 15, FRAMES)])
    hidden = [22, 31, 32]
    shown = truth.copy()
    shown[4:8, hidden] = np.nan
    position, quality = track(reference, (drawn(t) for t in shown))
    expected_lost = np.zeros((FRAMES, len(order)), dtype=bool)
    expected_lost[4:8] = np.isin(order, hidden)
    np.testing.assert_array_equal(~np.isfinite(position[..., 0]), expected_lost)
    assert (quality[expected_lost] == 0).all()
    assert np.abs(position - truth[:, order])[~expected_lost].max() < 0.2


def test_a_false_blob_in_a_torn_markers_stead_is_not_taken(reference: ReferenceMarkers) -> None:
    order = names(reference)
    shown = grid()
    shown[30] += [0.62 * PITCH_PX, 0.55 * PITCH_PX]  # came off and lies among the others
    position, _ = track(reference, [drawn(grid()), drawn(shown)])
    lost = ~np.isfinite(position[1, :, 0])
    np.testing.assert_array_equal(order[lost], [30])
    assert np.abs(position[1] - grid()[order])[~lost].max() < 0.1


def test_backwards_and_forwards_agree_on_every_name(reference: ReferenceMarkers) -> None:
    frames = [drawn(press(s)) for s in (0, 8, 18, 24, 12, 3)]
    forward, backward = track(reference, frames)[0], track(reference, frames[::-1])[0][::-1]
    assert np.abs(forward - backward).max() < 0.02


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
