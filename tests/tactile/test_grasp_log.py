"""The table of a raw grasp: plain numbers, and every slip named by row and column."""

import pytest

from tactile.io.decimal_number import decimal_number
from tactile.io.grasp_log import read_columns, read_log
from tactile.io.load_cell import read_trace
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
            "found 1 of 1 row (100.0%) with wild or missing values (missing aperture_mm: row 2 (nothing))",
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
