"""Sensors calibrated from rendered presses, start to end."""

import tomllib
from datetime import date
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_batches import run as command

import pipeline.recordings.sensor_calibration
from pipeline.files.toml_text import as_toml
from pipeline.problem import BatchRefused
from pipeline.recordings.sensor_calibration import Presses, _scaled, calibrate
from samples.gel_images import Field, GelLook, gel_image
from tactile.gel.photometric import PhotometricDepth
from tactile.gel.press_modulus import GelGain
from tactile.gel.shading_file import read_lookup
from tactile.io.sensor_file import read_sensor
from tactile.sensors import GelLight, marker_grid
from tactile.tactile_failure import TactileFailure

DAY = date(2026, 8, 14)

DRAFT = """
kind = "photometric"
name = "rendered"

[gel]
thickness_mm = 4.0
E_MPa = 0.2
nu = 0.48
{springs}

[camera]
image_px = [320, 240]
focal_px = [480.0, 481.0]
centre_px = [161.0, 118.0]
distortion = [-0.12, 0.03, 0.001, -0.001, 0.0]
gel_from_camera = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -22], [0, 0, 0, 1]]

[markers]
rows = 7
columns = 10
pitch_mm = [1.2, 1.2]
"""
DOTS = marker_grid(7, 10, pitch_mm=(1.2, 1.2), first_mm=None)
LIGHTS = tuple(
    GelLight(direction=np.array([0.8 * np.cos(a), 0.8 * np.sin(a), -0.6]), colour=0.9 * np.eye(3)[k])
    for k, a in enumerate(2 * np.pi * np.arange(3) / 3)
)
KN = 0.25


def bump(depth_mm: float) -> Field:
    def field(at: np.ndarray) -> np.ndarray:
        r = np.minimum(np.linalg.norm(at, axis=1) / 2.4, 1.0)
        return np.outer((1 - r**2) ** 1.5, [0.0, 0.0, -depth_mm])

    return field


def ball(at: np.ndarray) -> np.ndarray:
    """5 mm in radius, in contact within 1.8 mm, with a skirt."""
    r = np.linalg.norm(at, axis=1)
    edge = 1.8 / np.sqrt(25 - 1.8**2)
    rise = (
        5 - np.sqrt(25 - np.minimum(r, 1.8) ** 2) + edge * 0.7 * (1 - np.exp(-np.maximum(r - 1.8, 0) / 0.7))
    )
    whole = 5 - np.sqrt(25 - 1.8**2) + edge * 0.7
    return np.outer(rise - whole, [0.0, 0.0, 1.0])


def draw(sensor: Path, path: Path, field: Field, rng: np.random.Generator) -> None:
    camera = read_sensor(sensor).camera
    assert camera is not None
    image = gel_image(camera, LIGHTS, GelLook(rest_mm=DOTS, dot_mm=0.4), field, rng)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image[..., ::-1])


@pytest.fixture
def draft(tmp_path: Path) -> Path:
    path = tmp_path / "draft.toml"
    path.write_text(DRAFT.format(springs="gel_kn_MPa_per_mm = 0.175\ngel_kt_MPa_per_mm = 0.05"))
    seen = tmp_path / "seen.toml"
    seen.write_text(path.read_text().replace('"photometric"', '"markers-mono"'))
    rng = np.random.default_rng(0)
    draw(seen, tmp_path / "ball" / "rest.png", bump(0.0), rng)
    draw(seen, tmp_path / "ball" / "1.png", ball, rng)
    return path


run = partial(command, "calibrate")


