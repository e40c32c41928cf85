"""What is written is read back, and what is not a recording is refused with a sentence that says why."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tactile.io.hdf5_dimensions import REVERSED
from tactile.io.recording import GelPad, IndenterPad, Recording, read_recording, write_recording
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


def test_what_is_written_is_read_back(injected, tmp_path):
    write_recording(tmp_path / "a.h5", injected.recording)
    assert_same(injected.recording, read_recording(tmp_path / "a.h5"))


def test_optional_fields_come_back_too(injected, tmp_path):
    recording = injected.recording
    frames = len(recording.time_s)
    picture = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3)
    left = replace(
        recording.pads[0],
        thickness_mm=4.0,
        gel_E_MPa=0.3,
        gel_nu=0.48,
        certainty=np.linspace(1.0, 0.25, frames),
        images=np.repeat(picture[None], frames, axis=0),
        images_reference=picture,
    )
    full = replace(recording, support="base", wrench_N=np.ones((frames, 6)), pads=(left, recording.pads[1]))
    write_recording(tmp_path / "a.h5", full)
    assert_same(full, read_recording(tmp_path / "a.h5", images=True))
    assert read_recording(tmp_path / "a.h5").pads[0].images is None


def test_a_bare_indenter_is_a_legal_pad(injected, tmp_path):
    frames = len(injected.recording.time_s)
    tip = IndenterPad(
        name="tip",
        pose=injected.recording.pads[0].pose,
        force_z_N=np.linspace(0, 1, frames),
        indenter="ball",
        radius_mm=3.0,
    )
    press = replace(injected.recording, loading="press", support="base", pads=(tip,))
    write_recording(tmp_path / "a.h5", press)
    assert_same(press, read_recording(tmp_path / "a.h5"))


def test_a_press_stands_on_its_base_unless_it_says_otherwise(injected, tmp_path):
    press = replace(
        injected.recording, loading="press", pads=(replace(injected.recording.pads[0], name="tip"),)
    )
    write_recording(tmp_path / "a.h5", press)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        del file.attrs["support"]
    assert read_recording(tmp_path / "a.h5").support == "base"


def drop(name):
    def change(file):
        del file[name]

    return change


def put(name, change_values):
    def change(file):
        values = np.array(file[name])
        del file[name]
        file[name] = change_values(values)

    return change


def attribute(name, value, of="/"):
    def change(file):
        if value is None:
            del file[of].attrs[name]
        else:
            file[of].attrs[name] = value

    return change


def poke(index, value):
    def change_values(values):
        values[index] = value
        return values

    return change_values


def hollow(name):
    """A null dataspace: a type and no values."""

    def change(file):
        del file[name]
        file[name] = h5py.Empty("f8")

    return change


def clock(name):
    """HDF5's own time type, which no array can hold."""

    def change(file):
        del file[name]
        space = h5py.h5s.create_simple((60,))
        h5py.h5d.create(file.id, name.encode(), h5py.h5t.UNIX_D32LE, space)

    return change


def datatype(name):
    """A stored type under a field's name."""

    def change(file):
        del file[name]
        file[name] = np.dtype("f8")

    return change


