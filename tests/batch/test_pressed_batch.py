"""`drupe grade` on fruit of which there are diameters and plates' traces alone.

Forces are those of neo-Hookean spheroids round a rigid pit by axisymmetric finite elements at finite strain
(tests/fem/compressed_solid.py), which share no code with the tables that E is read from.
"""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compressed_solid import spheroid
from scipy.interpolate import CubicSpline
from typer.testing import CliRunner

from pipeline.cli import app
from tactile.readers.recording import IndenterPad, read_recording, write_recording

RADIUS_MM, ALONG, PIT, NU = 30.0, 0.95, 0.44, 0.45
TRUE_MPA = {"firm": 1.1, "soft": 0.35}
SQUEEZES = np.array([0.0, 0.01, 0.02, 0.04, 0.06])
HEADER = "fruit_id,diameter_a_mm,diameter_b_mm,diameter_c_mm,axis"
OF_A_FRUIT = ("--indenter", "plates", "--specimen", "fruit", "--category", "nectarine")


def run(*words: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, [*map(str, words)])
    return done.exit_code, " ".join((done.output + str(done.exception or "")).split())


@pytest.fixture(scope="module")
def force_per_MPa():
    """Of a fruit of RADIUS_MM across and ALONG times that along, over the approach in mm."""
    solid = spheroid(nu=NU, along=ALONG, pit_share=PIT, round_=20, out=9)
    over = [solid.force_at(ALONG * (1 - x)) / x**1.5 for x in SQUEEZES[1:]]
    curve = CubicSpline(np.sqrt(SQUEEZES), np.r_[over[0], over])

    def force(approach_mm):
        squeeze = np.clip(approach_mm / (2 * RADIUS_MM * ALONG), 0, None)
        return RADIUS_MM**2 * curve(np.sqrt(squeeze)) * squeeze**1.5

    return force


def record(folder: Path, name: str, fruit: str, force_of, *, seed: int, deepest_mm: float = 2.4) -> Path:
    """A squeeze and a hold, written as a load cell's table and converted."""
    time_s = np.arange(0, 24, 0.2)
    travel = np.interp(time_s, [0, 2, 18, 24], [0, 0, deepest_mm + 0.1, deepest_mm + 0.1])
    force = force_of(np.maximum(travel - 0.1, 0.0))
    force = force + 0.003 * force.max() * np.random.default_rng(seed).standard_normal(len(force))
    source = folder / f"{fruit}-{name}.csv"
    rows = np.column_stack([time_s, travel, force])
    np.savetxt(source, rows, delimiter=",", header="time_s,travel_mm,force_N", comments="")
    made = folder / "batch" / "fruits" / fruit / "grasps" / f"{name}.h5"
    made.parent.mkdir(parents=True, exist_ok=True)
    sizes = ("--diameters-mm", "60", "57", "60", "--axis", "b")
    status, _ = run("convert", source, made, *OF_A_FRUIT, *sizes, "--fruit", fruit)
    assert status == 0
    return made


@pytest.fixture(scope="module")
def batch(tmp_path_factory, force_per_MPa):
    """Two sound fruit, one in grams, one whose diameters nobody wrote, one with another's recording
    too, and one of whose recordings is of a stiffer fruit under its name.
    """
    folder = tmp_path_factory.mktemp("pressed")
    for k, (fruit, E) in enumerate(TRUE_MPA.items()):
        for n in (1, 2):
            record(folder, f"squeeze-{n}", fruit, lambda d, E=E: E * force_per_MPa(d), seed=10 * k + n)
    for n, E in enumerate((0.6, 0.6, 0.96, 0.6), 1):
        record(folder, f"squeeze-{n}", "odd", lambda d, E=E: E * force_per_MPa(d), seed=20 + n)
    record(folder, "squeeze-1", "grams", lambda d: 102 * 0.6 * force_per_MPa(d), seed=31)
    bare = record(folder, "squeeze-1", "unmeasured", lambda d: 0.6 * force_per_MPa(d), seed=41)
    held = read_recording(bare)
    pad = held.pads[0]
    assert isinstance(pad, IndenterPad)
    specimen = replace(pad.specimen, diameters_mm=None)
    bare.unlink()
    write_recording(bare, replace(held, pads=(replace(pad, specimen=specimen),)))
    squeeze = record(folder, "squeeze-1", "mixed", lambda d: 0.5 * force_per_MPa(d), seed=51)
    record(folder, "other", "firm", lambda d: 1.1 * force_per_MPa(d), seed=52).rename(
        squeeze.parent / "other.h5"
    )
    rows = [f"{fruit},60,57,60,b" for fruit in ("firm", "soft", "grams", "mixed", "odd")]
    root = folder / "batch"
    (root / "fruits.csv").write_text("\n".join([HEADER, *rows, "unmeasured,,,,b"]))
    (root / "batch.toml").write_text('category = "nectarine"\n')
    return root


@pytest.fixture(scope="module")
def graded(batch):
    out = batch.parent / "results"
    code, said = run("grade", batch, "--out", out)
    assert code == 3, said
    with (out / "ranking.csv").open() as table:
        rows = {row["fruit_id"]: row for row in csv.DictReader(table)}
    records = {p.parent.name: json.loads(p.read_text()) for p in out.glob("fruits/*/record.json")}
    return rows, records, (out / "report.html").read_text()