def test_a_ball_and_a_load_cell_complete_the_description(draft: Path, tmp_path: Path) -> None:
    """Springs of 0.25 MPa/mm, described as 0.175: the ball gives slopes, the load cell the stiffness."""
    press, rng = tmp_path / "press", np.random.default_rng(1)
    depths = np.concatenate([np.zeros(4), np.linspace(0.08, 0.5, 7)])
    draw(tmp_path / "seen.toml", press / "tip" / "reference.png", bump(0.0), rng)
    rows = ["time_s,aperture_mm,fx_N,fy_N,fz_N,tx_Nmm,ty_Nmm,tz_Nmm"]
    for k, depth in enumerate(depths):
        draw(tmp_path / "seen.toml", press / "tip" / f"frame_{k:06d}.png", bump(depth), rng)
        force = KN * depth * np.pi * 2.4**2 / 2.5
        rows.append(f"{k / 30:.4f},{depth:.4f},0,0,{force:.5f},0,0,0")
    (press / "log.csv").write_text("\n".join(rows) + "\n")
    (press / "grasp.toml").write_text(
        'fruit_id = "flat"\ncategory = "calibration"\nloading = "press"\npose_aperture_mm = 0.0\n[pads.tip]\n'
        "pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    )
    out = tmp_path / "made" / "sensor.toml"
    folder = tmp_path / "ball"
    status, said = run(
        draft, out, "--ball-mm", 5, "--reference", folder / "rest.png", "--press", folder / "1.png",
        "--load-cell", press,
    )  # fmt: skip
    assert status == 0, said
    made = read_sensor(out)
    assert made.gel_kn_MPa_per_mm == pytest.approx(KN, rel=0.05)
    assert made.gel_kt_MPa_per_mm == 0.05
    assert "gel_kt_MPa_per_mm does not change" in " ".join(said.split())
    assert made.calibration_file is not None
    assert made.camera is not None
    rest, pressed = (cv2.imread(str(folder / name))[..., ::-1] for name in ("rest.png", "1.png"))
    shape = PhotometricDepth(made.camera, rest, read_lookup(made.calibration_file))
    middle = shape.at(pressed, np.array([[161.0, 118.0]]))
    assert middle[0, 2] == pytest.approx(ball(np.zeros((1, 2)))[0, 2], abs=0.015)


@pytest.mark.parametrize(("springs", "changed"), [(True, "gel_kn_MPa_per_mm"), (False, "E_MPa")])
def test_a_press_scales_what_the_force_was_made_with(springs: bool, changed: str) -> None:
    """One stated spring alone makes no force: then it came from E."""
    gel = {"E_MPa": 0.2, "gel_kn_MPa_per_mm": 0.1} | ({"gel_kt_MPa_per_mm": 0.05} if springs else {})
    made = dict(gel)
    _scaled(made, GelGain(value=1.5, sd=0.01, residual=0.01), springs=springs)
    assert made == gel | {changed: pytest.approx(1.5 * gel[changed])}


def test_a_look_up_that_is_gone_is_refused(draft: Path, tmp_path: Path) -> None:
    draft.write_text(draft.read_text().replace("name =", 'calibration_file = "gone.npz"\nname =', 1))
    with pytest.raises(BatchRefused, match=r"no file gone\.npz"):
        calibrate(draft, tmp_path / "o.toml", Presses(load_cell=tmp_path), today=DAY, report=print)


def test_a_look_up_of_another_run_is_noticed_wherever_a_run_was_killed(
    draft: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, out = tmp_path / "ball", tmp_path / "out.toml"

    def calibrated(ball_mm: float) -> None:
        presses = Presses(ball_mm=ball_mm, reference=folder / "rest.png", ball=(folder / "1.png",))
        calibrate(draft, out, presses, today=DAY, report=print)

    calibrated(5.0)
    assert read_sensor(out).calibration_file == out.with_suffix(".npz")
    whole, written = pipeline.recordings.sensor_calibration.put, []

    def killed(path: Path, data: bytes) -> None:
        if written:
            raise KeyboardInterrupt
        written.append(path)
        whole(path, data)

    monkeypatch.setattr(pipeline.recordings.sensor_calibration, "put", killed)
    with pytest.raises(KeyboardInterrupt):
        calibrated(5.2)
    monkeypatch.setattr(pipeline.recordings.sensor_calibration, "put", whole)
    with pytest.raises(TactileFailure, match=r"calibration_file: found out\.npz of another calibration"):
        read_sensor(out)
    calibrated(5.2)
    assert read_sensor(out).calibration_file == out.with_suffix(".npz")


def test_a_picture_without_the_ball_writes_nothing(draft: Path, tmp_path: Path) -> None:
    folder, out = tmp_path / "ball", tmp_path / "out.toml"
    status, said = run(
        draft, out, "--ball-mm", 5, "--reference", folder / "rest.png", "--press", folder / "rest.png"
    )
    assert status == 3
    assert "rest.png: colours change by" in said
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--press", "draft.toml"), "needs --ball-mm, --reference and at least one --press"),
        ((), "For a sensor give --press or --load-cell. For a rig give --rigid"),
    ],
)
def test_what_a_calibration_needs_is_named(
    draft: Path, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    assert said in run(draft, tmp_path / "o.toml", *words)[1]


def test_a_description_is_written_as_it_was_read() -> None:
    values = tomllib.loads(DRAFT.format(springs='note = "a \\"quoted\\" \\\\ word"'))
    values["lights"] = [{"direction": [1.0, 0.0, -0.5], "colour": [1.0, 0.0, 0.0]}] * 3
    assert tomllib.loads(as_toml(values)) == values
