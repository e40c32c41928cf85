"""fruits.csv: every fault of every row is named."""

import itertools
from pathlib import Path

import pytest

from pipeline.batch.fruits_table import SAFE_ID, read_fruits
from pipeline.problem import BatchRefused


def table(tmp_path, text):
    path = tmp_path / "fruits.csv"
    path.write_text(text)
    return path


def refusal(tmp_path, text):
    """Every fault, those of a table that is none too."""
    try:
        return "\n".join(map(str, read_fruits(table(tmp_path, text))[1]))
    except BatchRefused as refused:
        return str(refused)


def test_rows_come_back_in_order_with_empty_measures_as_none_and_ids_as_written(tmp_path):
    rows, faults = read_fruits(table(tmp_path, "fruit_id,height_mm,shore_oo\nB,61.5,\n007,,40\n"))
    assert not faults
    assert [(r.fruit_id, r.height_mm, r.shore_oo) for r in rows] == [("B", 61.5, None), ("007", None, 40.0)]


def test_the_fruit_of_a_table_with_faults_are_known_each_once(tmp_path):
    rows, faults = read_fruits(table(tmp_path, "fruit_id,height_mm\nA,tall\nB,50\n../x,50\nB,51\n"))
    assert [(row.fruit_id, row.height_mm) for row in rows] == [("A", None), ("B", 50.0)]
    assert len(faults) == 3


def test_lines_are_those_of_the_file_whatever_is_blank_or_broken_before_them(tmp_path):
    """As an editor counts them: the second A stands on line 8, behind a blank one and a note of two lines."""
    text = 'fruit_id,height_mm,notes\n\nA,55,"picked\nlate"\n  \nB,tall,x\n\nA,56,\nC,,"a\n\nb"\n../x,5,\n'
    lines = text.split("\n")
    assert (lines[5], lines[7], lines[11]) == ("B,tall,x", "A,56,", "../x,5,")
    said = refusal(tmp_path, text)
    assert 'line 6 (B): height_mm is "tall"' in said
    assert 'fruit_id "A" appears on lines 3, 8;' in said
    assert 'line 12: fruit_id "../x"' in said
    assert "line 6 has more cells" in refusal(tmp_path, text.replace("tall,x", "5,7,x"))
    semicolons = text.replace(",", ";").replace("tall", "high")
    assert 'line 6 (B): height_mm is "high"' in refusal(tmp_path, semicolons)


def test_a_row_may_end_early_and_blank_lines_may_stand_before_the_header(tmp_path):
    rows, faults = read_fruits(table(tmp_path, "\n \nfruit_id,height_mm,notes\nA\nB,50\nC,51,x,\n"))
    assert not faults
    assert [(row.fruit_id, row.height_mm, row.notes) for row in rows] == [
        ("A", None, ""), ("B", 50.0, ""), ("C", 51.0, "x")
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("cell", "said"),
    [
        (
            '"60,5"',
            '"60,5"; expected a number above zero, or an empty cell; it has a decimal comma; write 60.5.',
        ),
        ("6_0", '"6_0"; expected a number above zero, or an empty cell; write 60.'),
        ("\u0666\u0660", "cell; write 60."),  # Arabic digits
        ("\uff16\uff10.\uff15", "cell; write 60.5."),  # full-width digits
        ("6\u00a00", "cell; write 60."),
        ("0x3c", "or an empty cell."),
        *((cell, f'height_mm is "{cell}"') for cell in ("-3", "0", "tall", "nan", "inf")),
    ],
)
def test_numbers_are_plain_and_others_are_told_how_to_be_written(tmp_path, cell, said):
    assert said in refusal(tmp_path, f"fruit_id,height_mm\nA,{cell}\n")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("height_mm\n60\n", 'the column "fruit_id" is missing'),
        ("fruit_id,hight\nA,60\n", 'unknown column "hight"'),
        (
            "fruit_id,hight_mm\nA,60\n",
            'unknown column "hight_mm"; if you mean it, write height_mm with its values in mm.',
        ),
        ("fruit_id,height (cm)\nA,6\n", "write height_mm with its values in mm."),
        ("fruit_id,penetrometer_lbf\nA,6\n", "write penetrometer_N with its values in N."),
        ("fruit_id,mass_kg\nA,0.1\n", "write mass_g with its values in g."),
        ("Fruit_ID,height_mm\nA,60\n", 'unknown column "Fruit_ID"; write fruit_id.'),
        ("fruit id,height_mm\nA,60\n", 'unknown column "fruit id"; write fruit_id.'),
        ("fruit_id,Reference_e_MPa\nA,60\n", 'unknown column "Reference_e_MPa"; write reference_E_MPa.'),
        ("fruit_id,height_mm,height_mm\nA,60,61\n", 'has the column "height_mm" twice; remove one of them'),
        ('fruit_id,notes\nA,x\nB,"y\nC,z\n', "line 3 has an open quotation mark"),
        ("fruit_id,notes\nA,x\nB," + "y" * 11_000 + "\n", "line 3 has a cell of more than 10000 characters"),
        ("fruit_id,notes\nB," + "y" * 140_000 + "\n", "line 2 has a cell of more than 10000 characters"),
        ("fruit_id\n", "lists no fruit"),
        ("fruit_id,height_mm,mass_g\nA,57,8,120\n", "write numbers with a decimal point (57.6 for 57,6)."),
        ("fruit_id,notes\nA,late,hard\n", "put texts that contain commas in quotation marks"),
    ],
)
def test_a_broken_table_is_said(tmp_path, text, says):
    assert says in refusal(tmp_path, text)