def test_moduli_are_within_their_error_bars_and_in_order(graded):
    rows, _, _ = graded
    for fruit, truth in TRUE_MPA.items():
        E, sd = float(rows[fruit]["E_MPa"]), float(rows[fruit]["E_sd_MPa"])
        assert pytest.approx(truth, abs=1.5 * sd) == E
        assert pytest.approx(truth, rel=0.03) == E
        assert rows[fruit]["mismatch"] == "none"
    assert [rows[fruit]["rank"] for fruit in ("soft", "firm")] == ["1", "4"]


def test_a_recording_unlike_the_others_is_named_and_left_out(graded):
    rows, records, page = graded
    said = "Recording 3 (squeeze-3) does not belong to the others, and drupe leaves it out"
    assert said in rows["odd"]["warnings"]
    assert float(rows["odd"]["E_MPa"]) == pytest.approx(0.6, rel=0.03)
    assert "nominal" in page
    assert records["odd"]["screen"]["p_nominal"]


def test_a_rig_of_which_nothing_is_known_is_said(graded):
    """9 N/mm were recorded: an ordinary gripper of 8 N/mm would have given all of it."""
    said = graded[0]["firm"]["warnings"]
    assert "nothing says how stiff the rig is" in said
    assert "`rig` in batch.toml" in said


def test_the_error_bar_says_that_the_shape_is_three_diameters(graded):
    _, records, page = graded
    modulus = records["firm"]["modulus"]
    parts = modulus["parts_sd_MPa"]
    assert parts["shape from three diameters"] > 3 * parts["recordings"]
    assert np.linalg.norm(list(parts.values())) == pytest.approx(modulus["E_sd_MPa"])
    assert modulus["common_sd_MPa"] == pytest.approx(parts["Poisson's ratio"])
    assert "60 × 57 × 60 mm, squeezed along b; there is no mesh" in page
    assert "0.44 of the diameter, from prior for nectarine" in page


def test_what_is_wrong_with_one_fruit_is_said_and_costs_no_other(graded):
    rows, _, _ = graded
    assert rows["grams"]["outcome"] == "implausible-modulus"
    assert rows["unmeasured"]["outcome"] == "unreadable-recording"
    assert "columns diameter_a_mm, diameter_b_mm, diameter_c_mm 61 60 58" in rows["unmeasured"]["reason"]
    assert rows["mixed"]["outcome"] == "graded"
    assert rows["mixed"]["grasps"] == "1"
    assert "the recording belongs to another fruit of this batch" in rows["mixed"]["warnings"]


def test_check_says_beforehand_what_grading_would(batch):
    code, said = run("check", batch)
    assert code == 2
    assert "2 problems found" in said
    assert "the recording belongs to another fruit of this batch" in said
    assert "does not fully describe the fruit between the plates" in said


@pytest.mark.proof
def test_explain_takes_the_diameters_of_the_table(batch, tmp_path):
    code, said = run(
        "explain", batch, "--fruit", "soft", "--json", tmp_path / "a.json", "--out", tmp_path / "out"
    )
    assert code == 0, said
    answer = json.loads((tmp_path / "a.json").read_text())
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(TRUE_MPA["soft"], rel=0.05)


def test_plates_along_the_stem_are_refused_with_the_way_out(tmp_path, force_per_MPa):
    record(tmp_path, "squeeze-1", "a", force_per_MPa, seed=1)
    (tmp_path / "batch" / "batch.toml").write_text('category = "nectarine"\n')
    (tmp_path / "batch" / "fruits.csv").write_text(f"{HEADER}\na,60,60,57,c\n")
    said = run("check", tmp_path / "batch")[1]
    assert "squeeze-1.h5: found plates along diameter c (from stem to tip)" in said
    assert "expected plates across the cheeks (axis b)" in said


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("a,60,60,,b", "diameter_c_mm is empty; expected all three diameters"),
        ("a,6,6,5.7,c", "diameter_a_mm 6: a nectarine is 12.5 to 115 mm in size; is it in cm (60 mm)?"),
        ("a,60,60,57,z", 'axis is "z"; expected a, b or c'),
        ("a,60,57,60,b,44", 'pit_share is "44"; expected the diameter of the pit'),
        ("a,60,57,60,b,44", "is it in percent?"),
    ],
)
def test_a_slip_in_the_table_is_named(tmp_path, row, said):
    (tmp_path / "batch.toml").write_text('category = "nectarine"\n')
    (tmp_path / "fruits.csv").write_text(f"{HEADER},pit_share\n{row}\n")
    (tmp_path / "fruits" / "a" / "grasps").mkdir(parents=True)
    assert said in run("check", tmp_path)[1]


def test_three_diameters_without_a_recording_are_not_only_told_to_be_photographed(tmp_path):
    (tmp_path / "batch.toml").write_text('category = "nectarine"\n')
    (tmp_path / "fruits.csv").write_text(f"{HEADER}\na,60,60,57,b\n")
    (tmp_path / "fruits" / "a" / "grasps").mkdir(parents=True)
    said = run("grade", tmp_path, "--out", tmp_path / "out")[1]
    assert "nor is there a recording of bare plates alone in grasps/, for which the three diameters" in said
