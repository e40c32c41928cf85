"""`drupe convert` of a trace doubts a force that is noise, and an E that the category cannot have."""

import numpy as np
import pytest
from small_batches import run

TIME_S = np.arange(400) / 20
TRAVEL_MM = TIME_S / 20
DEPTH_MM = np.clip(TRAVEL_MM - 0.15, 0, None)
NOISE = np.random.default_rng(1).standard_normal(400)
PER_STRAIN = 1 / (1 - 0.45**2)
"""Plane-strain modulus over E at the peach's Poisson's ratio."""
LAWS = {
    "ball": (4 / 3 * PER_STRAIN * np.sqrt(5) * DEPTH_MM**1.5, ("--radius-mm", "5")),
    "flat": (2 * PER_STRAIN * 3 * DEPTH_MM, ("--radius-mm", "3")),
    "plates": (
        np.pi / 4 * 15**2 * DEPTH_MM / 12,
        *(("--specimen", "cylinder", "--height-mm", "12", "--diameter-mm", "15", "--ends", "lubricated"),),
    ),
}
"""Force (N) at E = 1 MPa: Hertz, a flat punch of 3 mm, a cylinder under uniaxial stress."""


def table(force_N):
    rows = zip(TIME_S, TRAVEL_MM, force_N, strict=True)
    return "time_s,travel_mm,force_N\n" + "".join(f"{t:.3f},{d:.6f},{F:.9f}\n" for t, d, F in rows)


def converted(folder, force_N, tool, *options):
    (folder / "press.csv").write_text(table(force_N))
    words = ("convert", folder / "press.csv", folder / "out.h5", "--indenter", tool, *LAWS[tool][1], *options)
    code, said = run(*words)
    assert (folder / "out.h5").is_file()
    return code, " ".join(said.split())


@pytest.mark.parametrize("tool", LAWS)
def test_forces_a_thousand_times_too_small_are_doubted_where_the_category_is_known(tmp_path, tool):
    force_N = LAWS[tool][0] + 0.002 * NOISE
    assert converted(tmp_path, force_N, tool, "--category", "peach")[0] == 0
    code, said = converted(tmp_path, force_N / 1e3, tool, "--category", "peach")
    assert code == 4
    assert "E will be in doubt: press.csv: Found E 0.00" in said
    assert "expected 0.005 to 12 MPa for peach; check units and factors of forces" in said


def test_without_a_category_nothing_is_said_of_e_but_a_force_of_noise_is_doubted(tmp_path):
    assert converted(tmp_path, LAWS["ball"][0] / 1e3 + 2e-6 * NOISE, "ball")[0] == 0
    code, said = converted(tmp_path, 0.002 * NOISE, "ball")
    assert code == 4
    assert "E will be in doubt: press.csv: indenter trace: found a largest force of" in said


def test_inverted_forces_are_turned_with_a_note(tmp_path):
    code, said = converted(tmp_path, -LAWS["ball"][0] - 0.002 * NOISE, "ball", "--category", "peach")
    assert code == 0
    assert "note: press.csv: the force is negative under load; drupe reversed its sign." in said


def test_a_strangers_file_at_the_second_output_stops_before_the_first_is_written(tmp_path):
    press = table(LAWS["ball"][0] + 0.002 * NOISE)
    (tmp_path / "press.csv").write_text(press + "\n" + press)
    (tmp_path / "out-2.h5").write_bytes(b"a file of somebody else")
    ball = ("--indenter", "ball", "--radius-mm", "5", "--run", "all")
    code, said = run("convert", tmp_path / "press.csv", tmp_path / "out.h5", *ball)
    assert code != 0
    assert "out-2.h5" in said
    assert not (tmp_path / "out-1.h5").exists()
    assert (tmp_path / "out-2.h5").read_bytes() == b"a file of somebody else"
