"""A raw grasp as a user hands it in: pictures of two gels, drawn from the discs' closed form."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from drawn_gel import PITCH_PX, SHAPE, drawn, grid
from jaxtyping import Float

FRAMES = 8
PX_PER_MM = 15.0
DEPTH_MM = 16.0
CENTRE = grid().mean(axis=0)

SENSOR = f"""
kind = "markers-mono"
name = "drawn dots"
serial = "{{serial}}"
[gel]
thickness_mm = 3.0
E_MPa = 0.25
nu = 0.48
[camera]
image_px = [{SHAPE[1]}, {SHAPE[0]}]
focal_px = [{PX_PER_MM * DEPTH_MM}, {PX_PER_MM * DEPTH_MM}]
centre_px = [{CENTRE[0]}, {CENTRE[1]}]
gel_from_camera = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -{DEPTH_MM}], [0, 0, 0, 1]]
[markers]
rows = 7
columns = 9
pitch_mm = [{PITCH_PX / PX_PER_MM}, {PITCH_PX / PX_PER_MM}]
"""
GRASP = """
fruit_id = "f1"
category = "nectarine"
loading = "grasp"
pose_aperture_mm = 60.0
[pads.left]
sensor = "left.toml"
pose = [[0, 0, 1, -30], [1, 0, 0, 0], [0, 1, 0, 25], [0, 0, 0, 1]]
[pads.right]
sensor = "right.toml"
pose = [[0, 0, -1, 30], [-1, 0, 0, 0], [0, 1, 0, 25], [0, 0, 0, 1]]
"""
PRESS = """
fruit_id = "f1"
category = "nectarine"
loading = "press"
pose_aperture_mm = 60.0
[pads.tip]
sensor = "sensor.toml"
pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""


def shear(frame: int) -> Float[np.ndarray, "n 2"]:
    """Markers of a frame, px: two frames of rest, then a patch drawn aside by up to 4 px."""
    away = grid() - CENTRE
    return grid() + 0.8 * max(frame - 2, 0) * np.exp(-(away**2).sum(axis=1, keepdims=True) / 2 / 45.0**2) * [
        1.0,
        0.5,
    ]


def write_picture(path: Path, picture: np.ndarray) -> None:
    """RGB to a file, as a camera's recorder writes it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), picture[..., ::-1])


def write_camera(place: Path, reference: np.ndarray, frames: Iterable[np.ndarray]) -> None:
    """What one camera saw: the untouched gel, and then its frames."""
    write_picture(place / "reference.png", reference)
    for t, frame in enumerate(frames):
        write_picture(place / f"frame_{t:06d}.png", frame)


def write_log(folder: Path, frames: int) -> None:
    """Jaws that close by 0.1 mm from frame to frame."""
    rows = [f"{0.05 * t},{60.0 - 0.1 * t}" for t in range(frames)]
    (folder / "log.csv").write_text("\n".join(["time_s,aperture_mm", *rows]) + "\n")


def write_raw(folder: Path, *, frames: int = FRAMES) -> Path:
    """A whole raw grasp; the frames carry noise, so that none is like another."""
    for k, pad in enumerate(("left", "right")):
        pictures = (drawn(shear(t), noise=1.0, seed=10 * t + k) for t in range(frames))
        write_camera(folder / pad, drawn(grid(), noise=1.0, seed=90 + k), pictures)
        (folder / f"{pad}.toml").write_text(SENSOR.format(serial=pad))
    (folder / "grasp.toml").write_text(GRASP)
    write_log(folder, frames)
    return folder


def replaced(path: Path, old: str, new: str) -> None:
    """Change a text file in one place, which must be there."""
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
