"""Tables, arrays, pictures and folders of other tools: what a name states, and every slip named."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from tac3d_folder import FRAMES, KN, KT, REST, write_sensor

import tactile.readers.plain_numpy
from pipeline.files.plain_file import NotReadable
from tactile.from_tac3d import recording_of_tac3d
from tactile.readers import pictures
from tactile.readers.decimal_number import decimal_number
from tactile.readers.grasp_log import read_columns, read_log
from tactile.readers.load_cell import read_trace
from tactile.readers.pictures import read_picture
from tactile.readers.plain_numpy import load_npy, load_npz
from tactile.readers.recording import Converted, GelPad
from tactile.readers.specimen import PressedSpecimen
from tactile.readers.stated_unit import NoUnit, Unit, unit_of_name
from tactile.readers.tac3d import Tac3D, read_tac3d, sensor_folders
from tactile.readers.trace_columns import TraceWords, proposed
from tactile.tactile_failure import TactileFailure


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            'time_s,aperture_mm\n0,"60,5"\n',
            'log.csv: aperture_mm: found "60,5" in row 2, expected a number up to',
        ),
        ('time_s,aperture_mm\n0,"60,5"\n', "; it has a decimal comma; write 60.5."),
        ("time_s,aperture_mm\n0,6_0\n", "; write 60."),
        ("time_s,aperture_mm\n0,\u0666\u0660\n", "; write 60."),
        ("time_s,aperture_mm\n0,nan\n", 'aperture_mm: found "nan" in row 2, expected a number'),
        (
            "time_s,aperture_mm\n0,60,5\n",
            "found 3 cells in row 2, expected 2 as in the header, and numbers with",
        ),
        ('time_s,aperture_mm\n0,60\n1,"59\n2,58\n', "found a quotation mark in line 3 that does not end"),
        ("time_s,aperture_mm\n0," + "6" * 140_000 + "\n", "found a cell in line 2 that does not end"),
        ("time_s;aperture_mm\n0;60,5\n", "found cells separated by semicolons, expected commas"),
        ("Time_s,aperture_mm\n0,60\n", "expected time_s in place of Time_s."),
        ("time_s,time_s,aperture_mm\n0,0,60\n", "found the column 'time_s' twice, expected each column once"),
    ],
)
def test_a_slip_is_named_with_how_to_write_it(tmp_path, text, said):
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    with pytest.raises(TactileFailure, match=r"^log\.csv: .*" + re.escape(said.removeprefix("log.csv: "))):
        read_log(tmp_path / "log.csv")


@pytest.mark.parametrize("text", ["0", "-3", "+2.5", ".5", "5.", "1e-3", "1.5E+10", " 7 "])
def test_plain_numbers_are_pythons_own(text):
    assert decimal_number(text) == float(text)


def test_a_missing_table_is_asked_for_by_the_columns_that_are_wanted_of_it(tmp_path):
    with pytest.raises(TactileFailure, match=r"expected a table with the columns frame, time_s\.$"):
        read_columns(tmp_path / "times.csv", wanted=("frame", "time_s"))
    with pytest.raises(TactileFailure, match=r"expected a table with the columns time_s, aperture_mm\.$"):
        read_log(tmp_path / "log.csv")
    with pytest.raises(
        TactileFailure, match=r"expected a table with the columns time_s, travel_mm, force_N\.$"
    ):
        read_trace(tmp_path / "t.csv", fruit_id="f", category="plum", indenter="ball", radius_mm=4.0)


@pytest.mark.parametrize(
    ("header", "way"),
    [
        (["Time (s)", "Compression (mm)", "Load (N)", "Engineering Strain [-]"], "Compression (mm)"),
        (["Time", "Compressive stress (MPa)", "Load", "Compressive extension"], "Compressive extension"),
        (["time", "Compressive load", "Deflection"], "Deflection"),
        (["Zeit", "Kraft", "Stauchung"], "Stauchung"),
        (["Zeit (s)", "Verschiebung (mm)", "Kraft (N)"], "Verschiebung (mm)"),
        (["Tiempo", "Fuerza", "Desplazamiento"], "Desplazamiento"),
        (["Tiempo", "Carga", "Compresión"], "Compresión"),
        (["Temps", "Déplacement", "Force"], "Déplacement"),
    ],
)
def test_the_proposed_travel_is_a_length_by_its_usual_names(header, way):
    said = proposed(header)
    assert f"travel={way}" in said
    assert "NAME" not in said


OPEN = [
    "Load x1 (N)",
    "Kraft (N) / Force (N)",
    "Force [N] max",
    "Load [N] *1000",
    "Load (N) in kN",
    "F/10 N",
    "Force (N)/mm",
    "Force (N) 1000",
    "Force 10³ N",
    "F_kN [N]",
    "Load (N) × 0.1",
    "Load 1e3 N",
]
READ = ["Load cell 2 (N)", "Force_N", "Load_10_N", "Fx1 (N)", "F / N", "Kraft in [N]", "Dev1/ai0 load (N)"]


@pytest.mark.parametrize("name", OPEN)
def test_a_factor_or_a_second_unit_leaves_the_unit_open(name: str) -> None:
    unit = unit_of_name(name, "force")
    assert isinstance(unit, NoUnit)
    assert unit.open


@pytest.mark.parametrize("name", READ)
def test_the_number_of_a_channel_is_no_factor(name: str) -> None:
    assert unit_of_name(name, "force") == Unit(text="N", factor=1.0)


def test_a_travel_has_the_same_rules() -> None:
    assert all(
        isinstance(unit := unit_of_name(name, "travel"), NoUnit) and unit.open
        for name in ("Travel (mm) (x1000)", "Travel (mm) (in)", "Travel 0,01 mm", "Weg (µm) (mm)")
    )
    assert unit_of_name("Travel in (mm)", "travel") == Unit(text="mm", factor=1.0)


@pytest.mark.parametrize(
    ("header", "said"),
    [
        (
            "Time (s);Travel (mm);Force (N) x 10",
            r'"Force \(N\) x 10", which has more than its unit at its end.*force=UNIT',
        ),
        ("Time (s);Travel (mm);Load x10\ns;mm;N", r'has a factor beside it \("x10"\).*force=UNIT'),
        ("Time (s);Travel (mm);Load (N)\ns;mm;x 10", r'has a factor beside it \("x 10"\).*force=UNIT'),
    ],
)
def test_an_open_unit_is_refused_until_the_user_states_it(tmp_path, header: str, said: str) -> None:
    path = tmp_path / "press.csv"
    rows = "\n".join(f"{k / 10};{k / 20};{0.02 * k**1.5:.6f}" for k in range(30))
    path.write_text(f"{header}\n{rows}\n")
    names = dict(zip(("time", "travel", "force"), header.split("\n")[0].split(";"), strict=True))

    def read(units: dict[str, str]):
        words = TraceWords(columns=names, units=units)
        wanted = {"fruit_id": "unknown", "category": "unknown", "indenter": "ball", "radius_mm": 5.0}
        return read_trace(path, **wanted, specimen=PressedSpecimen(), words=words)

    with pytest.raises(TactileFailure, match=said):
        read({})
    converted = read({"force": "daN"})
    np.testing.assert_allclose(converted.recording.pads[0].force_z_N[-1], 0.2 * 29**1.5, rtol=1e-5)
    assert any("read in daN" in note for note in converted.notes)


def test_arrays_come_back_in_double_precision(tmp_path):
    values = np.arange(12, dtype=np.int16).reshape(3, 4)
    np.save(tmp_path / "a.npy", values)
    np.savez_compressed(tmp_path / "a.npz", first=values, second=2.5 * values)
    np.testing.assert_array_equal(load_npy(tmp_path / "a.npy"), values)
    held = load_npz(tmp_path / "a.npz")
    assert {name: array.dtype for name, array in held.items()} == {"first": float, "second": float}
    np.testing.assert_array_equal(held["second"], 2.5 * values)


def test_arrays_that_unpack_to_too_much_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(tactile.readers.plain_numpy, "MOST_MEMORY", 50_000_000)
    np.savez_compressed(tmp_path / "a.npz", first=np.zeros(60_000_000, np.uint8))
    with pytest.raises(NotReadable, match="unpacks to more than 50 MB"):
        load_npz(tmp_path / "a.npz")


def test_objects_are_not_unpickled(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(NotReadable, match="is no whole NumPy file"):
        load_npy(tmp_path / "a.npy")


def converted(*sensors: Tac3D) -> Converted:
    return recording_of_tac3d(sensors, fruit_id="f1", category="nectarine")


def gel(sensor: Tac3D) -> GelPad:
    return converted(sensor).recording.pads[0]


def test_every_number_is_kept_but_for_the_forces_sign_and_the_origin(tmp_path: Path) -> None:
    sensor = read_tac3d(write_sensor(tmp_path / "AD2"))
    pad = gel(sensor)
    np.testing.assert_array_equal(pad.displacement_mm, sensor.displacement_mm)
    np.testing.assert_array_equal(pad.force_N, -sensor.force_N)
    np.testing.assert_allclose(pad.rest_mm[:, 2] + 11.0 - 0.03 * 0.5, REST[:, 2], atol=1e-9)
    np.testing.assert_allclose(pad.rest_mm - pad.rest_mm[0], REST - REST[0], atol=1e-9)


def test_a_pressed_gel_pushes_the_fruit_and_its_stiffness_is_read_off_the_loaded_markers(
    tmp_path: Path,
) -> None:
    pad = gel(read_tac3d(write_sensor(tmp_path / "AD2")))
    assert pad.force_N[-1, :, 2].sum() > 0
    assert pad.displacement_mm[-1, :, 2].min() < 0
    assert pad.gel_kn_MPa_per_mm == pytest.approx(KN, rel=0.02)
    assert pad.gel_kt_MPa_per_mm == pytest.approx(KT, rel=0.02)


def test_lost_frames_and_the_deadband_are_said(tmp_path: Path) -> None:
    sensor = read_tac3d(write_sensor(tmp_path / "AD2", lost=(20, 21, 30)))
    said = " ".join(converted(sensor).notes)
    assert "AD2: 3 of 40 frames are missing (2 gaps in the index)" in said
    assert "13 frames are exactly zero (a deadband)" in said
    assert "no aperture and no pose" in said


def test_two_clocks_six_seconds_apart_are_brought_together_by_the_forces(tmp_path: Path) -> None:
    left_sensor = read_tac3d(write_sensor(tmp_path / "left", clock_s=100.0))
    right_sensor = read_tac3d(write_sensor(tmp_path / "right", clock_s=106.0, starts_s=0.12))
    joined = converted(left_sensor, right_sensor)
    assert "the time stamps of left and right differ by 6.12 s (two clocks)" in " ".join(joined.notes)
    left, right = (
        np.asarray(pad.force_N).sum(axis=1)[:, 2] for pad in joined.recording.pads if isinstance(pad, GelPad)
    )
    np.testing.assert_allclose(left, right, atol=0.06 * left.max())


def test_sensor_folders_are_found_in_the_folder_above(tmp_path: Path) -> None:
    for name in ("b", "a"):
        write_sensor(tmp_path / name)
    assert [p.name for p in sensor_folders(tmp_path)] == ["a", "b"]
    assert [p.name for p in sensor_folders(tmp_path / "b")] == ["b"]


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        (
            "3D_Forces",
            np.zeros((FRAMES, 35, 3)),
            r"AD2/3D_Forces.npy: found shape \(40, 35, 3\), expected shape",
        ),
        ("3D_Positions", np.full((FRAMES, 36, 3), np.nan), "AD2/3D_Positions.npy: found a value in frame 0"),
        ("sendTimestamp", np.zeros(FRAMES), "AD2/sendTimestamp.npy: found 0 s in frame 1 after 0 s"),
        ("index", np.array(["a"] * FRAMES), "AD2/index.npy: found that it holds values of type"),
    ],
)
def test_a_wrong_array_is_named(tmp_path: Path, name: str, values: np.ndarray, says: str) -> None:
    folder = write_sensor(tmp_path / "AD2")
    np.save(folder / f"{name}.npy", values)
    with pytest.raises(TactileFailure, match=says):
        converted(read_tac3d(folder))


def test_a_cut_and_a_missing_array_are_named(tmp_path: Path) -> None:
    folder = write_sensor(tmp_path / "AD2")
    (folder / "3D_Forces.npy").write_bytes((folder / "3D_Forces.npy").read_bytes()[:1000])
    with pytest.raises(TactileFailure, match=r"AD2/3D_Forces\.npy: found .*copy it again"):
        read_tac3d(folder)
    (folder / "3D_Forces.npy").unlink()
    with pytest.raises(TactileFailure, match=r"AD2/3D_Forces\.npy: found no such file"):
        read_tac3d(folder)


IMAGE = np.random.default_rng(1).integers(0, 255, (48, 64, 3), np.uint8)


@pytest.mark.parametrize("kind", [".png", ".jpg"])
def test_pngs_and_jpegs_are_read(tmp_path, kind):
    (tmp_path / f"a{kind}").write_bytes(cv2.imencode(kind, IMAGE)[1].tobytes())
    assert read_picture(tmp_path / f"a{kind}").shape == IMAGE.shape


@pytest.mark.parametrize("kind", [".bmp", ".tiff", ".webp"])
def test_another_kind_under_a_pngs_name_is_refused_before_it_is_decoded(tmp_path, monkeypatch, kind):
    data = cv2.imencode(kind, IMAGE)[1].tobytes() + b"IEND"
    (tmp_path / "frame_000000.png").write_bytes(data)
    monkeypatch.setattr(cv2, "imdecode", None)  # it must not come so far
    with pytest.raises(TactileFailure, match="found a damaged picture, no PNG or JPEG"):
        read_picture(tmp_path / "frame_000000.png")


def test_a_picture_larger_than_any_camera_s_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "MOST_PIXELS", 3000)
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", IMAGE)[1].tobytes())
    with pytest.raises(TactileFailure, match="found frames of 64 x 48 pixels, expected at most"):
        read_picture(tmp_path / "a.png")


def test_a_picture_that_does_not_fit_into_memory_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "MOST_FRAME_MEMORY", 20_000_000)
    large = np.zeros((6000, 6000, 3), np.uint8)
    (tmp_path / "a.png").write_bytes(cv2.imencode(".png", large)[1].tobytes())
    with pytest.raises(TactileFailure, match="or more than 20 MB of pixels"):
        read_picture(tmp_path / "a.png")
