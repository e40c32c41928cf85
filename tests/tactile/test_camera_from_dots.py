"""Cameras of a gel: pixels and points by the pinhole's formula, a camera from dots, resized pictures.

From dots alone the normal force scatters by some per cent with the size of the picture, squeezed or not.
"""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from periodic_slab import traction_response
from raw_folder import PRESS, write_camera, write_log
from turned_camera import turned_camera

from pipeline.files.toml_text import as_toml
from samples.gel_images import Field, GelLook, gel_image, smooth_field
from tactile.from_frames import recording_of
from tactile.gel.gel_sides import GelOutline
from tactile.gel.slab import GelSlab
from tactile.gel_camera import on_face, on_gel, project, rays, triangulated
from tactile.markers.pad_frames import camera_of, tracked_markers
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.sensor_model import read_model
from tactile.reference_print import references_said
from tactile.sensor_description import camera_from_dots, described
from tactile.sensors import GelCamera, marker_grid
from tactile.square_pixels import square_camera, with_square_pixels
from tactile.tactile_failure import TactileFailure


@pytest.mark.parametrize("lens", [(0.0,) * 5, (-0.2, 0.05, 0.002, -0.001, 0.01)])
def test_a_point_lands_where_the_pinhole_and_the_polynomial_in_the_radius_say(
    lens: tuple[float, float, float, float, float],
) -> None:
    k1, k2, p1, p2, k3 = lens
    point = np.array([[4.0, 3.0, 0.0]])
    pose = turned_camera(0.1).gel_from_camera
    x, y, z = pose[:3, :3].T @ (point[0] - pose[:3, 3])
    x, y = x / z, y / z
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    pixels = project(turned_camera(0.1, distortion=lens), point)
    np.testing.assert_allclose(pixels, [[740 * u + 320, 742 * v + 238]], atol=1e-9)


@pytest.mark.parametrize("lens", [(0.0,) * 5, (-0.25, 0.06, 0.001, -0.002, 0.0)])
def test_the_ray_of_a_pixel_goes_through_its_point(lens: tuple[float, float, float, float, float]) -> None:
    points = np.random.default_rng(3).uniform([-7, -5, 0], [7, 5, 0], (50, 3))
    camera = turned_camera(0.1, distortion=lens)
    pixels = project(camera, points)
    np.testing.assert_allclose(on_face(camera, pixels), points, atol=1e-6)
    centre, direction = rays(camera, pixels)
    np.testing.assert_allclose(np.cross(points - centre, direction), 0.0, atol=1e-5)


EYES = (turned_camera(0.35), turned_camera(-0.35))
POINTS = np.random.default_rng(0).uniform([-7, -5, -1], [7, 5, 0.2], (300, 3))


def test_the_stated_information_is_that_of_noisy_pixels() -> None:
    rng = np.random.default_rng(1)
    scores = []
    for _ in range(20):
        pixels = [project(camera, POINTS) + rng.normal(scale=0.05, size=(300, 2)) for camera in EYES]
        points, information = triangulated(EYES, (pixels[0], pixels[1]), noise_px=0.05)
        miss = points - POINTS
        scores.append(np.einsum("ni,nij,nj->n", miss, information, miss))
    assert np.mean(scores) == pytest.approx(3.0, rel=0.05)


def test_depth_is_as_sure_as_the_angle_between_the_rays_makes_it() -> None:
    """s / (sqrt 2 sin 0.35) at the gel's centre, s = 0.05 px * 24 mm / 741 px."""
    middle = np.zeros((1, 3))
    _, information = triangulated(EYES, (project(EYES[0], middle), project(EYES[1], middle)), noise_px=0.05)
    depth = np.sqrt(np.linalg.inv(information[0])[2, 2])
    assert depth == pytest.approx(0.05 * 24 / 741 / np.sqrt(2) / np.sin(0.35), rel=1e-3)


def test_a_marker_lost_to_one_camera_has_no_place() -> None:
    first, second = project(EYES[0], POINTS), project(EYES[1], POINTS)
    second[7] = np.nan
    points, information = triangulated(EYES, (first, second))
    assert np.isnan(points[7]).all()
    assert not information[7].any()
    assert np.isfinite(np.delete(points, 7, axis=0)).all()


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
    part = picture(true, dots())[20:220, 35:285]
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


CAMERA = eye()
SHAPES = {"4:3 to 1:1": (240, 240), "4:3 to 16:9": (320, 180), "16:9 to 1:1, its ratio": (180, 240)}
PRESSES = 3


