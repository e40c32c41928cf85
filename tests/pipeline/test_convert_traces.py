"""Tables of a load cell converted, and curves of punches and plates explained."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from small_batches import run as command
from small_batches import said_with

from tactile.readers.cell_rows import sheets_of
from tactile.readers.recording import IndenterPad, read_recording, write_recording

BALL = ("--indenter", "ball", "--radius-mm", "5")
TIMES = np.arange(30) / 10
PRESSED = 0.02 * np.arange(30) ** 1.5
GONE = 0.05 * np.arange(30)
XLS = Path(__file__).parents[1] / "data" / "press.xls"
"""Two steps of a rheometer, 30 rows each: names, a row of units, s, N and um; written once with xlwt 1.3."""
HEADER = "time_s,travel_mm,force_N"
NAMES = "time=Time,force=Force,travel=Pos"
run = partial(command, "convert")


def table(header: str, *columns: np.ndarray, mark: str = ",", comma: bool = False, form: str = "%.9g") -> str:
    rows = [mark.join(form % value for value in row) for row in np.stack(columns, axis=1)]
    text = "\n".join(rows).replace(".", ",") if comma else "\n".join(rows)
    return f"{header}\n{text}\n"


def written(
    folder: Path, *columns: np.ndarray, name: str = "t.csv", header: str = HEADER, **how: object
) -> Path:
    """The table in a file."""
    (folder / name).write_text(table(header, *(columns or (TIMES, GONE, PRESSED)), **how))
    return folder / name


def read_back(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    recording = read_recording(path)
    pad = recording.pads[0]
    assert isinstance(pad, IndenterPad)
    return recording.time_s, recording.aperture_mm, pad.force_z_N


def converted(folder: Path, source: Path, *options: str) -> str:
    said = said_with(0, "convert", source, folder / "out.h5", *BALL, *options)
    time_s, travel_mm, force_N = read_back(folder / "out.h5")
    np.testing.assert_allclose(time_s, TIMES, atol=1e-6)
    np.testing.assert_allclose(travel_mm, GONE, atol=1e-6)
    np.testing.assert_allclose(force_N, PRESSED, atol=1e-6)
    (folder / "out.h5").unlink()
    return said


def refused(folder: Path, source: Path, *options: str) -> str:
    code, said = run(source, folder / "out.h5", *BALL, *options)
    assert code in (1, 3), said
    assert not list(folder.glob("*.h5"))
    assert "sensor" not in said
    return " ".join(said.split())


def test_names_that_are_not_known_are_asked_back_with_the_option_that_names_them(tmp_path: Path) -> None:
    source = written(tmp_path, TIMES, PRESSED, PRESSED, GONE, header="Time,Force,GoalForce,Pos")
    said = refused(tmp_path, source)
    assert "found the columns Time, Force, GoalForce, Pos" in said
    assert "give --columns time=Time,force=Force,travel=Pos." in said
    said = refused(tmp_path, source, "--columns", NAMES)
    assert 'no unit of time ("Time") in the file' in said
    assert "force in N, kN, mN, kgf, gf, lbf" in said
    said = converted(tmp_path, source, "--columns", NAMES, "--units", "time=s,force=N,travel=mm")
    assert 'force is "Force" in N' in said


@pytest.mark.parametrize(
    ("units", "factors"),
    [
        ("time=ms,force=mN,travel=um", (1e3, 1e3, 1e3)),
        ("time=min,force=g,travel=cm", (1 / 60, 1 / 9.80665e-3, 0.1)),
        ("time=s,force=kgf,travel=mm", (1, 1 / 9.80665, 1)),
    ],
)
def test_every_unit_comes_out_in_seconds_newtons_and_millimetres(
    tmp_path: Path, units: str, factors: tuple[float, float, float]
) -> None:
    values = [v * factor for v, factor in zip((TIMES, PRESSED, GONE), factors, strict=True)]
    source = written(tmp_path, *values, header="Time,Force,Pos", form="%.12g")
    converted(tmp_path, source, "--columns", NAMES, "--units", units)


@pytest.mark.parametrize(
    ("suffix", "mark", "comma"),
    [("csv", ";", True), ("txt", "\t", False), ("tsv", "\t", True), ("txt", " ", False), ("txt", "  ", True),
     ("csv", ",", False), ("csv", ", ", False)],
)  # fmt: skip
def test_every_delimiter_with_a_mark_and_lines_above_the_table(
    tmp_path: Path, suffix: str, mark: str, comma: bool
) -> None:
    source = tmp_path / f"t.{suffix}"
    above = "\ufeffTexture report 3\nOperator: A. B., room 2\n\n" if mark.strip(" ") else "\ufeff"
    header = mark.join(("time_s", "travel_mm", "force_N"))
    body = table(header, TIMES, GONE, PRESSED, mark=mark, comma=comma)
    source.write_text(above + body, encoding="utf-8")
    assert ("decimal commas" in converted(tmp_path, source)) == comma


@pytest.mark.parametrize("encoding", ["utf-16", "cp1252"])
def test_letters_of_windows_are_read_and_a_gap_that_closes_is_a_travel(tmp_path: Path, encoding: str) -> None:
    source = tmp_path / "t.txt"
    text = table("Zeit (s)\tKraft (N)\tGap (µm)", TIMES, PRESSED, 9000 - 1e3 * GONE, mark="\t")
    source.write_bytes(text.encode(encoding))
    assert '--columns "time=Zeit (s),force=Kraft (N),gap=Gap (µm)".' in refused(tmp_path, source)
    said = converted(tmp_path, source, "--columns", "time=Zeit (s),force=Kraft (N),gap=Gap (µm)")
    assert "the gap is 9 mm at first" in said


def test_a_spreadsheet_of_old_asks_for_its_sheet_and_reads_the_row_of_units(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    columns = "time=Step time,force=Axial force,gap=Gap"
    assert f'--columns "{columns}".' in refused(tmp_path, XLS)
    said = refused(tmp_path, XLS, "--columns", columns)
    assert 'found 2 sheets with these columns: "Axial - 1", "Axial - 2"' in said
    assert '--sheet "Axial - 1"' in said
    converted(tmp_path, XLS, "--columns", columns, "--sheet", "Axial - 1")
    wrong = ("--columns", columns, "--sheet", "Axial - 9")
    assert "(Details, Axial - 1, Axial - 2)" in refused(tmp_path, XLS, *wrong)
    other = ("--columns", columns, "--sheet", "Axial - 1", "--units", "gap=mm")
    assert "in µm by the row of units and in mm by --units" in refused(tmp_path, XLS, *other)


def test_a_new_spreadsheet_is_read(tmp_path: Path) -> None:
    pytest.importorskip("python_calamine")
    table = pd.DataFrame({"time_s": TIMES, "travel_mm": GONE, "force_N": PRESSED})
    table.to_excel(tmp_path / "t.xlsx", index=False)
    converted(tmp_path, tmp_path / "t.xlsx")
    (tmp_path / "broken.xlsx").write_bytes((tmp_path / "t.xlsx").read_bytes()[:300])
    assert "found a damaged or locked spreadsheet" in refused(tmp_path, tmp_path / "broken.xlsx")


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("time_s,travel_mm,force_N\n0,0,0\n1,abc,2\n2,3,4\n", (), 't.csv: travel_mm: found "abc" in row 3'),
        ("time_s,travel_mm,force_N\n0,0,0\n1,1,5,2\n", (), "found 4 cells in row 3, expected 3 as"),
        ("time_s,travel_mm,force_N\n0,0,0\n0,1,1\n", (), "0 s in row 3 after 0 s, expected increasing"),
        ("time_s,travel_mm,force_N\n", (), "found no rows, expected a header and one row for each"),
        ("1,2,3\n2,3,4\n3,4,5\n", (), "no row of names above columns of numbers"),
        ("time_s;travel_mm;force_N\n0;0;0\n1;1,5;1.000,2\n", (), '"1.000,2" in row 3, expected either'),
        ("time_s;travel_mm;force_N\n0;0;0\n1;1,5;1.5\n", (), '"1,5" in row 3 and "1.5" in row 3, expected'),
        ("time_s,travel_mm,force_N\n0,9,0\n1,8,1\n2,7,4\n", (), "Is it a gap? Give --columns gap=..."),
        ("time_s,gap_mm,force_N\n0,0,0\n1,1,1\n2,2,4\n", (), "Is it a travel? Give --columns travel=..."),
        ("T,T,F\n0,0,0\n1,1,1\n2,2,2\n", ("time=T,force=F,travel=T",), "the column 'T' twice"),
        ("Time,Pos,Frc\n0,0,0\n1,1,1\n2,2,2\n", (NAMES,), 'did you mean force="Frc"?'),
        ("T,P,F (Pa)\n0,0,0\n1,1,1\n2,2,2\n", ("time=T,force=F (Pa),travel=P",), "a pressure or stress, not"),
    ],
)
def test_a_bad_table_is_refused_with_its_row_or_column(
    tmp_path: Path, text: str, options: tuple[str, ...], words: str
) -> None:
    (tmp_path / "t.csv").write_text(text)
    assert words in refused(tmp_path, tmp_path / "t.csv", *(w for o in options for w in ("--columns", o)))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--columns", "Time"), 'holds "Time"; give time=Time,force=Force,travel=Pos'),
        (("--columns", ""), 'holds ""; give time=Time'),
        (("--columns", "time=a,time=b"), "names time twice"),
        (("--columns", "travel=a,gap=b"), "names both a travel and a gap"),
        (("--units", "force=stone-ish"), "says force=stone-ish, which is no unit that is known; give N, kN"),
        (("--units", "force=MPa"), "which is a pressure or stress, not a force; give N, kN, mN"),
        (("--units", "force=lbf"), "in N by its name and in lbf by --units"),
        (("--units", "pressure=Pa"), 'holds "pressure=Pa"'),
        (
            ("--units", "gap=um"),
            '--units of gap, where time ("time_s"), force ("force_N"), travel ("travel_mm")',
        ),
        (("--columns", "time=time_s,force=time_s,travel=travel_mm"), "one column named for two quantities"),
        *((f"--run={run}", "the number of a run (from 1), or all") for run in ("0", "x", "-1", "1.5")),
    ],
)
def test_an_option_that_says_nothing_is_refused(tmp_path: Path, options: str | tuple, words: str) -> None:
    assert words in refused(tmp_path, written(tmp_path), *np.atleast_1d(options))


def test_names_and_numbers_that_spaces_part_are_counted(tmp_path: Path) -> None:
    columns = (TIMES, PRESSED, GONE)
    source = written(tmp_path, *columns, header="Time (s)  Force (N)  Pos (mm)", mark="  ", name="t.txt")
    converted(tmp_path, source, "--columns", "time=Time (s),force=Force (N),travel=Pos (mm)")
    written(tmp_path, *columns, header="Time Axial Force Pos", mark=" ", name="t.txt")
    said = refused(tmp_path, source, "--columns", NAMES, "--units", "time=s,force=N,travel=mm")
    assert "4 names above 3 columns of numbers, apart by spaces" in said


def test_columns_of_what_is_no_table_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time_s=TIMES)
    assert "is not a load cell's table" in refused(tmp_path, tmp_path / "a.npz", "--columns", NAMES)


def test_a_last_row_cut_short_and_a_clock_of_the_day_are_said(tmp_path: Path) -> None:
    source = written(tmp_path, 1.75e9 + TIMES, GONE, PRESSED, form="%.12g")
    source.write_text(source.read_text() + "17\n")
    said = " ".join(converted(tmp_path, source).split())
    assert "1 row at the end, from row 32 on, not whole; drupe left out" in said
    assert "time starts at 1750000000 s; drupe counts from the first frame" in said


@pytest.mark.parametrize("mark", [";", "\t", ","])
def test_a_quotation_mark_that_does_not_end_is_refused_and_no_row_is_lost(tmp_path: Path, mark: str) -> None:
    source = tmp_path / "t.csv"
    lines = table(mark.join(("time_s", "travel_mm", "force_N")), TIMES, GONE, PRESSED, mark=mark).splitlines()
    lines = [f"{line}{mark}{note}" for line, note in zip(lines, ["note", *[""] * len(TIMES)], strict=True)]
    lines[4] += '"5 in'
    source.write_text("\n".join(lines) + "\n")
    assert "a quotation mark in line 5 that does not end" in refused(tmp_path, source)


def test_a_cell_that_was_not_tared_keeps_its_sign(tmp_path: Path) -> None:
    low = PRESSED - 2 * float(PRESSED.max())
    said = said_with(0, "convert", written(tmp_path, TIMES, GONE, low), tmp_path / "out.h5", *BALL)
    assert "reversed its sign" not in said
    np.testing.assert_allclose(read_back(tmp_path / "out.h5")[2], low, atol=1e-6)


@pytest.mark.parametrize("rows", [3, 20])
def test_rows_at_the_end_that_were_never_written_are_one_note(tmp_path: Path, rows: int) -> None:
    source = written(tmp_path)
    source.write_text(source.read_text() + "9.0,1.0,\n" * rows)
    assert f"{rows} rows at the end" in converted(tmp_path, source)


def test_text_may_be_called_xls(tmp_path: Path) -> None:
    converted(tmp_path, written(tmp_path, name="t.xls", header=HEADER.replace(",", "\t"), mark="\t"))


@pytest.mark.parametrize("mark", [";", "\t", ",", "|"])
def test_a_line_on_the_separator_says_what_parts_the_cells(tmp_path: Path, mark: str) -> None:
    rows = [["time_s", "travel_mm", "force_N"], ["0.1", "0.2", "0.3"], ["0.2", "0.3", "0.4"]]
    path = tmp_path / "trace.csv"
    path.write_text(f"sep={mark}\n" + "".join(mark.join(row) + "\n" for row in rows))
    (sheet,) = sheets_of(path)
    assert sheet.rows == tuple(enumerate(rows, 2))


@pytest.mark.parametrize(
    ("name", "unit_N", "options", "words"),
    [
        ("Load (kg)", 9.80665, (), "is in kg, a mass: taken as its weight (1 kg = 9.80665 N)"),
        ("Load (lb)", 4.4482216152605, (), "is in lb, a mass: taken as its weight (1 lb = 4.44822 N)"),
        ("Load (kN)", 1e3, ("--units", "force=kN"), 'force is "Load (kN)" in kN'),
        ("Load (kgf)", 9.80665, ("--units", "force=kg"), 'force is "Load (kgf)" in kgf'),
        ("Load (Ch 2)", 4.4482216152605, ("--units", "force=lbf"), 'states "Ch 2", which is no unit that is'),
    ],
)
def test_a_unit_in_a_name_is_taken_and_what_must_be_known_of_it_is_said(
    tmp_path: Path, name: str, unit_N: float, options: tuple[str, ...], words: str
) -> None:
    header = f"Time (s),{name},Pos (mm)"
    source = written(tmp_path, TIMES, PRESSED / unit_N, GONE, header=header, form="%.12g")
    columns = f"time=Time (s),force={name},travel=Pos (mm)"
    assert words in converted(tmp_path, source, "--columns", columns, *options)


def test_a_unit_that_is_not_known_is_never_proposed_as_ours(tmp_path: Path) -> None:
    source = written(tmp_path, TIMES, PRESSED, GONE, header="Time (s),Load (klumps),Pos (mm)")
    columns = "time=Time (s),force=Load (klumps),travel=Pos (mm)"
    said = refused(tmp_path, source, "--columns", columns)
    assert "--units force=UNIT" in said
    assert "force=N" not in said


@pytest.mark.parametrize("header", ["", "time_s,travel_mm,force_N\n"])
@pytest.mark.parametrize("runs", [2, 3, 5])
def test_runs_one_below_the_other_are_refused_by_number_or_converted_one_by_one(
    tmp_path: Path, runs: int, header: str
) -> None:
    source = tmp_path / "t.csv"
    body = [table("", TIMES, GONE, (1 + 0.1 * k) * PRESSED).lstrip() for k in range(runs)]
    source.write_text("time_s,travel_mm,force_N\n" + header.join(body))
    said = refused(tmp_path, source)
    assert f"found {({2: 'two', 3: 'three', 5: 'five'})[runs]} runs one below the other" in said
    assert "--run all" in said
    assert "sort" not in said
    assert f"{runs} runs" in refused(tmp_path, source, "--run", str(runs + 1))
    said_with(0, "convert", source, tmp_path / "out.h5", *BALL, "--run", "2")
    np.testing.assert_allclose(read_back(tmp_path / "out.h5")[2], 1.1 * PRESSED, atol=1e-6)
    said_with(0, "convert", source, tmp_path / "all.h5", *BALL, "--run", "all")
    for k in range(runs):
        force = read_back(tmp_path / f"all-{k + 1}.h5")[2]
        np.testing.assert_allclose(force, (1 + 0.1 * k) * PRESSED, atol=1e-6)


LACKING = np.where(np.arange(30) == 9, np.nan, PRESSED)


def all_runs(folder: Path, *forces: np.ndarray) -> str:
    """The message of the conversion of a table with these runs; drupe cannot write some of them."""
    body = [table("", TIMES, GONE, force).lstrip() for force in forces]
    (folder / "t.csv").write_text(f"{HEADER}\n{''.join(body)}")
    return said_with(3, "convert", folder / "t.csv", folder / "all.h5", *BALL, "--run", "all")


def test_a_bad_run_is_named_and_costs_no_other_run(tmp_path: Path) -> None:
    said = all_runs(tmp_path, PRESSED, LACKING, 1.2 * PRESSED)
    assert f"drupe: did not write {tmp_path / 'all-2.h5'}: t.csv: found 1 of 30 rows" in said
    assert [f"wrote {tmp_path / f'all-{k}.h5'}\n" in said for k in (1, 2, 3)] == [True, False, True]
    assert sorted(path.name for path in tmp_path.glob("*.h5")) == ["all-1.h5", "all-3.h5"]
    np.testing.assert_allclose(read_back(tmp_path / "all-3.h5")[2], 1.2 * PRESSED, atol=1e-6)


def test_a_file_of_an_earlier_conversion_is_named_if_its_run_fails_now(tmp_path: Path) -> None:
    all_runs(tmp_path, PRESSED, PRESSED, LACKING)
    said = all_runs(tmp_path, PRESSED, LACKING, LACKING)
    first, last = [line for line in said.splitlines() if line.startswith("drupe: did not write")]
    earlier = ". The file there is of an earlier conversion; remove it."
    assert first.startswith(f"drupe: did not write {tmp_path / 'all-2.h5'}: t.csv: found 1 of 30 rows")
    assert (first.endswith(earlier), last.endswith(earlier)) == (True, False)
    assert ".." not in first
    assert sorted(path.name for path in tmp_path.glob("*.h5")) == ["all-1.h5", "all-2.h5"]


def test_every_fault_of_a_table_without_a_usable_run_is_named(tmp_path: Path) -> None:
    said = all_runs(tmp_path, *(np.where(np.arange(30) < whole, PRESSED, np.nan) for whole in (29, 27)))
    assert f"drupe: did not write {tmp_path / 'all-1.h5'}: t.csv: found 1 of 30 rows" in said
    assert f"drupe: did not write {tmp_path / 'all-2.h5'}: t.csv: found 3 of 30 rows" in said
    assert not list(tmp_path.glob("*.h5"))


CYLINDER = ("--indenter", "plates", "--specimen", "cylinder", "--height-mm", "12", "--diameter-mm", "15")
FRUIT = ("--indenter", "plates", "--diameters-mm", "61", "60", "58", "--axis", "c")
OILED = (*CYLINDER, "--ends", "lubricated")
RUBBER = 'category = "rubber"\npoisson_ratio = 0.499\n'
E_MPA = 0.4


def pressed(path, force_of, deepest_mm, *, noise=0.001, step=1):
    """A ramp after some frames in the air, and a hold; noise as a share of the peak. `step`: of frames."""
    travel = np.r_[np.zeros(30), np.linspace(0, deepest_mm + 0.1, 90), np.full(40, deepest_mm + 0.1)][::step]
    force = force_of(np.maximum(travel - 0.1, 0.0))
    force = force + noise * force.max() * np.random.default_rng(2).standard_normal(len(force))
    rows = np.column_stack([np.arange(len(travel)) * step / 10, travel, force])
    np.savetxt(path, rows, delimiter=",", header="time_s,travel_mm,force_N", comments="")
    return path


@pytest.fixture
def source(tmp_path):
    return pressed(tmp_path / "t.csv", sliding_N, 3.0)


@pytest.fixture
def case(tmp_path):
    (tmp_path / "case").mkdir()
    return tmp_path / "case"


def tip_of(path):
    pad = read_recording(path).pads[0]
    assert isinstance(pad, IndenterPad)
    return pad


def explained(folder, case, *sources, options):
    made = folder / "case"
    made.mkdir()
    (made / "case.toml").write_text(case)
    for k, source in enumerate(sources):
        said_with(0, "convert", source, made / f"press-{k + 1}.h5", *options)
    said_with(0, "explain", made, "--json", folder / "answer.json", "--html", folder / "page.html")
    return json.loads((folder / "answer.json").read_text())


def sliding_N(depth):
    """Treloar's incompressible cylinder of 15 x 12 mm between oiled plates."""
    left = 1 - depth / 12
    return E_MPA * np.pi * 15**2 / 4 * (left**-2 - left) / 3


