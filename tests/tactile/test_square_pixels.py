"""Gel pictures that were resized without their proportions give the answer of those that were not.

From dots alone the normal force scatters by some per cent with the size of the picture, squeezed or not.
"""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from periodic_slab import traction_response
from raw_folder import PRESS, write_camera, write_log
from test_camera_from_dots import DOME, dots, eye

from pipeline.files.toml_text import as_toml
from samples.gel_images import Field, GelLook, gel_image, smooth_field
from tactile.from_frames import recording_of
from tactile.gel.slab import GelSlab
from tactile.gel_camera import on_face, project
from tactile.markers.pad_frames import camera_of, tracked_markers
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.sensor_model import read_model
from tactile.reference_print import references_said
from tactile.sensor_description import described
from tactile.square_pixels import square_camera, with_square_pixels

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