REFUSALS = {
    "a type for a field": (datatype("aperture_mm"), "aperture_mm"),
    "an array for a version": (attribute("version", np.ones((30, 30))), "attribute version"),
    "empty time": (hollow("time_s"), "time_s"),
    "empty force": (hollow("pads/left/force_N"), "pads/left/force_N"),
    "an empty text": (attribute("sensor", h5py.Empty("S1")), "attribute sensor"),
    "time in HDF5's time type": (clock("time_s"), "time_s"),
    "no format": (attribute("format", None), "attribute format"),
    "another format": (attribute("format", "something-else"), "attribute format"),
    "no version": (attribute("version", None), "attribute version"),
    "a later version": (attribute("version", 2), "attribute version"),
    "a version in words": (attribute("version", "one"), "attribute version"),
    "an unknown loading": (attribute("loading", "squeeze"), "attribute loading"),
    "an unknown support": (attribute("support", "glued"), "attribute support"),
    "no fruit": (attribute("fruit_id", None), "attribute fruit_id"),
    "a number for a sensor": (attribute("sensor", 3), "attribute sensor"),
    "no time": (drop("time_s"), "time_s"),
    "time that starts again": (put("time_s", lambda v: np.tile(v[: len(v) // 2], 2)), "time_s"),
    "time that stands still": (put("time_s", lambda v: np.repeat(v[::2], 2)), "time_s"),
    "time as text": (put("time_s", lambda v: [str(x) for x in v]), "time_s"),
    "no aperture": (drop("aperture_mm"), "aperture_mm"),
    "a short aperture": (put("aperture_mm", lambda v: v[:-1]), "aperture_mm"),
    "a five-column wrench": (lambda f: f.create_dataset("wrench_N", data=np.ones((60, 5))), "wrench_N"),
    "a certainty that is no share": (
        lambda f: f.create_dataset("pads/left/certainty", data=np.full(60, 2.0)),
        "pads/left/certainty",
    ),
    "a certainty below nothing": (
        lambda f: f.create_dataset("pads/left/certainty", data=np.full(60, -0.5)),
        "pads/left/certainty",
    ),
    "no pads": (drop("pads"), "pads"),
    "one pad of a grasp": (drop("pads/right"), "pads/right"),
    "no pose": (drop("pads/left/pose"), "pads/left/pose"),
    "a pose too few": (put("pads/left/pose", lambda v: v[1:]), "pads/left/pose"),
    "a pose in metres and scaled": (put("pads/left/pose", lambda v: v * 1.01), "pads/left/pose"),
    "a mirroring pose": (put("pads/left/pose", lambda v: v * [-1, 1, 1, 1]), "pads/left/pose"),
    "no rest": (drop("pads/left/rest_mm"), "pads/left/rest_mm"),
    "rest in the plane": (put("pads/left/rest_mm", lambda v: v[:, :2]), "pads/left/rest_mm"),
    "no displacement": (drop("pads/right/displacement_mm"), "pads/right/displacement_mm"),
    "a marker less": (put("pads/left/displacement_mm", lambda v: v[:, 1:]), "pads/left/displacement_mm"),
    "no force": (drop("pads/left/force_N"), "pads/left/force_N"),
    "NaN in force": (put("pads/left/force_N", poke((3, 5, 1), np.nan)), "pads/left/force_N"),
    "infinite displacement": (
        put("pads/left/displacement_mm", poke((0, 0, 0), np.inf)),
        "pads/left/displacement_mm",
    ),
    "no gel stiffness": (
        attribute("gel_kn_MPa_per_mm", None, "pads/left"),
        "attribute gel_kn_MPa_per_mm of /pads/left",
    ),
    "a soft gel below zero": (
        attribute("gel_kt_MPa_per_mm", -1.0, "pads/left"),
        "attribute gel_kt_MPa_per_mm of /pads/left",
    ),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_refused_with_file_field_found_expected_and_advice(name, injected, tmp_path):
    change, field = REFUSALS[name]
    path = tmp_path / "grasp-7.h5"
    write_recording(path, injected.recording)
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(TactileFailure) as caught:
        read_recording(path)
    assert caught.value.problem is TactileProblem.UNREADABLE_RECORDING
    sentence = str(caught.value)
    assert sentence.startswith(f"grasp-7.h5: {field}: found ")
    assert ", expected " in sentence
    assert "; " in sentence
    assert "\n" not in sentence


def test_a_value_that_is_not_finite_is_placed(injected, tmp_path):
    path = tmp_path / "a.h5"
    write_recording(path, injected.recording)
    with h5py.File(path, "a") as file:
        file["pads/left/force_N"][3, 5, 1] = np.nan
    with pytest.raises(TactileFailure, match=r"index \(3, 5, 1\)"):
        read_recording(path)


def lost(frames, markers):
    def change(values):
        values = values.copy()
        values[frames, markers] = np.nan
        return values

    return change


SECOND = slice(None, None, 2)
LOST = {
    "every second marker": (
        put("pads/left/force_N", lost(slice(None), SECOND)),
        "found 113 of 225 markers have no values in any frame",
        "take them out of rest_mm and of both fields alike",
    ),
    "every second marker's place": (
        put("pads/left/rest_mm", lost(SECOND, slice(None))),
        "found 113 of 225 markers have no values (",
        "take them out of rest_mm and of both fields alike",
    ),
    "every second marker from the middle": (
        put("pads/left/displacement_mm", lost(slice(20, None), SECOND)),
        "found 113 of 225 markers have no values in some of the frames",
        "too many to drop them",
    ),
    "one frame": (
        put("pads/left/force_N", lost(20, slice(None))),
        "found 675 value(s) NaN or infinite, the first at index (20, 0, 0)",
        "drop those frames",
    ),
}


@pytest.mark.parametrize("name", LOST)
def test_markers_without_values_are_counted_and_frames_are_dropped_only_where_few_lack_some(
    name, injected, tmp_path
):
    change, found, advice = LOST[name]
    write_recording(tmp_path / "a.h5", injected.recording)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        change(file)
    with pytest.raises(TactileFailure) as caught:
        read_recording(tmp_path / "a.h5")
    assert found in str(caught.value)
    assert advice in str(caught.value)


def broken_files(path: Path, recording: Recording) -> None:
    write_recording(path / "whole.h5", recording)
    whole = (path / "whole.h5").read_bytes()
    (path / "half.h5").write_bytes(whole[: len(whole) // 2])
    (path / "head.h5").write_bytes(whole[:100])
    (path / "empty.h5").write_bytes(b"")
    (path / "text.h5").write_text("not a recording")


@pytest.mark.parametrize("name", ["half.h5", "head.h5", "empty.h5", "text.h5", "absent.h5"])
def test_a_broken_or_absent_file_is_named(name, injected, tmp_path):
    broken_files(tmp_path, injected.recording)
    with pytest.raises(TactileFailure, match=rf"^{name}: the file: found ") as caught:
        read_recording(tmp_path / name)
    assert caught.value.problem is TactileProblem.UNREADABLE_RECORDING


def test_an_indenter_needs_its_shape(injected, tmp_path):
    pose = injected.recording.pads[0].pose
    tip = IndenterPad(name="tip", pose=pose, force_z_N=np.zeros(len(pose)), indenter="ball", radius_mm=3.0)
    write_recording(tmp_path / "a.h5", replace(injected.recording, loading="press", pads=(tip,)))
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["pads/tip"].attrs["indenter"] = "cone"
    with pytest.raises(
        TactileFailure, match="attribute indenter of /pads/tip: found 'cone', expected ball or"
    ):
        read_recording(tmp_path / "a.h5")


def test_poses_in_single_precision_pass(injected, tmp_path):
    pads = tuple(
        replace(pad, pose=pad.pose.astype(np.float32).astype(np.float64)) for pad in injected.recording.pads
    )
    write_recording(tmp_path / "a.h5", replace(injected.recording, pads=pads))
    assert isinstance(read_recording(tmp_path / "a.h5").pads[0], GelPad)


def _with_reversed(path):
    with h5py.File(path, "r+") as file:
        found = []
        file.visititems(lambda name, one: found.append(name) if isinstance(one, h5py.Dataset) else None)
        for name in found:
            values = file[name][()]
            del file[name]
            file[name] = values.T if values.ndim > 1 else values[None]


def test_a_recording_whose_dimensions_are_all_reversed_is_read_and_noted(tmp_path, injected):
    path = tmp_path / "g.mat"
    write_recording(path, injected.recording)
    sound = read_recording(path)
    _with_reversed(path)
    found = read_recording(path)
    assert found.notes == (REVERSED,)
    assert sound.notes == ()
    np.testing.assert_array_equal(found.time_s, sound.time_s)
    for pad, other in zip(found.pads, sound.pads, strict=True):
        for name in ("pose", "rest_mm", "displacement_mm", "force_N"):
            np.testing.assert_array_equal(getattr(pad, name), getattr(other, name))
