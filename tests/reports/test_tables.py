import csv
import io
from dataclasses import replace

import pytest

from reports.entries import FruitEntry, ScreenEntry, Suspect
from reports.tables import ranking_csv, safe_cell

SUSPECTS = tuple(Suspect(name=name, short="", advice="") for name in ("skin", "poisson_ratio"))
FIXED_COLUMNS = (
    "rank,fruit_id,outcome,E_MPa,E_sd_MPa,maturity,maturity_probability,p_softer_than_next,"
    "height_mm,volume_mm3,grasps,shore_oo,mismatch,reason"
)


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_columns_are_the_fixed_ones_in_order_and_more_may_follow(awkward_batch, empty_batch):
    for batch in (awkward_batch, empty_batch):
        assert ranking_csv(batch).splitlines()[0].startswith(FIXED_COLUMNS)


def test_softest_is_first_and_failures_are_last(awkward_batch):
    rows = rows_of(ranking_csv(awkward_batch))
    assert [row["rank"] for row in rows] == ["1", "2", "3", "4", "", ""]
    assert [row["outcome"] for row in rows][-2:] == ["too-few-views", "never-touches"][::-1]


def test_unknown_values_are_empty_cells(awkward_batch):
    bare = rows_of(ranking_csv(awkward_batch))[2]
    assert [bare[name] for name in ("E_sd_MPa", "maturity", "height_mm", "shore_oo", "mismatch")] == [""] * 5


def test_values_survive_to_the_figures_claimed(awkward_batch, graded):
    fruit = replace(graded("a", rank=1, E_MPa=0.123456), E_sd_MPa=0.00123456)
    row = rows_of(ranking_csv(replace(awkward_batch, fruits=(fruit,))))[0]
    assert (row["E_MPa"], row["E_sd_MPa"]) == ("0.1235", "0.00123")
    assert (row["height_mm"], row["volume_mm3"], row["grasps"]) == ("57.12", "104124", "1")


def test_each_fruit_is_one_line_whatever_its_text(awkward_batch):
    text = ranking_csv(awkward_batch)
    assert len(text.splitlines()) == 7
    assert rows_of(text)[-1]["reason"] == "Only 2 photos were given, with, commas."


HOSTILE = (
    *("=1+1", "-1+cmd", "@SUM(A1)", "\t=1", "\r=1", "\n=1"),
    "lot 7;=cmd|' /C calc'!A0",
    "a,=1+1",
    'a; "=HYPERLINK(1)"',
    "a\t@SUM(A1)",
    ";+A1",
    "a,+1+cmd|' /C calc'!A0",
    "a;-1,5*(A1)",
    "a\t- 1 % + cmd",
    "a;--1",
    "a;-1:1+cmd",
    "a,-.5e3^A1",
    'a,-"x"&A1',
    "x;\u00a0-1+cmd",
    '"=1+1"',
    "\uff1d1+1",
)


def cells_by(text, separator):
    """All cells as a spreadsheet with this separator splits them, without blanks and quotes at the front."""
    table = csv.reader(io.StringIO(text), delimiter=separator)
    return {cell.lstrip('\t "\u00a0') for row in table for cell in row}


@pytest.mark.parametrize("text", HOSTILE)
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_no_separator_makes_a_formula_of_a_part_of_a_cell(text, separator, awkward_batch):
    fruit = FruitEntry(
        fruit_id=text, ok=False, outcome="x", reason=text, mismatch=text, warnings=(text, text)
    )
    batch = replace(awkward_batch, fruits=(fruit,))
    for cell in cells_by(ranking_csv(batch), separator):
        assert not cell.startswith(("=", "+", "-", "@", "\uff1d")), cell
    assert safe_cell(safe_cell(text)) == safe_cell(text)


@pytest.mark.parametrize(
    "text",
    [
        "a - b", "E is 0.4 ± 0.1, 3 - 2", "N-7; N-8", "p = 0.01", "x+y@z", "offset (0.1, -0.3) mm",
        "lot A,-7", "lot A, -7, -8 and +9", "a;-0,5;+1", "1,-2.5e-3 mm",
        "shift, -3 %", "a,-7;b", "a, -", "a\t-7",
    ],
)  # fmt: skip
def test_text_that_is_no_formula_stays_as_it_is(text):
    assert safe_cell(text) == text


def test_a_reference_body_stands_last_without_rank_or_class(empty_batch):
    """After the fruit that failed, and marked in a column of its own."""
    ball = FruitEntry(
        fruit_id="a ball", ok=True, outcome="graded", E_MPa=0.01, E_sd_MPa=0.001, reference=True
    )
    fruit = FruitEntry(fruit_id="b", ok=True, outcome="graded", E_MPa=0.5, E_sd_MPa=0.01, rank=1)
    lost = FruitEntry(fruit_id="c", ok=False, outcome="no-shape")
    rows = rows_of(ranking_csv(replace(empty_batch, fruits=(ball, lost, fruit))))
    assert [row["fruit_id"] for row in rows] == ["b", "c", "a ball"]
    assert [row["reference"] for row in rows] == ["", "", "true"]
    assert (rows[2]["outcome"], rows[2]["rank"], rows[2]["maturity"]) == ("graded", "", "")


@pytest.mark.parametrize(
    ("known", "cells"),
    [
        ({}, ("", "", "", "")),
        ({"screen": ScreenEntry(p_value=0.43)}, ("none", "screen", "none", "0.43")),
        (
            {"screen": ScreenEntry(p_value=0.012, suspects=SUSPECTS)},
            ("skin|poisson_ratio", "screen", "skin|poisson_ratio", "0.012"),
        ),
        (
            {"screen": ScreenEntry(why_not="too few")},
            ("not screened: too few", "screen", "not screened: too few", ""),
        ),
        (
            {"screen": ScreenEntry(p_value=0.43), "mismatch": "slip"},
            ("slip", "explain", "none", "0.43"),
        ),
        (
            {"screen": ScreenEntry(p_value=0.43), "mismatch": "slip", "mismatch_taken": True},
            ("slip", "settings", "none", "0.43"),
        ),
    ],
)
def test_the_mismatch_is_that_of_settings_else_explain_else_screen(known, cells, awkward_batch, graded):
    fruit = replace(graded("a", rank=1, E_MPa=0.3), **known)
    row = rows_of(ranking_csv(replace(awkward_batch, fruits=(fruit,))))[0]
    assert tuple(row[name] for name in ("mismatch", "mismatch_by", "screen", "screen_p")) == cells
