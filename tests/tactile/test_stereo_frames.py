"""Frames of one or two cameras give the displacement in space, and its spread."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn_gel import drawn
from jaxtyping import Float
from raw_folder import PRESS, write_camera, write_log

from tactile.from_frames import recording_of
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.tactile_failure import TactileFailure

FOCAL_PX, FRAMES = 240.0, 5
X, Y = np.meshgrid(np.arange(-4, 5) * 1.8, np.arange(-3, 4) * 1.8)
REST = np.stack([X.ravel(), Y.ravel(), np.zeros(63)], axis=1)
AWAY = np.arctan2(6.0, 16.0)
TURN = np.array([[np.cos(AWAY), 0, -np.sin(AWAY)], [0, 1, 0], [np.sin(AWAY), 0, np.cos(AWAY)]])
CAMERAS = ((np.eye(3), np.array([0.0, 0.0, -16.0])), (TURN, np.array([6.0, 0.0, -16.0])))


def press(frame: int) -> Float[np.ndarray, "n 3"]:
    """Places of the markers: a dent that also spreads."""
    dent = 0.1 * max(frame - 1, 0) * np.exp(-(REST[:, 0] ** 2 + REST[:, 1] ** 2) / 2 / 3.0**2)
    return REST + dent[:, None] * np.stack([0.1 * REST[:, 0], 0.1 * REST[:, 1], -np.ones(63)], axis=1)


def seen(camera: int, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Pinhole: pixels of points of the gel frame."""
    turn, place = CAMERAS[camera]
    local = (points - place) @ turn
    return FOCAL_PX * local[:, :2] / local[:, 2:] + [159.5, 119.5]


def write_stereo(folder: Path) -> Path:
    text = 'kind = "markers-stereo"\nname = "two eyes"\n[gel]\nthickness_mm = 3.0\nE_MPa = 0.25\nnu = 0.48\n'
    for name, (turn, place) in zip(("camera", "second_camera"), CAMERAS, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, place
        text += f"[{name}]\nimage_px = [320, 240]\nfocal_px = [{FOCAL_PX}, {FOCAL_PX}]\n"
        text += "centre_px = [159.5, 119.5]\n"
        text += f"gel_from_camera = {pose.tolist()}\n"
    folder.mkdir(parents=True)
    (folder / "sensor.toml").write_text(text + "[markers]\nrows = 7\ncolumns = 9\npitch_mm = [1.8, 1.8]\n")
    (folder / "grasp.toml").write_text(PRESS)
    write_log(folder, FRAMES)
    for camera, place in enumerate(("tip", "tip-b")):
        frames = (drawn(seen(camera, press(t)), noise=1.0, seed=2 * t + camera) for t in range(FRAMES))
        write_camera(folder / place, drawn(seen(camera, REST), noise=1.0, seed=50 + camera), frames)
    return folder


def test_a_dent_is_seen_to_micrometres_across_and_in_depth(tmp_path: Path) -> None:
    converted = recording_of(read_raw_grasp(write_stereo(tmp_path / "g")))
    pad = converted.recording.pads[0]
    order = np.linalg.norm(REST[:, None] - pad.rest_mm[None], axis=2).argmin(axis=0)
    error = pad.displacement_mm - np.stack([press(t) - REST for t in range(FRAMES)])[:, order]
    assert len(set(order.tolist())) == 63
    assert np.sqrt((error[..., :2] ** 2).mean()) < 0.005
    assert np.sqrt((error[..., 2] ** 2).mean()) < 0.02
    assert converted.recording.pads[0].pose[-1, 2, 3] == pytest.approx(-0.4)


def test_a_second_camera_that_lacks_frames_is_refused(tmp_path: Path) -> None:
    folder = write_stereo(tmp_path / "g")
    (folder / "tip-b/frame_000002.png").unlink()
    with pytest.raises(TactileFailure, match=r"tip-b: found 4 frames, expected the numbers of tip \(5\)"):
        read_raw_grasp(folder)


def test_the_second_camera_may_be_a_video_with_its_reference_in_the_folder_of_its_name(
    tmp_path: Path,
) -> None:
    folder = write_stereo(tmp_path / "g")
    video = cv2.VideoWriter(str(folder / "tip-b.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (320, 240))
    for picture in sorted((folder / "tip-b").glob("frame_*.png")):
        video.write(cv2.imread(str(picture)))
        picture.unlink()
    video.release()
    with (folder / "grasp.toml").open("a") as file:
        file.write('second_frames = "tip-b.avi"\n')
    second = read_raw_grasp(folder).pads[0].second
    assert len(second.pictures.numbers) == FRAMES
    (folder / "tip-b/reference.png").unlink()
    with pytest.raises(TactileFailure, match=r"tip-b/reference\.png: found no such file"):
        read_raw_grasp(folder)


def test_the_sensor_at_the_top_is_that_of_every_pad_that_names_none(tmp_path: Path) -> None:
    folder = write_stereo(tmp_path / "g")
    text = (folder / "grasp.toml").read_text().replace('sensor = "sensor.toml"\n', "")
    (folder / "grasp.toml").write_text('sensor = "sensor.toml"\n' + text)
    assert read_raw_grasp(folder).pads[0].sensor.name == "two eyes"
