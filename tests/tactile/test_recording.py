"""What is written is read back, and what is not a recording is refused with a sentence that says why.

A recording reads no other file, asks for no more memory than there is, and holds no number beyond use.
"""

import os
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from damaged_recordings import attribute, field, lies, recordings, with_last
from file_damage import with_hdf5
from injected_grasp import with_pads
from refusals import refused

from tactile.gel.gel_sides import GelOutline
from tactile.readers.recording import GelPad, IndenterPad, read_recording, write_recording
from tactile.readers.sensor_file import read_sensor
from tactile.readers.sensor_model import model_named
from tactile.tactile_failure import TactileFailure, TactileProblem


def assert_same(a: object, b: object) -> None:
    assert type(a) is type(b)
    for name, value in vars(a).items():
        other = getattr(b, name)
        if isinstance(value, np.ndarray):
            np.testing.assert_allclose(value, other, rtol=1e-7, atol=1e-9, err_msg=name)
        elif name == "pads":
            for mine, theirs in zip(value, other, strict=True):
                assert_same(mine, theirs)
        else:
            assert value == other, name


def with_every_field(recording):
    frames = len(recording.time_s)
    left, right = recording.pads
    certainty = np.linspace(1.0, 0.25, frames)
    left = replace(left, thickness_mm=4.0, gel_E_MPa=0.3, gel_nu=0.48, certainty=certainty)
    return replace(recording, support="base", wrench_N=np.ones((frames, 6)), pads=(left, right))


def pressed(recording):
    """A press by a bare ball."""
    pose = recording.pads[0].pose
    force_N = np.linspace(0, 1, len(pose))
    tip = IndenterPad(name="tip", pose=pose, force_z_N=force_N, indenter="ball", radius_mm=3.0)
    return replace(recording, loading="press", support="base", pads=(tip,))


@pytest.mark.parametrize("change", [lambda recording: recording, with_every_field, pressed])
def test_what_is_written_is_read_back(injected, tmp_path, change):
    recording = change(injected.recording)
    write_recording(tmp_path / "a.h5", recording)
    assert_same(recording, read_recording(tmp_path / "a.h5"))


def test_a_press_stands_on_its_base_unless_it_says_otherwise(injected, tmp_path):
    tip = replace(injected.recording.pads[0], name="tip")
    write_recording(tmp_path / "a.h5", replace(injected.recording, loading="press", pads=(tip,)))
    with h5py.File(tmp_path / "a.h5", "a") as file:
        del file.attrs["support"]
    assert read_recording(tmp_path / "a.h5").support == "base"


DAMAGED = recordings()
DAMAGE = [
    *(name for name in DAMAGED if re.fullmatch("pads/left/force_N: (?!times|backwards|chunk).*", name)),
    *(f"{name}: removed" for name in ("time_s", "aperture_mm", "pads/left/pose", "pads/left/rest_mm")),
    *(f"attribute {name}: 0" for name in ("fruit_id", "version", "format")),  # removed
    *(f"attribute gel_kt_MPa_per_mm: {k}" for k in range(10)),
    *(f"attribute sensor: {k}" for k in (0, 1, 6, 8, 9)),
]
"""A field and a constant damaged in every way, and the others removed (tests/batch/damaged_recordings.py)."""


def refusal(path, recording, change):
    write_recording(path / "grasp-7.h5", recording)
    change(path / "grasp-7.h5", np.random.default_rng(0))
    with refused(TactileProblem.UNREADABLE_RECORDING) as caught:
        read_recording(path / "grasp-7.h5")
    return str(caught.value)


@pytest.mark.parametrize("name", DAMAGE)
def test_damage_is_refused_with_file_field_found_expected_and_advice(name, injected, tmp_path):
    sentence = refusal(tmp_path, injected.recording, DAMAGED[name])
    place = name.rsplit(": ", 1)[0]
    assert re.fullmatch(rf"grasp-7\.h5: {place}( of /pads/left)?: found .*, expected .*; .*\.", sentence)


def markers_at(places):
    def change(file):
        for name in ("displacement_mm", "force_N"):
            held = file[f"pads/left/{name}"][:, : len(places)]
            del file[f"pads/left/{name}"]
            file[f"pads/left/{name}"] = held
        del file["pads/left/rest_mm"]
        file["pads/left/rest_mm"] = places

    return with_hdf5(change)


def added(name, values):
    return with_hdf5(lambda file: file.create_dataset(name, data=values))


def replaced(name, make):
    def change(file):
        del file[name]
        make(file)

    return with_hdf5(change)


def clock(file):
    """HDF5's time type, which no array can hold."""
    h5py.h5d.create(file.id, b"time_s", h5py.h5t.UNIX_D32LE, h5py.h5s.create_simple((60,)))


