"""Sensors calibrated from rendered presses, start to end."""

import tomllib
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_batches import run as command

from pipeline.files.toml_text import as_toml
from samples.gel_images import Field, GelLook, gel_image
from tactile.from_frames import recording_of
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.sensor_file import read_sensor
from tactile.sensors import GelCamera, marker_grid

DRAFT = """
kind = "markers-stereo"
name = "rendered"

[gel]
thickness_mm = 4.0
E_MPa = 0.2
nu = 0.48

[markers]
rows = 7
columns = 10
pitch_mm = [1.2, 1.2]
"""
DOTS = marker_grid(7, 10, pitch_mm=(1.2, 1.2), first_mm=None)
TURNS_RAD = {"camera": 0.3, "second_camera": -0.3}


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


def test_a_load_cell_gives_the_modulus_of_the_gel(draft: Path, tmp_path: Path) -> None:
    """The cell reads 1.3 times what the gel reads with the modulus of its description."""
    press, rng = tmp_path / "press", np.random.default_rng(1)
    depths = np.concatenate([np.zeros(4), np.linspace(0.08, 0.5, 7)])
    sensor = read_sensor(draft)
    for camera, folder in ((sensor.camera, press / "tip"), (sensor.second_camera, press / "tip-b")):
        draw(camera, folder / "reference.png", bump(0.0), rng)
        for k, depth in enumerate(depths):
            draw(camera, folder / f"frame_{k:06d}.png", bump(depth), rng)
    (press / "grasp.toml").write_text(
        'fruit_id = "flat"\ncategory = "calibration"\nloading = "press"\npose_aperture_mm = 0.0\n[pads.tip]\n'
        "pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    )

    def write_log(cell_N: np.ndarray) -> None:
        rows = [
            f"{k / 30:.4f},{d:.4f},0,0,{f:.5f},0,0,0"
            for k, (d, f) in enumerate(zip(depths, cell_N, strict=True))
        ]
        header = "time_s,aperture_mm,fx_N,fy_N,fz_N,tx_Nmm,ty_Nmm,tz_Nmm"
        (press / "log.csv").write_text("\n".join([header, *rows]) + "\n")

    write_log(depths)
    pad = recording_of(read_raw_grasp(press, sensor=draft)).recording.pads[0]
    write_log(1.3 * pad.force_N[:, :, 2].sum(axis=1))
    out = tmp_path / "made" / "sensor.toml"
    status, said = run(draft, out, "--load-cell", press)
    assert status == 0, said
    assert read_sensor(out).E_MPa == pytest.approx(1.3 * 0.2, rel=0.01)


def test_what_a_calibration_needs_is_named(draft: Path, tmp_path: Path) -> None:
    said = run(draft, tmp_path / "o.toml")[1]
    assert "For a sensor give --load-cell. For a rig give --rigid" in said


def test_a_description_is_written_as_it_was_read() -> None:
    values = tomllib.loads(DRAFT + 'note = "a \\"quoted\\" \\\\ word"\n')
    values["recordings"] = [{"name": "a.csv", "force_N": [1.0, 0.0]}] * 3
    assert tomllib.loads(as_toml(values)) == values


@pytest.mark.parametrize("name", ["Brix (%)", "a.b", "", 'a "b"', "Größe"])
def test_a_name_that_is_no_bare_key_is_quoted_everywhere(name: str) -> None:
    values = {name: 1, "table": {name: {name: 2}}, "tables": [{name: [{name: 3}]}], "inline": [[{name: 4}]]}
    assert tomllib.loads(as_toml(values)) == values
