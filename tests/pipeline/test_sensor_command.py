"""`drupe sensor`: sensors by name, their descriptions, and what their spread does."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from small_batches import run
from test_camera_from_dots import dots, eye, picture

from fem.estimation.joint_inference import FruitModulus
from pipeline.fruit.elasticity import SENSOR, modulus_record
from pipeline.fruit.sensor_scale import COMMON_SD, E_PER_PICTURE, PICTURE_SD, SensorScale, sensor_scale
from tactile.readers.recording import GelPad, Recording, read_recording, write_recording
from tactile.readers.sensor_file import read_sensor
from tactile.readers.sensor_model import model_names, read_model


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    path = tmp_path / "empty.png"
    cv2.imwrite(str(path), picture(eye(), dots()))
    return path


def test_sensors_are_listed_with_what_has_to_be_given() -> None:
    code, said = run("sensor")
    assert code == 0
    assert "gelsight-mini: GelSight Mini, marked gel." in said
    assert "mono-gel" in said
    assert "--thickness-mm, --E-MPa, --pitch-mm" in said
    assert "digit: DIGIT, with printed dots. No published values exist for --pitch-mm; measure them" in said
    assert said.count("DIGIT") == 1


@pytest.mark.parametrize("name", model_names())
def test_every_value_that_is_shipped_has_a_source_and_a_spread(name: str) -> None:
    model = read_model(name)
    values = [*model.gel.values(), model.pitch_mm, model.distance_mm, *model.fields.values()]
    known = [published for published in values if published is not None]
    assert known
    assert all(published.sd > 0 and len(published.source) > 10 for published in known)


def test_a_picture_of_the_dots_makes_a_mini_of_ones_own(tmp_path: Path, empty: Path) -> None:
    out = tmp_path / "mini.toml"
    code, said = run("sensor", "gelsight-mini", out, "--picture", empty)
    assert code == 0, said
    assert "63 dots of a grid of 7 x 9" in said
    sensor = read_sensor(out)
    assert sensor.camera.focal_px[0] == pytest.approx(222.0, rel=0.01)
    assert sensor.force_sd == pytest.approx(np.linalg.norm([0.09 / 0.435, 0.1 / 4, 0.45 * 4 / 16]), abs=0.02)
    assert sensor.rest_mm[0, 2] < -0.2
    assert "# E_MPa 0.435 ± 0.09 (6 C10" in out.read_text()
    assert run("sensor", "gelsight-mini", out, "--picture", empty)[0] == 0


def test_what_is_given_takes_the_place_of_what_is_published(tmp_path: Path, empty: Path) -> None:
    out = tmp_path / "mini.toml"
    given = ("--E-MPa", "0.3", "--distance-mm", "17", "--known-to", "0.02")
    assert run("sensor", "gelsight-mini", out, "--picture", empty, *given)[0] == 0
    sensor = read_sensor(out)
    assert sensor.E_MPa == 0.3
    assert 0.05 < sensor.force_sd < 0.07  # the dots' distance is still what is published
    measured = tmp_path / "own.toml"
    assert (
        run("sensor", "gelsight-mini", measured, "--picture", empty, *given, "--pitch-mm", "2.4", "2.36")[0]
        == 0
    )
    assert read_sensor(measured).force_sd < 0.05


def test_a_gel_of_ones_own_needs_its_numbers(tmp_path: Path, empty: Path) -> None:
    out = tmp_path / "own.toml"
    code, said = run("sensor", "mono-gel", out, "--picture", empty)
    assert code == 3
    assert "no published values exist for --thickness-mm, --E-MPa, --pitch-mm" in " ".join(said.split())
    numbers = ("--thickness-mm", "4", "--E-MPa", "0.2", "--pitch-mm", "2.4", "2.36")
    assert run("sensor", "mono-gel", out, "--picture", empty, *numbers)[0] == 0
    assert read_sensor(out).outline is None


def test_a_refused_picture_is_named_once(tmp_path: Path) -> None:
    no_picture = tmp_path / "empty.csv"
    no_picture.write_text("1,2")
    code, said = run("sensor", "gelsight-mini", tmp_path / "mini.toml", "--picture", no_picture)
    assert code == 3
    assert said.count("empty.csv") == 1


def test_what_cannot_be_is_said(tmp_path: Path, empty: Path) -> None:
    out = tmp_path / "mini.toml"
    assert "is not a sensor that drupe knows; known: digit," in run("sensor", "gelsight", out)[1]
    assert "found no picture of the untouched gel" in run("sensor", "gelsight-mini", out)[1]
    assert "Name the description file to write" in run("sensor", "gelsight-mini")[1]
    out.write_text('kind = "fields"\n')
    said = run("sensor", "gelsight-mini", out, "--picture", empty)[1]
    assert "a description that drupe sensor wrote" in said
    assert out.read_text() == 'kind = "fields"\n'


def grasp(force_sd: float, displacement_sd: float) -> Recording:
    """Jaws that close by 2 mm, of which either gel gives 0.25."""
    time_s = np.arange(5.0)
    share = np.linspace(0, 1, 5)
    rest = np.column_stack([*(axis.ravel() for axis in np.meshgrid([-1.0, 0, 1], [-1.0, 0, 1])), np.zeros(9)])
    pressed = share[:, None, None] * np.tile([0, 0, 1.0], (9, 1))
    fields = {"rest_mm": rest, "displacement_mm": -0.25 * pressed, "force_N": 0.5 * pressed}
    known = {"pose": np.tile(np.eye(4), (5, 1, 1)), "gel_kn_MPa_per_mm": 1.0, "gel_kt_MPa_per_mm": 0.1}
    spread = {"force_scale_sd": force_sd, "displacement_scale_sd": displacement_sd}
    pads = tuple(GelPad(name=name, **fields, **known, **spread) for name in ("left", "right"))
    return Recording(
        fruit_id="f", category="nectarine", loading="grasp", support="free", sensor="s", time_s=time_s,
        aperture_mm=60.0 - np.r_[0, np.linspace(0, 2, 4)], pads=pads,
    )  # fmt: skip


def test_the_spread_of_the_scales_is_kept_and_goes_into_e(tmp_path: Path) -> None:
    write_recording(tmp_path / "g.h5", grasp(0.2, 0.03))
    pad = read_recording(tmp_path / "g.h5").pads[0]
    assert isinstance(pad, GelPad)
    assert (pad.force_scale_sd, pad.displacement_scale_sd) == (0.2, 0.03)
    unknown, stated = sensor_scale([grasp(0.0, 0.0)], None), sensor_scale([grasp(0.2, 0.03)], None)
    assert (unknown.common, unknown.pictures) == pytest.approx((COMMON_SD, E_PER_PICTURE * PICTURE_SD))
    assert (stated.common, stated.pictures) == pytest.approx((0.2, E_PER_PICTURE * 0.03))


def test_the_common_scale_is_beside_the_error_bar_and_all_fruit_share_that_of_pictures_and_gain() -> None:
    modulus = FruitModulus(
        E_MPa=0.5, E_sd_MPa=0.02, parts_sd_MPa={"tactile noise": 0.02}, pit=None, grasps=1, warnings=()
    )
    plain = modulus_record(modulus)
    wide = modulus_record(modulus, sensor=SensorScale(common=0.1, pictures=0.2))
    gained = modulus_record(modulus, sensor=SensorScale(gain=0.2, own_gain=0.1))
    assert gained.common_sd_MPa == pytest.approx(np.hypot(plain.common_sd_MPa, 0.2 * plain.E_MPa))
    assert gained.E_sd_MPa == pytest.approx(np.hypot(gained.common_sd_MPa, np.hypot(0.02, 0.1 * plain.E_MPa)))
    assert wide.E_sd_MPa == pytest.approx(np.hypot(plain.E_sd_MPa, 0.2 * plain.E_MPa))
    assert wide.common_sd_MPa == pytest.approx(np.hypot(plain.common_sd_MPa, 0.2 * plain.E_MPa))
    assert wide.parts_sd_MPa[SENSOR] == pytest.approx(0.2 * plain.E_MPa)
    assert wide.scale_sd_MPa == pytest.approx(0.1 * plain.E_MPa)
    assert SENSOR not in plain.parts_sd_MPa