def test_a_cylinder_between_oiled_plates_gives_its_modulus(source, tmp_path):
    answer = explained(tmp_path, RUBBER, source, options=OILED)
    assert answer["verdict"] == "none"
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(E_MPA, rel=0.02)
    assert any("taken as sliding" in note for note in answer["notes"])
    assert "cylinder 15 mm wide, 12 mm high" in (tmp_path / "page.html").read_text()


def test_a_punch_gives_boussinesqs_modulus_and_says_what_it_cannot_look_for(tmp_path):
    source = pressed(tmp_path / "t.csv", lambda d: 2 * 3.0 * E_MPA / (1 - 0.45**2) * d, 0.5)
    punch = ("--indenter", "flat", "--radius-mm", "3")
    answer = explained(tmp_path, 'category = "silicone"\npoisson_ratio = 0.45\n', source, options=punch)
    assert answer["verdict"] == "none"
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(E_MPA, rel=0.02)
    assert any(note.startswith("Stiffening was not looked for") for note in answer["notes"])
    assert {"stiffening", "damage"}.isdisjoint(hypothesis["effect"] for hypothesis in answer["ranking"])


def test_the_specimen_is_kept_in_the_recording(source, tmp_path):
    for k, options in enumerate(((*FRUIT, "--pit-share", "0"), (*CYLINDER, "--ends", "bonded"))):
        assert command("convert", source, tmp_path / f"{k}.h5", *options)[0] == 0
    fruit, cylinder = (tip_of(tmp_path / f"{k}.h5") for k in range(2))
    assert (fruit.indenter, fruit.radius_mm) == ("plate", None)
    assert fruit.specimen.stated == {"diameters_mm": (61.0, 60.0, 58.0), "axis": "c", "pit_share": 0.0}
    sizes = {"height_mm": 12.0, "diameter_mm": 15.0}
    assert cylinder.specimen.stated == {"kind": "cylinder", **sizes, "ends": "bonded"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--indenter", "flat"), "ball or flat with --radius-mm"),
        (("--indenter", "plates", "--radius-mm", "3"), "--radius-mm is the radius of a ball or punch"),
        (("--indenter", "plates"), "give --specimen cylinder with --height-mm 12"),
        (CYLINDER[:-2], "does not fully describe the cylinder between the plates; give --diameter-mm"),
        (("--indenter", "plate", "--specimen", "fruit", "--axis", "a"), "give --diameters-mm 61 60 58"),
        ((*FRUIT, "--ends", "bonded"), "gives --ends for a fruit, which has only --specimen, --diameters-mm"),
        (("--indenter", "ball", "--radius-mm", "3", "--height-mm", "4"), "gives --height-mm for a ball on"),
        (("--indenter", "flat", "--radius-mm", "9", "--thickness-mm", "2"), "radius 9 mm on 2 mm of flesh"),
        (("--indenter", "plates", "--diameters-mm", "90", "60", "40", "--axis", "c"), "more than 1.6 times"),
    ],
)
def test_what_is_missing_or_strange_is_asked_for_before_a_file_is_written(source, tmp_path, options, words):
    said = said_with(1, "convert", source, tmp_path / "out.h5", *options)
    assert words in " ".join(said.split())
    assert not (tmp_path / "out.h5").exists()


