"""Markers of an image are those of the description, or the description is another sensor's."""

import numpy as np
import pytest

from tactile.gel_camera import project
from tactile.markers.reference_places import places_of
from tactile.sensors import GelCamera, marker_grid
from tactile.tactile_failure import TactileFailure, TactileProblem

POSE = np.eye(4)
POSE[2, 3] = -16.0
CAMERA = GelCamera(
    image_px=(320, 240),
    focal_px=(260.0, 260.0),
    centre_px=(159.5, 119.5),
    distortion=(-0.2, 0.03, 0.0, 0.0, 0.0),
    gel_from_camera=POSE,
)
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


@pytest.mark.parametrize(
    "other", [marker_grid(7, 9, pitch_mm=(1.3, 1.3), first_mm=None), GRID + np.array([0.9, 0.9, 0.0])]
)
def test_another_sensors_markers_are_refused(other: np.ndarray) -> None:
    with pytest.raises(
        TactileFailure, match=r"left: found .* markers at their places in the sensor's description"
    ) as caught:
        places_of(CAMERA, project(CAMERA, other), GRID, shape=(240, 320), source="left")
    assert caught.value.problem is TactileProblem.WRONG_SENSOR


def test_frames_of_another_size_are_refused() -> None:
    with pytest.raises(
        TactileFailure, match="found frames of 640 x 480 pixels, expected 320 x 240"
    ) as caught:
        places_of(CAMERA, project(CAMERA, GRID), GRID, shape=(480, 640), source="left")
    assert caught.value.problem is TactileProblem.WRONG_SENSOR
