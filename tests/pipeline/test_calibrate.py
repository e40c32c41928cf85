"""Sensors calibrated from rendered presses, start to end."""

import tomllib
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_batches import run as command

from pipeline.files.toml_text import as_toml
from pipeline.recordings.sensor_calibration import _scaled
from samples.gel_images import Field, GelLook, gel_image
from tactile.gel.press_modulus import GelGain
from tactile.io.sensor_file import read_sensor
from tactile.sensors import GelCamera, marker_grid

DRAFT = """
kind = "markers-stereo"
name = "rendered"

[gel]
thickness_mm = 4.0
E_MPa = 0.2
nu = 0.48
gel_kn_MPa_per_mm = 0.175
gel_kt_MPa_per_mm = 0.05

[markers]
rows = 7
columns = 10
pitch_mm = [1.2, 1.2]
"""
DOTS = marker_grid(7, 10, pitch_mm=(1.2, 1.2), first_mm=None)
TURNS_RAD = {"camera": 0.3, "second_camera": -0.3}
KN = 0.25


def bump(depth_mm: float) -> Field:
    def field(at: np.ndarray) -> np.ndarray:
        r = np.minimum(np.linalg.norm(at, axis=1) / 2.4, 1.0)
        return np.outer((1 - r**2) ** 1.5, [0.0, 0.0, -depth_mm])

    return field


def camera_table(turn_rad: float) -> dict[str, object]:
    """22 mm behind the middle of the gel, turned about y."""
    c, s = float(np.cos(turn_rad)), float(np.sin(turn_rad))
    pose = [[c, 0.0, s, -22.0 * s], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, -22.0 * c], [0.0, 0.0, 0.0, 1.0]]
    return {
        "image_px": [320, 240],
        "focal_px": [460.0, 461.0],
        "centre_px": [161.0, 118.0],
        "distortion": [-0.12, 0.03, 0.001, -0.001, 0.0],
        "gel_from_camera": pose,
    }


def draw(camera: GelCamera, path: Path, field: Field, rng: np.random.Generator) -> None:
    image = gel_image(camera, (), GelLook(rest_mm=DOTS, dot_mm=0.4), field, rng)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image[..., ::-1])


@pytest.fixture
def draft(tmp_path: Path) -> Path:
    path = tmp_path / "draft.toml"
    cameras = {name: camera_table(turn) for name, turn in TURNS_RAD.items()}
    path.write_text(as_toml(tomllib.loads(DRAFT) | cameras))
    return path


run = partial(command, "calibrate")


def test_a_load_cell_gives_the_stiffness_of_the_gel(draft: Path, tmp_path: Path) -> None:
    """Springs of 0.25 MPa/mm, described as 0.175."""
    press, rng = tmp_path / "press", np.random.default_rng(1)
    depths = np.concatenate([np.zeros(4), np.linspace(0.08, 0.5, 7)])
    sensor = read_sensor(draft)
    for camera, folder in ((sensor.camera, press / "tip"), (sensor.second_camera, press / "tip-b")):
        draw(camera, folder / "reference.png", bump(0.0), rng)
        for k, depth in enumerate(depths):
            draw(camera, folder / f"frame_{k:06d}.png", bump(depth), rng)
    rows = ["time_s,aperture_mm,fx_N,fy_N,fz_N,tx_Nmm,ty_Nmm,tz_Nmm"]
    for k, depth in enumerate(depths):
        force = KN * depth * np.pi * 2.4**2 / 2.5
        rows.append(f"{k / 30:.4f},{depth:.4f},0,0,{force:.5f},0,0,0")
    (press / "log.csv").write_text("\n".join(rows) + "\n")
    (press / "grasp.toml").write_text(
        'fruit_id = "flat"\ncategory = "calibration"\nloading = "press"\npose_aperture_mm = 0.0\n[pads.tip]\n'
        "pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    )
    out = tmp_path / "made" / "sensor.toml"
    status, said = run(draft, out, "--load-cell", press)
    assert status == 0, said
    made = read_sensor(out)
    assert made.gel_kn_MPa_per_mm == pytest.approx(KN, rel=0.05)
    assert made.gel_kt_MPa_per_mm == 0.05
    assert "gel_kt_MPa_per_mm does not change" in " ".join(said.split())


@pytest.mark.parametrize(("springs", "changed"), [(True, "gel_kn_MPa_per_mm"), (False, "E_MPa")])
def test_a_press_scales_what_the_force_was_made_with(springs: bool, changed: str) -> None:
    """One stated spring alone makes no force: then it came from E."""
    gel = {"E_MPa": 0.2, "gel_kn_MPa_per_mm": 0.1} | ({"gel_kt_MPa_per_mm": 0.05} if springs else {})
    made = dict(gel)
    _scaled(made, GelGain(value=1.5, sd=0.01, residual=0.01), springs=springs)
    assert made == gel | {changed: pytest.approx(1.5 * gel[changed])}


def test_what_a_calibration_needs_is_named(draft: Path, tmp_path: Path) -> None:
    said = run(draft, tmp_path / "o.toml")[1]
    assert "For a sensor give --load-cell. For a rig give --rigid" in said


def test_a_description_is_written_as_it_was_read() -> None:
    values = tomllib.loads(DRAFT + 'note = "a \\"quoted\\" \\\\ word"\n')
    values["recordings"] = [{"name": "a.csv", "force_N": [1.0, 0.0]}] * 3
    assert tomllib.loads(as_toml(values)) == values