LEFT = "pads/left"
IN_A_ROW = np.array([[2.0 * i, 0.0, 0.0] for i in range(20)])
SAID = [
    (replaced("pads", lambda f: None), "pads: found "),
    (replaced("pads/right", lambda f: None), "pads/right: found "),
    (replaced("pads/right/displacement_mm", lambda f: None), "pads/right/displacement_mm: found "),
    (replaced("aperture_mm", lambda f: f.update({"aperture_mm": np.dtype("f8")})), "aperture_mm: found "),
    (replaced("time_s", lambda f: f.create_dataset("time_s", data=h5py.Empty("f8"))), "time_s: found "),
    (replaced("time_s", clock), "time_s: found "),
    (replaced(LEFT, lambda f: f.update({LEFT: h5py.ExternalLink("/dev/zero", "/")})), "pads/left: found a"),
    (attribute("sensor", h5py.Empty("S1")), "attribute sensor: found "),
    (attribute("format", "something-else"), "attribute format: found "),
    (attribute("loading", "squeeze"), "attribute loading: found "),
    (attribute("fruit_id", np.bytes_(b"\xff\xfe")), "attribute fruit_id: found bytes that are no UTF-8"),
    (attribute("fruit_id", "x" * 5000), "attribute fruit_id: found 5000 characters"),
    (attribute("gel_kn_MPa_per_mm", 1e-300, LEFT),
     "attribute gel_kn_MPa_per_mm of /pads/left: found 1e-300, expected 1e-06 to 10000 MPa per mm"),
    (attribute("nu", 1e-300, LEFT), "attribute nu of /pads/left: found 1e-300, expected 0.1 to 0.4999;"),
    (field("time_s", lambda v: np.tile(v[: len(v) // 2], 2)), "time_s: found "),
    (field("aperture_mm", lambda v: v[:-1]), "aperture_mm: found "),
    (field("aperture_mm", lambda v: v.astype("S8")), "aperture_mm: found values of type"),
    (added("wrench_N", np.ones((60, 5))), "wrench_N: found "),
    (added(f"{LEFT}/certainty", np.full(60, -0.5)), f"{LEFT}/certainty: found "),
    (field(f"{LEFT}/pose", lambda v: v[1:]), f"{LEFT}/pose: found "),
    (field(f"{LEFT}/pose", lambda v: v * 1.01), f"{LEFT}/pose: found "),
    (field(f"{LEFT}/pose", lambda v: v * [-1, 1, 1, 1]), f"{LEFT}/pose: found "),
    (field(f"{LEFT}/rest_mm", lambda v: v[:, :2]), f"{LEFT}/rest_mm: found "),
    (field(f"{LEFT}/displacement_mm", lambda v: v[:, 1:]), f"{LEFT}/displacement_mm: found "),
    (lies("time_s", "external"), "time_s: found a link"),
    (lies("time_s", "moved"), "time_s: found a link"),
    (lies("aperture_mm", "virtual"), "aperture_mm: found values kept in another file"),
    (lies("aperture_mm", "raw"), "aperture_mm: found values kept in another file"),
    (lies("time_s", "chunk"), "time_s: found "),
    (lies("time_s", "claimed"),
     "time_s: found contents that are damaged, or take more than 500 MB of memory to read, expected"),
    (field(f"{LEFT}/rest_mm", partial(with_last, number=1e300, at=(0, 0))),
     f"{LEFT}/rest_mm: found 1e+300 at index (0, 0), expected at most 500 "),
    (field(f"{LEFT}/force_N", partial(with_last, number=1e30, at=(0, 0, 0))),
     f"{LEFT}/force_N: found 1e+30 at index (0, 0, 0), expected at most"),
    (field("aperture_mm", partial(with_last, number=6e4, at=(0,))),
     "aperture_mm: found 60000 at index (0,), expected at most"),
    (field(f"{LEFT}/force_N", partial(with_last, number=np.nan, at=(3, 5, 1))),
     f"{LEFT}/force_N: found NaN or infinite values: 1, the first at index (3, 5, 1)"),
    (field(f"{LEFT}/force_N", lambda v: np.where(np.arange(v.shape[1])[:, None] % 2, v, np.nan)),
     f"{LEFT}/force_N: found NaN or infinite values: 19662, the first at index (0, 0, 0), in 113 of 225 "
     "markers, expected finite numbers; repair or drop those frames in the recorder, or take those markers "
     "out of rest_mm and of both fields alike."),
    (field(f"{LEFT}/pose", lambda v: v.T),
     f"{LEFT}/pose: found shape (4, 4, 58), expected shape (58, 4, 4); the dimensions are reversed, as "
     "MATLAB writes them: permute them before h5write."),
    (markers_at(IN_A_ROW),
     f"{LEFT}/rest_mm: found 20 markers on one line in x and y, expected at least 3 that are not on one "
     "line; write each marker's own x, y, z."),
    (markers_at(np.zeros((5, 3))), f"{LEFT}/rest_mm: found 5 markers in one place in x and y"),
    (markers_at(IN_A_ROW[:2]),
     f"{LEFT}/rest_mm: found 2 markers, expected at least 3 that are not on one line; record all"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "said"), SAID, ids=[said[:60] for _, said in SAID])
def test_what_a_recording_cannot_hold_is_said(change, said, injected, tmp_path):
    assert refusal(tmp_path, injected.recording, change).startswith(f"grasp-7.h5: {said}")


@pytest.mark.parametrize("name", ["half.h5", "head.h5", "empty.h5", "text.h5", "absent.h5"])
def test_a_broken_or_absent_file_is_named(name, injected, tmp_path):
    write_recording(tmp_path / "whole.h5", injected.recording)
    whole = (tmp_path / "whole.h5").read_bytes()
    held = {"half": whole[: len(whole) // 2], "head": whole[:100], "empty": b"", "text": b"not a recording"}
    for stem, content in held.items():
        (tmp_path / f"{stem}.h5").write_bytes(content)
    with refused(TactileProblem.UNREADABLE_RECORDING, rf"^{name}: the file: found "):
        read_recording(tmp_path / name)


def test_an_indenter_needs_its_shape(injected, tmp_path):
    sentence = refusal(tmp_path, pressed(injected.recording), attribute("indenter", "cone", "pads/tip"))
    assert "attribute indenter of /pads/tip: found 'cone', expected ball or" in sentence


def test_poses_in_single_precision_pass(injected, tmp_path):
    single = with_pads(injected.recording, lambda p: replace(p, pose=p.pose.astype("f4").astype("f8")))
    write_recording(tmp_path / "a.h5", single)
    assert isinstance(read_recording(tmp_path / "a.h5").pads[0], GelPad)


@pytest.mark.parametrize(
    "version", [1, np.int8(1), np.uint64(1), 1.0, np.float32(1), [1], [[1.0]], np.array([1], "i2")]
)
def test_the_version_may_be_a_number_of_any_type_as_other_languages_write_it(tmp_path, injected, version):
    path = tmp_path / "grasp-1.h5"
    write_recording(path, injected.recording)
    before = read_recording(path)
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = version
        file.attrs.create("fruit_id", [before.fruit_id], dtype=h5py.string_dtype())
        gel = file["pads/left"].attrs
        gel["gel_kn_MPa_per_mm"] = [gel["gel_kn_MPa_per_mm"]]
    again = read_recording(path)
    assert again.fruit_id == before.fruit_id
    assert again.pads[0].gel_kn_MPa_per_mm == before.pads[0].gel_kn_MPa_per_mm


@pytest.mark.parametrize("version", [2, 1.5, [1, 1], "1", True, [True], [2.0], np.nan])
def test_another_version_is_refused_in_any_type(tmp_path, injected, version):
    said = refusal(tmp_path, injected.recording, attribute("version", version))
    assert re.search("attribute version: found .*expected version 1", said)


def test_a_pipe_a_device_and_a_link_to_nothing_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "a.h5")
    (tmp_path / "b.h5").symlink_to("/dev/zero")
    (tmp_path / "c.h5").symlink_to("gone.h5")
    for name, said in (("a", "a named pipe"), ("b", "a device"), ("c", "a link to nothing")):
        with pytest.raises(TactileFailure, match=said):
            read_recording(tmp_path / f"{name}.h5")


def test_a_name_that_is_not_utf8_is_refused_and_shown_with_its_bytes(tmp_path, injected):
    path = tmp_path / b"grasp-\xff1.h5".decode(errors="surrogateescape")
    write_recording(path, injected.recording)
    said = r"grasp-\xff1.h5: the file: found a name that is not UTF-8, expected letters, digits, - and _"
    with pytest.raises(TactileFailure, match=re.escape(f"{said}; rename it.")):
        read_recording(path)


def test_a_link_to_a_recording_is_followed(tmp_path, injected):
    (tmp_path / "kept").mkdir()
    write_recording(tmp_path / "kept" / "g.h5", injected.recording)
    (tmp_path / "g.h5").symlink_to(tmp_path / "kept" / "g.h5")
    assert len(read_recording(tmp_path / "g.h5").time_s) > 0


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


SENSOR_REFUSALS = [
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


@pytest.mark.parametrize(("written_as", "instead", "field", "fault"), SENSOR_REFUSALS)
def test_a_wrong_field_is_named(
    tmp_path: Path, written_as: str, instead: str, field: str, fault: str
) -> None:
    assert written_as in MONO
    path = written(tmp_path, MONO.replace(written_as, instead))
    with refused(TactileProblem.UNREADABLE_SENSOR, rf"sensor\.toml: {field}: found .*{re.escape(fault)}"):
        read_sensor(path)


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
