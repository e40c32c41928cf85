"""A sensor's description is read as written, a wrong one refused by file and field."""

from pathlib import Path

import numpy as np
import pytest

from tactile.gel.gel_sides import GelOutline
from tactile.readers.sensor_file import read_sensor
from tactile.readers.sensor_model import model_named
from tactile.tactile_failure import TactileFailure, TactileProblem

MONO = """
kind = "markers-mono"
name = "dots"
serial = "A1"
[gel]
thickness_mm = 4.0
E_MPa = 0.25
nu = 0.48
[camera]
image_px = [640, 480]
focal_px = [520.0, 521.0]
centre_px = [319.5, 239.5]
distortion = [-0.1, 0.01, 0.0, 0.0, 0.0]
gel_from_camera = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -16], [0, 0, 0, 1]]
[markers]
rows = 2
columns = 3
pitch_mm = [2.0, 1.0]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "sensor.toml"
    path.write_text(text)
    return path


def test_every_field_is_read_as_written(tmp_path: Path) -> None:
    sensor = read_sensor(written(tmp_path, MONO))
    assert sensor.outline is None
    assert (sensor.kind, sensor.name, sensor.serial) == ("markers-mono", "dots", "A1")
    assert (sensor.thickness_mm, sensor.E_MPa, sensor.nu) == (4.0, 0.25, 0.48)
    assert sensor.camera.image_px == (640, 480)
    assert sensor.camera.distortion == (-0.1, 0.01, 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(sensor.camera.matrix, [[520, 0, 319.5], [0, 521, 239.5], [0, 0, 1]])
    np.testing.assert_array_equal(sensor.camera.camera_from_gel[:3, 3], [0, 0, 16])
    expected = [[-2, -0.5, 0], [0, -0.5, 0], [2, -0.5, 0], [-2, 0.5, 0], [0, 0.5, 0], [2, 0.5, 0]]
    np.testing.assert_array_equal(sensor.rest_mm, expected)


def test_a_fields_sensor_needs_a_name_only(tmp_path: Path) -> None:
    sensor = read_sensor(written(tmp_path, 'kind = "fields"\nname = "Tac3D"\n'))
    assert sensor.camera is None
    assert sensor.rest_mm is None


DOME = "nu = 0.48\nsize_mm = [26, 22]\nface_radius_mm = [{}, {}]"


def test_a_description_says_where_the_gel_ends_and_markers_lie_on_its_domed_face(tmp_path: Path) -> None:
    flat = 'nu = 0.48\nsize_mm = [26, 22]\ncentre_mm = [0.5, 0]\nsides = "bonded"'
    outline = read_sensor(written(tmp_path, MONO.replace("nu = 0.48", flat))).outline
    assert outline == GelOutline((26.0, 22.0), (0.5, 0.0), "bonded")
    rest = read_sensor(written(tmp_path, MONO.replace("nu = 0.48", DOME.format(190, 114)))).rest_mm
    assert rest[0, 2] == pytest.approx(-(2**2) / (2 * 190) - 0.5**2 / (2 * 114))


REFUSALS = [
    ('kind = "markers-mono"', 'kind = "dots"', "kind", "'dots'"),
    ("thickness_mm = 4.0", "thickness = 4.0", "gel.thickness", "not known"),
    ("thickness_mm = 4.0", "", "gel.thickness_mm", "nothing"),
    ("thickness_mm = 4.0", "thickness_mm = -4.0", "gel.thickness_mm", "-4"),
    ("thickness_mm = 4.0", 'thickness_mm = "4"', "gel.thickness_mm", "'4'"),
    ("thickness_mm = 4.0", "thickness_mm = true", "gel.thickness_mm", "True"),
    ("nu = 0.48", "nu = 0.5", "gel.nu", "0.5"),
    ("nu = 0.48", "nu = 1e-300", "gel.nu", "1e-300, expected 0.1 to 0.4999."),
    (
        "nu = 0.48",
        "nu = 0.48\ngel_kn_MPa_per_mm = 1e-300",
        "gel.gel_kn_MPa_per_mm",
        "expected 1e-06 to 10000",
    ),
    ("nu = 0.48", "nu = 0.48\ngel_kt_MPa_per_mm = 1e-300", "gel.gel_kt_MPa_per_mm", "1e-300"),
    ("E_MPa = 0.25", "E_MPa = 1e-300", "gel.E_MPa", "expected 1e-05 to 10000 MPa (is it in Pa or kPa?)"),
    ("thickness_mm = 4.0", "thickness_mm = 1e-300", "gel.thickness_mm", "1e-300"),
    ("focal_px = [520.0, 521.0]", "focal_px = [520.0, 1e-300]", "camera.focal_px", "1e-300"),
    ("pitch_mm = [2.0, 1.0]", "pitch_mm = [2.0, 1e-300]", "markers.pitch_mm", "0.01 or more"),
    ("image_px = [640, 480]", "image_px = [640.5, 480]", "camera.image_px", "640.5"),
    ("focal_px = [520.0, 521.0]", "focal_px = [520.0]", "camera.focal_px", "shape (1,)"),
    ("[[1, 0, 0, 0]", "[[2, 0, 0, 0]", "camera.gel_from_camera", "no rotation"),
    ("rows = 2", "rows = 0", "markers.rows", "0"),
    ('kind = "markers-mono"', 'kind = "markers-stereo"', "second_camera", "nothing"),
    ("nu = 0.48", "nu = 0.48\nsize_mm = [26, 0.2]", "gel.size_mm", "[26.0, 0.2]"),
    ("nu = 0.48", "nu = 0.48\nsize_mm = [26]", "gel.size_mm", "shape (1,)"),
    ("nu = 0.48", 'nu = 0.48\nsides = "free"', "gel.size_mm", "none"),
    ("nu = 0.48", "nu = 0.48\ncentre_mm = [0, 0]", "gel.size_mm", "none"),
    ("nu = 0.48", 'nu = 0.48\nsize_mm = [26, 22]\nsides = "glued"', "gel.sides", "'glued'"),
    ("nu = 0.48", "nu = 0.48\nface_radius_mm = [190, 114]", "gel.size_mm", "none"),
    ("nu = 0.48", DOME.format(10, 114), "gel.face_radius_mm", "[10.0, 114.0]"),
    ("nu = 0.48", DOME.format(26, 26), "gel.face_radius_mm", "expected corners at most 60%"),
    ('name = "dots"', 'name = "dots', "the file", "line"),
]


@pytest.mark.parametrize(("written_as", "instead", "field", "fault"), REFUSALS)
def test_a_wrong_field_is_named(
    tmp_path: Path, written_as: str, instead: str, field: str, fault: str
) -> None:
    assert written_as in MONO
    path = written(tmp_path, MONO.replace(written_as, instead))
    with pytest.raises(TactileFailure) as caught:
        read_sensor(path)
    assert caught.value.problem is TactileProblem.UNREADABLE_SENSOR
    assert str(caught.value).startswith(f"sensor.toml: {field}: found ")
    assert fault in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TactileFailure, match=r"none\.toml: the file: found no such file"):
        read_sensor(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("sensor", "key"),
    [
        ("DIGIT", "digit"),
        ("digit D20123", "digit"),
        ("DIGIT SN 20123", "digit"),
        ("DIGIT #7", "digit"),
        ("Tac3D A1-0040R", "tac3d"),
        ("gelsight-mini 28A1-XYZ", "gelsight-mini"),
        ("GelSight Mini, marked gel 28A1-XYZ", "gelsight-mini"),
        ("DIGIT 360", None),
        ("DIGIT Pinki", None),
        ("DIGIT 360 SN 7", None),
        ("DIGIT v2", None),
        ("Tac3D (own gel)", None),
        ("GelSight Mini, marked gel of ours", None),
    ],
)
def test_only_a_serial_number_may_follow_the_name(sensor: str, key: str | None) -> None:
    model = model_named(sensor)
    assert (None if model is None else model.key) == key
