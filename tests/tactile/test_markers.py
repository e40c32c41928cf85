"""Markers are found where the pictures have them, and are those of the description."""

import numpy as np
import pytest
from drawn_gel import RADIUS_PX, SHAPE, drawn, grid
from scipy.spatial import cKDTree
from turned_camera import SMALL, turned_camera

from tactile.gel_camera import project
from tactile.markers.marker_detection import Blobs, contrast, find_look, grey, markers_of, uncut
from tactile.markers.tracking import places_of, reference_of, track
from tactile.sensors import marker_grid
from tactile.tactile_failure import TactileFailure, TactileProblem


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
    with pytest.raises(
        TactileFailure, match=r"reference\.png: found \d markers, expected at least 9"
    ) as caught:
        reference_of(noise, source="reference.png")
    assert caught.value.problem is TactileProblem.NO_MARKERS


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
    with pytest.raises(TactileFailure, match=words) as caught:
        places_of(CAMERA, project(CAMERA, other), GRID, shape=shape, source="left")
    assert caught.value.problem is TactileProblem.WRONG_SENSOR


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