def pressed(share: float) -> Field:
    """The domed face under a parabola of pressure with friction, off its middle: up to 2.3 N and 0.7 N."""
    side = np.arange(-16.0, 16.0, 0.25)
    x, y = np.meshgrid(side, side, indexing="ij")
    within = np.maximum(1.0 - ((x - 2.0) ** 2 + (y + 1.0) ** 2) / 3.5**2, 0.0)
    gel = GelSlab(thickness_mm=4.0, E_MPa=0.435, nu=0.48)
    traction = 0.12 * share * within[..., None] * [0.3, 0.0, -1.0]
    moved = traction_response(gel, traction, spacing_mm=0.25).reshape(-1, 3)
    press = smooth_field(side, side, moved)
    return lambda at: press(at) + np.column_stack([0 * at, DOME.face_mm(at[:, 0], at[:, 1])])


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    """The untouched gel, and a press: two frames without contact, then ever deeper."""
    rng = np.random.default_rng(3)
    look = GelLook(rest_mm=dots(), dot_mm=0.8)
    shares = [0.0] * 3 + list(np.arange(1, PRESSES + 1) / PRESSES)
    return [gel_image(CAMERA, (), look, pressed(share), rng) for share in shares]


def read(
    folder: Path, pictures: list[np.ndarray], size_px: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, str]:
    """The markers' motion as seen on the face and the force of the last frame, in pictures of that size; and
    how the first of them describes the sensor.
    """
    seen = [cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA) for picture in pictures]
    made = described(read_model("gelsight-mini"), seen[0], source="empty.png")
    write_camera(folder / "tip", seen[0], seen[1:])
    (folder / "sensor.toml").write_text(as_toml(made.table))
    (folder / "grasp.toml").write_text(PRESS)
    write_log(folder, len(seen) - 1)
    raw = with_square_pixels(read_raw_grasp(folder))
    assert not references_said(raw)
    tip = raw.pads[0]
    camera = camera_of(tip)
    tracked = tracked_markers(tip, tip.view, camera, "g", None).tracked
    seen_mm = on_face(camera, tracked.position_px[-1]) - on_face(camera, tracked.reference_px)
    force_N = recording_of(raw).recording.pads[0].force_N[-1].sum(axis=0)
    return seen_mm[np.lexsort(tracked.rest_mm.T)], force_N, "\n".join(made.said)


@pytest.fixture(scope="module")
def unsqueezed(
    pictures: list[np.ndarray], tmp_path_factory: pytest.TempPathFactory
) -> tuple[np.ndarray, np.ndarray]:
    seen_mm, force_N, said = read(tmp_path_factory.mktemp("whole"), pictures, CAMERA.image_px)
    assert "resized" not in said
    return seen_mm, force_N


@pytest.mark.parametrize("size_px", SHAPES.values(), ids=SHAPES)
def test_squeezed_pictures_give_the_unsqueezed_motion_and_force(
    size_px: tuple[int, int],
    pictures: list[np.ndarray],
    unsqueezed: tuple[np.ndarray, np.ndarray],
    tmp_path: Path,
) -> None:
    seen_mm, force_N, said = read(tmp_path, pictures, size_px)
    ratio = size_px[0] / size_px[1] / (4 / 3)
    assert f"the picture was resized without its proportions. A millimetre along x has {ratio:.2f}" in said
    expected_mm, expected_N = unsqueezed
    assert np.abs(seen_mm - expected_mm).max() < 0.02 * np.abs(expected_mm).max()
    assert np.linalg.norm(force_N - expected_N) < 0.05 * np.linalg.norm(expected_N)


@pytest.mark.parametrize("focal_px", [(120.0, 222.0), (222.0, 170.0)])
def test_the_square_camera_sees_each_point_where_the_stretched_picture_shows_it(
    focal_px: tuple[float, float],
) -> None:
    camera = replace(CAMERA, focal_px=focal_px)
    square = square_camera(camera)
    scale = np.array(square.image_px) / camera.image_px
    assert scale.min() == 1.0
    assert square.focal_px[0] == pytest.approx(square.focal_px[1], rel=0.5 / min(CAMERA.image_px))
    stretched = (project(camera, dots()) + 0.5) * scale - 0.5
    np.testing.assert_allclose(project(square, dots()), stretched, atol=1e-9)


def test_frames_of_a_calibrated_camera_stay_as_they_are() -> None:
    camera = replace(CAMERA, focal_px=(222.0, 223.0))
    assert square_camera(camera) is camera