def test_a_table_of_very_many_columns_is_refused_before_it_is_parsed(tmp_path):
    columns = ",".join(f"c{k}" for k in range(400_000))
    said = refusal(tmp_path, f"fruit_id,{columns}\nN1\n")
    assert "400001 columns" in said
    assert "at most 200" in said


def test_missing_table_is_said(tmp_path):
    with pytest.raises(BatchRefused, match=r"fruits\.csv: is missing"):
        read_fruits(tmp_path / "fruits.csv")


def test_the_reference_body_of_the_documentation_is_read_as_it_says(tmp_path):
    said = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()
    (tmp_path / "fruits.csv").write_text(next(t for t in said.split("```\n") if "ball-1,50" in t))
    rows, problems = read_fruits(tmp_path / "fruits.csv")
    assert not problems
    fruit, ball = rows
    assert (fruit.reference, ball.reference) == (False, True)
    assert (ball.fruit_id, ball.height_mm, ball.reference_E_MPa, ball.reference_E_sd_MPa) == (
        "ball-1", 50.0, 0.62, 0.03,
    )  # fmt: skip
    assert ball.reference_poisson_ratio == 0.48


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize(("mark", "end"), [("", "\n"), ("\ufeff", "\n"), ("", "\r"), ("\ufeff", "\r\n")])
def test_tables_of_other_countries_and_spreadsheets_are_read(tmp_path, separator, mark, end):
    height = "57.8" if separator == "," else "57,8"
    rows = [["fruit_id", "height_mm", "notes"], ["A", height, '"late, 3,4 days"'], ["B", "61.5", ""]]
    (tmp_path / "fruits.csv").write_bytes((mark + end.join(map(separator.join, rows)) + end).encode())
    records, faults = read_fruits(tmp_path / "fruits.csv")
    assert faults == []
    assert [(row.fruit_id, row.height_mm) for row in records] == [("A", 57.8), ("B", 61.5)]
    assert records[0].notes == "late, 3,4 days"


@pytest.mark.parametrize(("separator", "other"), [*itertools.permutations(",;\t", 2)])
def test_the_most_frequent_separator_of_the_header_separates(tmp_path, separator, other):
    header = separator.join(["fruit_id", "height_mm", "mass_g", f'"cheek{other} 1"'])
    rows, faults = read_fruits(table(tmp_path, f"{header}\n{separator.join(['A', '57.8', '90', '1'])}\n"))
    assert [(row.fruit_id, row.height_mm, row.mass_g) for row in rows] == [("A", 57.8, 90.0)]
    (fault,) = faults
    assert 'unknown column "cheek' in str(fault)


def test_letters_of_any_script_are_ids_and_are_composed(tmp_path):
    rows, faults = read_fruits(table(tmp_path, "fruit_id\nMu\u0308hle-1\nÑandú 2\n桃3\n"))
    assert faults == []
    assert [row.fruit_id for row in rows] == ["Mühle-1", "Ñandú 2", "桃3"]


@pytest.mark.parametrize(
    "name", ["", "../A", ".A", "-A", "A/B", "A\u202eB", "_A", "A\u200bB", "A" * 81, "A\nB"]
)
def test_what_is_no_name_of_a_folder_is_no_id(tmp_path, name):
    assert not SAFE_ID.fullmatch(name)
    assert "cannot name a folder" in refusal(tmp_path, f'fruit_id,notes\n"{name}",x\n')


@pytest.mark.parametrize(
    "text",
    [
        "sep=;\nfruit_id;height_mm;mass_g\nA;55,9;\nB;57.6;110\n",
        '"sep=,"\r\nfruit_id,height_mm,mass_g\r\nA,55.9,\r\nB,57.6,110\r\n',
        "sep=\t\nfruit_id\theight_mm\tmass_g\nA\t55,9\t\nB\t57,6\t110\n",
        "fruit_id,height_mm,mass_g,,\nA,55.9,,,\n,,,,\nB,57.6,110,,\n,,,,\n,,,,,,,\n",
        "fruit_id;height_mm;mass_g;;\n;;;;\nA;55,9;;;\nB;57,6;110;;\n;;;;\n",
        "fruit_id,height_mm,mass_g" + "," * 300 + "\nA,55.9\nB,57.6,110" + "," * 300 + "\n",
    ],
)
def test_a_line_on_the_separator_and_empty_columns_and_rows_are_passed_over(tmp_path, text):
    rows, faults = read_fruits(table(tmp_path, text))
    assert not faults
    assert [(r.fruit_id, r.height_mm, r.mass_g) for r in rows] == [("A", 55.9, None), ("B", 57.6, 110.0)]


def test_lines_keep_their_numbers_below_a_line_on_the_separator_and_a_cell_without_a_name_is_named(tmp_path):
    assert "line 3 (A): height_mm" in refusal(tmp_path, "sep=;\nfruit_id;height_mm\nA;wide\n")
    assert "line 2 has more cells than the header" in refusal(tmp_path, "fruit_id,height_mm,\nA,60,7\n")
