"""Tables and arrays: plain numbers, every slip named by row and column, units that a name states."""

import numpy as np
import pytest

import tactile.readers.plain_numpy
from pipeline.files.plain_file import NotReadable
from tactile.readers.decimal_number import decimal_number
from tactile.readers.grasp_log import read_columns, read_log
from tactile.readers.load_cell import read_trace
from tactile.readers.plain_numpy import load_npy, load_npz
from tactile.readers.specimen import PressedSpecimen
from tactile.readers.stated_unit import NoUnit, Unit, unit_of_name
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
        (
            "time_s,aperture_mm\n0,nan\n",
            'aperture_mm: found "nan" in row 2, expected a number',
        ),
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
    with pytest.raises(TactileFailure) as caught:
        read_log(tmp_path / "log.csv")
    assert caught.value.detail.startswith("log.csv: ")
    assert said in caught.value.detail


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
