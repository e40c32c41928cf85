"""A recording in a sensor's raw form: rendered frames, log.csv and grasp.toml.

The gel's face moves as the recording's markers do, and two cameras behind it see its dots
(samples.gel_images). The dots' motion contains the recording's noise; the cameras add their own.
"""

import csv
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from samples.gel_images import GelLook, gel_image, smooth_field
from tactile.readers.recording import GelPad, Recording
from tactile.sensors import GelCamera

Progress = Callable[[str], None]
SENSOR = "sensor.toml"
TILT_RAD, DISTANCE_MM, FOCAL_PX = 0.35, 26.0, 520.0
"""Tilt (about 20 degrees), distance and focal length of the two cameras: 640 pixels show 32 mm."""
DISTORTION = (-0.1, 0.02, 0.001, -0.001, 0.0)
"""k1, k2, p1, p2, k3 as in OpenCV: the wide lens of such a sensor (assumed)."""
THICKNESS_MM, E_MPA, NU = 4.0, 0.2, 0.48
"""The gel: 4 mm of a soft silicone, nearly incompressible (assumed)."""


def write_sensor(folder: Path, pad: GelPad) -> None:
    """Write the description of a pad's sensor, with the recording's gel stiffness, as SENSOR."""
    lines = [
        'kind = "markers-stereo"',
        'name = "20x20 marker gel (rendered)"',
        'serial = "rendered"',
        "[gel]",
        f"thickness_mm = {THICKNESS_MM}",
        f"E_MPa = {E_MPA}",
        f"nu = {NU}",
        f"gel_kn_MPa_per_mm = {pad.gel_kn_MPa_per_mm:g}",
        f"gel_kt_MPa_per_mm = {pad.gel_kt_MPa_per_mm:g}",
        "[markers]",
        f"rest_mm = {pad.rest_mm.tolist()}",
    ]
    for table, camera in zip(("camera", "second_camera"), eyes(), strict=True):
        lines += [
            f"[{table}]",
            f"image_px = {list(camera.image_px)}",
            f"focal_px = {list(camera.focal_px)}",
            f"centre_px = {list(camera.centre_px)}",
            f"distortion = {list(camera.distortion)}",
            f"gel_from_camera = {camera.gel_from_camera.tolist()}",
        ]
    (folder / SENSOR).write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_raw_grasp(
    folder: Path, recording: Recording, *, rng: np.random.Generator, progress: Progress | None = None
) -> None:
    """Write grasp.toml, log.csv and the frames of `recording` (a grasp of gel pads) into a new `folder`.

    Readers expect the sensor's description (`write_sensor`) in its parent. Raises FileExistsError.
    """
    folder.mkdir(parents=True)
    with (folder / "log.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["time_s", "aperture_mm", "frame"])
        for frame, (time_s, aperture_mm) in enumerate(
            zip(recording.time_s.tolist(), recording.aperture_mm.tolist(), strict=True)
        ):
            table.writerow([f"{time_s:.6f}", f"{aperture_mm:.6f}", frame])
    lines = [
        f'fruit_id = "{recording.fruit_id}"',
        f'category = "{recording.category}"',
        'loading = "grasp"',
        f"pose_aperture_mm = {recording.aperture_mm[0]:.6f}",
    ]
    for pad in recording.pads:
        if not isinstance(pad, GelPad):
            continue
        lines += [f"[pads.{pad.name}]", f'sensor = "{SENSOR}"', f"pose = {pad.pose[0].tolist()}"]
        for name, camera in zip((pad.name, f"{pad.name}-b"), eyes(), strict=True):
            _write_frames(folder / name, camera, pad, rng)
            if progress is not None:
                progress(f"{folder.name}: {name}, {len(pad.displacement_mm)} frames")
    (folder / "grasp.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_frames(folder: Path, camera: GelCamera, pad: GelPad, rng: np.random.Generator) -> None:
    folder.mkdir()
    x, y = np.unique(pad.rest_mm[:, 0]), np.unique(pad.rest_mm[:, 1])
    look = GelLook(rest_mm=pad.rest_mm)
    still = np.zeros_like(pad.rest_mm)
    names = ["reference", *(f"frame_{k:06d}" for k in range(len(pad.displacement_mm)))]
    for name, moved in zip(names, [still, *pad.displacement_mm], strict=True):
        picture = gel_image(camera, (), look, smooth_field(x, y, np.asarray(moved, dtype=float)), rng)
        cv2.imwrite(str(folder / f"{name}.png"), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))


def eyes() -> tuple[GelCamera, GelCamera]:
    """Two cameras behind the gel, tilted towards each other about its y axis."""
    return _tilted(TILT_RAD), _tilted(-TILT_RAD)


def _tilted(turn_rad: float) -> GelCamera:
    """A gel camera turned about the y axis, with the gel's middle on its axis."""
    c, s = float(np.cos(turn_rad)), float(np.sin(turn_rad))
    pose: Float[np.ndarray, "4 4"] = np.eye(4)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[:3, 3] = -DISTANCE_MM * pose[:3, 2]
    return GelCamera(
        image_px=(640, 480),
        focal_px=(FOCAL_PX, FOCAL_PX + 2),
        centre_px=(322.0, 237.0),
        distortion=DISTORTION,
        gel_from_camera=pose,
    )
