"""A recording reads no other file, asks for no more memory than there is, and holds no number beyond use."""

import os

import h5py
import numpy as np
import pytest
from injected_grasp import injected_grasp

from tactile.io.recording import read_recording, write_recording
from tactile.tactile_failure import TactileFailure


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    path = tmp_path_factory.mktemp("sound") / "sound.h5"
    write_recording(path, injected_grasp(np.random.default_rng(3)).recording)
    return path.read_bytes()


def refusal(tmp_path, sound, change):
    path = tmp_path / "grasp-1.h5"
    path.write_bytes(sound)
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(TactileFailure) as caught:
        read_recording(path)
    return caught.value.detail


def put(name, values):
    def change(file):
        del file[name]
        file[name] = values

    return change


def value(name, number):
    def change(file):
        file[name][(0,) * file[name].ndim] = number

    return change


def external_link(file):
    del file["time_s"]
    file["time_s"] = h5py.ExternalLink("other.h5", "/time_s")


def external_group(file):
    del file["pads/left"]
    file["pads/left"] = h5py.ExternalLink("/dev/zero", "/")


def soft_link(file):
    file.move("time_s", "elsewhere")
    file["time_s"] = h5py.SoftLink("/elsewhere")


def virtual(file):
    frames = len(file["time_s"])
    layout = h5py.VirtualLayout(shape=(frames,), dtype="f8")
    layout[:] = h5py.VirtualSource("other.h5", "time_s", shape=(frames,))
    del file["aperture_mm"]
    file.create_virtual_dataset("aperture_mm", layout)


def raw_storage(file):
    frames = len(file["time_s"])
    del file["aperture_mm"]
    file.create_dataset("aperture_mm", (frames,), "f8", external=[("/etc/passwd", 0, 8 * frames)])


def claimed(file):
    del file["time_s"]
    file.create_dataset("time_s", (10**9,), "f8", chunks=(1024,))


def chunked(file):
    frames = len(file["time_s"])
    del file["time_s"]
    file.create_dataset("time_s", (frames,), "f8", chunks=(10**9,), maxshape=(None,))


def attribute(name, held, dtype=None):
    def change(file):
        file.attrs.create(name, held, dtype=dtype)

    return change


def markers_at(places):
    def change(file):
        count = len(places)
        for name in ("rest_mm", "displacement_mm", "force_N"):
            held = file[f"pads/left/{name}"][...]
            del file[f"pads/left/{name}"]
            file[f"pads/left/{name}"] = places if name == "rest_mm" else held[:, :count]

    return change


def pad_attribute(name, held):
    def change(file):
        file["pads/left"].attrs[name] = held

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (external_link, "time_s: found a link to another file, expected all fields"),
        (external_group, "pads/left: found a link"),
        (soft_link, "time_s: found a link"),
        (virtual, "aperture_mm: found values kept in another file"),
        (raw_storage, "aperture_mm: found values kept in another file"),
        (
            claimed,
            "time_s: found shape (1000000000,), 8000 MB in all fields up to this one, expected at most",
        ),
        (chunked, "time_s: found chunks of 8000 MB"),
        (
            value("pads/left/rest_mm", 1e300),
            "rest_mm: found 1e+300 at index (0, 0), expected at most 500 ",
        ),
        (
            value("pads/left/force_N", 1e30),
            "force_N: found 1e+30 at index (0, 0, 0), expected at most",
        ),
        (
            value("aperture_mm", 60_000.0),
            "aperture_mm: found 60000 at index (0,), expected at most",
        ),
        (
            pad_attribute("gel_kn_MPa_per_mm", 1e-300),
            "attribute gel_kn_MPa_per_mm of /pads/left: found 1e-300, expected 1e-06 to 10000 MPa per mm",
        ),
        (pad_attribute("gel_kt_MPa_per_mm", 1e-300), "found 1e-300, expected 1e-06 to 10000 MPa per mm"),
        (pad_attribute("thickness_mm", 1e-300), "found 1e-300, expected 0.01 to 200 millimetres"),
        (pad_attribute("nu", 1e-300), "attribute nu of /pads/left: found 1e-300, expected 0.1 to 0.4999;"),
        (attribute("fruit_id", b"\xff\xfe", "S2"), "attribute fruit_id: found bytes that are no UTF-8"),
        (attribute("fruit_id", "x" * 5000), "attribute fruit_id: found 5000 characters"),
        (attribute("sensor", np.zeros(8000)), "attribute sensor: found"),
        (
            markers_at(np.array([[2.0 * i, 0.0, 0.0] for i in range(20)])),
            "pads/left/rest_mm: found 20 markers on one line in x and y, expected at least 3 that are not on "
            "one line; write each marker's own x, y, z.",
        ),
        (
            markers_at(np.array([[0.0, 2.0 * i, 2.0 * j] for i in range(4) for j in range(4)])),
            "pads/left/rest_mm: found 16 markers on one line in x and y",
        ),
        (markers_at(np.zeros((5, 3))), "pads/left/rest_mm: found 5 markers in one place in x and y"),
        (
            markers_at(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])),
            "pads/left/rest_mm: found 2 markers, expected at least 3 that are not on one line; record all",
        ),
        (markers_at(np.zeros((1, 3))), "pads/left/rest_mm: found 1 marker, expected at least 3"),
    ],
)
def test_the_field_is_named_and_nothing_else_is_read(tmp_path, sound, change, said):
    assert said in refusal(tmp_path, sound, change)


@pytest.mark.parametrize(
    "version", [1, np.int8(1), np.uint64(1), 1.0, np.float32(1), [1], [[1.0]], np.array([1], "i2")]
)
def test_the_version_may_be_a_number_of_any_type_as_other_languages_write_it(tmp_path, sound, version):
    path = tmp_path / "grasp-1.h5"
    path.write_bytes(sound)
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
def test_another_version_is_refused_in_any_type(tmp_path, sound, version):
    said = refusal(tmp_path, sound, attribute("version", version))
    assert "attribute version: found" in said
    assert "expected version 1" in said


def test_a_pipe_a_device_and_a_link_to_nothing_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "a.h5")
    (tmp_path / "b.h5").symlink_to("/dev/zero")
    (tmp_path / "c.h5").symlink_to("gone.h5")
    for name, said in (("a", "a named pipe"), ("b", "a device"), ("c", "a link to nothing")):
        with pytest.raises(TactileFailure, match=said):
            read_recording(tmp_path / f"{name}.h5")


def test_a_name_that_is_not_utf8_is_refused_and_shown_with_its_bytes(tmp_path, sound):
    path = tmp_path / b"grasp-\xff1.h5".decode(errors="surrogateescape")
    path.write_bytes(sound)
    with pytest.raises(TactileFailure) as caught:
        read_recording(path)
    said = r"grasp-\xff1.h5: the file: found a name that is not UTF-8, expected letters, digits, - and _"
    assert caught.value.detail == f"{said}; rename it."


def test_a_link_to_a_recording_is_followed(tmp_path, sound):
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "g.h5").write_bytes(sound)
    (tmp_path / "g.h5").symlink_to(tmp_path / "kept" / "g.h5")
    assert len(read_recording(tmp_path / "g.h5").time_s) > 0
