"""A camera from a picture of dots that a known camera sees."""

import cv2
import numpy as np
import pytest

from tactile.gel.gel_sides import GelOutline
from tactile.gel_camera import on_gel, project
from tactile.sensor_description import camera_from_dots
from tactile.sensors import GelCamera, marker_grid
from tactile.tactile_failure import TactileFailure

PITCH_MM, DISTANCE_MM = (2.4, 2.36), 16.0
DOME = GelOutline((25.25, 20.75), face_radius_mm=(189.0, 114.0))


def eye(*, tilt_rad: float = 0.03) -> GelCamera:
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.array([tilt_rad, -0.02, 0.05]))[0]
    pose[:3, 3] = [0.3, -0.2, -DISTANCE_MM]
    return GelCamera(
        image_px=(320, 240),
        focal_px=(222.0, 222.0),
        centre_px=(159.5, 119.5),
        distortion=(-0.06, 0.0, 0.0, 0.0, 0.0),
        gel_from_camera=pose,
    )


def dots(outline: GelOutline | None = DOME) -> np.ndarray:
    rest = marker_grid(7, 9, pitch_mm=PITCH_MM, first_mm=None)
    if outline is not None:
        rest[:, 2] = outline.face_mm(rest[:, 0], rest[:, 1])
    return rest


def picture(camera: GelCamera, rest_mm: np.ndarray) -> np.ndarray:
    """Dark discs on grey, drawn larger and averaged."""
    fine = 8
    width, height = camera.image_px
    large = np.full((height * fine, width * fine), 150, dtype=np.uint8)
    for x, y in project(camera, rest_mm):
        at = tuple(round(float(fine * v + (fine - 1) / 2)) for v in (x, y))
        cv2.circle(large, at, round(fine * 0.035 * width / 2), 30, -1)
    small = cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA)
    return np.repeat(small[..., None], 3, axis=2)


def calibrated(seen: np.ndarray, *, outline: GelOutline | None = DOME, grid: tuple[int, int] | None = (7, 9)):
    return camera_from_dots(
        seen, pitch_mm=PITCH_MM, distance_mm=DISTANCE_MM, outline=outline, source="empty.png", grid=grid
    )


@pytest.mark.parametrize("outline", [DOME, None])
def test_the_camera_sees_the_dots_where_they_are(outline) -> None:
    true = eye()
    calibration = calibrated(picture(true, dots(outline)), outline=outline)
    assert (calibration.rows, calibration.columns, calibration.dots) == (7, 9, 63)
    assert calibration.camera.focal_px[0] == pytest.approx(true.focal_px[0], rel=0.01)
    at = on_gel(calibration.camera, project(true, dots(outline)), outline)
    assert np.abs(at - dots(outline))[:, :2].max() < 0.03
    assert calibration.off_px < 0.2


def test_a_cut_picture_shows_a_part_of_the_grid_that_is_placed_in_it() -> None:
    true = eye()
    whole = picture(true, dots())
    part = whole[20:220, 35:285]
    calibration = calibrated(np.ascontiguousarray(part))
    assert (calibration.rows, calibration.columns) == (7, 9)
    assert calibration.dots < 63
    seen = project(true, dots()) - np.array([35, 20])
    assert np.abs(on_gel(calibration.camera, seen, DOME) - dots())[:, :2].max() < 0.15


@pytest.mark.parametrize(("rows", "columns"), [(5, 9), (7, 8)])
def test_more_dots_than_the_gel_has_are_another_sensors(rows: int, columns: int) -> None:
    said = f"found a grid of 7 x 9 dots, expected {rows} x {columns} at most"
    with pytest.raises(TactileFailure, match=said):
        calibrated(picture(eye(), dots()), grid=(rows, columns))


@pytest.mark.parametrize("size_px", [None, (240, 240)])
def test_a_pressed_gel_is_refused_in_a_resized_picture_too(size_px: tuple[int, int] | None) -> None:
    rest = dots()
    push = np.exp(-(((rest[:, :2] - [3.0, 1.0]) / 4.0) ** 2).sum(axis=1))
    rest[:, :2] += 1.5 * push[:, None] * (rest[:, :2] - [3.0, 1.0]) / 4.0
    seen = picture(eye(), rest)
    if size_px is not None:
        seen = cv2.resize(seen, size_px, interpolation=cv2.INTER_AREA)
    with pytest.raises(TactileFailure, match=r"px from a grid of 2\.4 x 2\.36 mm .*the gel is untouched"):
        calibrated(seen)


@pytest.mark.parametrize("size_px", [(240, 240), (320, 180), (180, 240), (480, 200)])
def test_a_resized_picture_has_two_focal_lengths(size_px: tuple[int, int]) -> None:
    true = eye(tilt_rad=0.08)
    calibration = calibrated(cv2.resize(picture(true, dots()), size_px, interpolation=cv2.INTER_AREA))
    expected = np.array(true.focal_px) * size_px / true.image_px
    np.testing.assert_allclose(calibration.camera.focal_px, expected, rtol=0.01)
    ratio, sd = calibration.aspect
    assert ratio == pytest.approx(expected[0] / expected[1], abs=4 * sd)
    assert sd < 0.01 * ratio
    assert calibration.camera.distortion[0] == pytest.approx(true.distortion[0], abs=0.02)


def test_a_picture_of_its_own_proportions_has_square_pixels() -> None:
    calibration = calibrated(cv2.resize(picture(eye(), dots()), (240, 180), interpolation=cv2.INTER_AREA))
    assert calibration.aspect is None
    assert calibration.camera.focal_px[0] == calibration.camera.focal_px[1]
    assert calibration.camera.focal_px[0] == pytest.approx(222.0 * 240 / 320, rel=0.01)
    assert calibration.camera.image_px == (240, 180)


def test_a_picture_without_dots_says_so() -> None:
    with pytest.raises(TactileFailure, match=r"empty\.png"):
        calibrated(np.full((240, 320, 3), 120, dtype=np.uint8))