@pytest.mark.proof
def test_an_older_files_plate_is_explained_once_the_case_says_what_was_between(source, case):
    """Files of before have a radius and no specimen."""
    assert command("convert", source, case / "old.h5", *OILED)[0] == 0
    with h5py.File(case / "old.h5", "a") as file:
        pad = file["pads/tip"].attrs
        for name in ("specimen", "height_mm", "diameter_mm", "ends"):
            del pad[name]
        pad["radius_mm"] = 5.0
    (case / "case.toml").write_text('category = "rubber"\npoisson_ratio = 0.45\n')
    said = said_with(1, "explain", case)
    assert (
        "old.h5: does not name the specimen between the plates; give specimen cylinder with height_mm 12"
        in said
    )
    (case / "case.toml").write_text(
        'category = "rubber"\npoisson_ratio = 0.45\nspecimen = "cylinder"\nheight_mm = 12\n'
        'diameter_mm = 15\nends = "lubricated"\n'
    )
    assert command("explain", case)[0] == 0


def test_a_fruit_takes_its_categorys_pit_and_says_so(tmp_path):
    source = pressed(tmp_path / "t.csv", lambda d: 0.9 * d**1.5, 4.0)
    case, options = 'category = "nectarine"\naxis = "b"\n', (*FRUIT, "--category", "nectarine")
    answer = explained(tmp_path, case, source, options=options)
    notes = " ".join(answer["notes"])
    assert "drupe uses the category's pit, 0.44 of the fruit's diameter" in notes
    assert "axis is c in the recording but b in case.toml; drupe uses the latter" in notes
    assert "The fruit's shape" in notes
    assert "squeezed along 60 mm" in (tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_a_curve_of_another_specimen_is_named_by_its_file_and_left_out(tmp_path):
    """The third cylinder is 1.5 times as stiff as the others."""
    stiffer = (1.0, 1.0, 1.5, 1.0)
    sources = [
        pressed(tmp_path / f"{k}.csv", lambda d, times=times: times * sliding_N(d), 2.0, step=2)
        for k, times in enumerate(stiffer)
    ]
    answer = explained(tmp_path, RUBBER, *sources, options=OILED)
    assert answer["left_out"] == ["press-3"]
    said = "Recording 3 (press-3) does not belong to the others"
    assert answer["notes"][0].startswith(said)
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(E_MPA, rel=0.02)
    page = (tmp_path / "page.html").read_text()
    assert said in page
    assert "nominal: it assumes" in page
    assert answer["p_nominal"].startswith("nominal")


@pytest.mark.proof
def test_three_recordings_of_one_specimen_have_one_modulus_and_their_own_first_touch(tmp_path):
    sources = [pressed(tmp_path / f"{k}.csv", sliding_N, 2.0 + 0.5 * k) for k in range(3)]
    answer = explained(tmp_path, RUBBER, *sources, options=OILED)
    assert answer["verdict"] == "none"
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(E_MPA, rel=0.02)
    assert {f"onset_mm{end}" for end in ("", "_2", "_3")} <= answer["ranking"][0]["parameters"].keys()
    assert any(note.startswith("Recording 3 (press-3): First touch 0.099") for note in answer["notes"])


def test_two_bare_jaws_are_two_plates_with_the_mean_of_their_forces(source, case, tmp_path):
    (case / "case.toml").write_text(RUBBER)
    assert command("convert", source, case / "one.h5", *OILED)[0] == 0
    press = read_recording(case / "one.h5")
    tip = tip_of(case / "one.h5")
    jaws = [
        replace(tip, name=name, force_z_N=k * tip.force_z_N) for name, k in (("left", 0.9), ("right", 1.1))
    ]
    grasp = replace(
        press, loading="grasp", support="free", aperture_mm=12.1 - press.aperture_mm, pads=tuple(jaws)
    )
    (case / "one.h5").unlink()
    write_recording(case / "jaws.h5", grasp)
    assert command("explain", case, "--json", tmp_path / "a.json")[0] == 0
    answer = json.loads((tmp_path / "a.json").read_text())
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(E_MPA, rel=0.02)
    write_recording(
        case / "jaws.h5", replace(grasp, pads=(jaws[0], replace(jaws[1], indenter="flat", radius_mm=3.0)))
    )
    assert "has two bare pads, plate and flat" in command("explain", case)[1]


def test_a_shape_without_a_law_is_refused_by_explain_as_well(source, case):
    (case / "case.toml").write_text('category = "rubber"\npoisson_ratio = 0.45\nheight_mm = 1.5\n')
    assert command("convert", source, case / "one.h5", *CYLINDER, "--ends", "bonded")[0] == 0
    said = said_with(3, "explain", case)
    assert "height 0.1 diameters, expected 0.25 to 3" in " ".join(said.split())
