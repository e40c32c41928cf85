"""fruits.csv: every fault of every row is named; columns that users add reach every table."""

import csv
import io
import itertools
import json
import sqlite3
from contextlib import closing
from functools import partial
from pathlib import Path
from unicodedata import normalize

import pandas as pd
import pytest
from graded_results import graded, results_of
from small_batches import batch_of_balls

import drupe as public
from fem.firmness.trade_tests import trade_tests
from pipeline.batch.fruits_table import SAFE_ID, read_fruits
from pipeline.batch.layout import Results, write_whole
from pipeline.batch.opening import survey
from pipeline.batch.records import read_record
from pipeline.batch.settings_file import read_settings
from pipeline.history.history_table import COLUMNS, MORE_COLUMNS, fruit_table
from pipeline.history.stored_batch import stored_batch
from pipeline.history.table_file import table_bytes
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


SETTINGS = 'category = "nectarine"\n[columns]\nBrix = "°Brix"\ngrower = ""\n'
TABLE = "fruit_id,Brix,grower,notes\nA,12.5,=Huber,soft\nB,,Mayr,\n"


@pytest.fixture
def batch(tmp_path):
    return batch_of_balls(tmp_path / "batch", "A", "B", table=TABLE, settings=SETTINGS)


@pytest.fixture
def results(batch):
    return results_of(batch / "results", [graded("A", 0.3), graded("B", 0.8)])


def said_of(tmp_path, table, units):
    path = tmp_path / "fruits.csv"
    path.write_text(table)
    return "\n".join(map(str, read_fruits(path, units=units)[1]))


def settings_refusal(tmp_path, columns):
    path = tmp_path / "batch.toml"
    path.write_text(f'category = "nectarine"\n[columns]\n{columns}\n')
    with pytest.raises(BatchRefused) as refusal:
        read_settings(path)
    return str(refusal.value)


def test_every_table_holds_what_pandas_reads_from_the_users_own(drupe, batch, results, tmp_path):
    assert drupe("report", results).status == 0
    written = pd.read_csv(batch / "fruits.csv").set_index("fruit_id")[["Brix", "grower"]]
    json_rows = pd.DataFrame(json.loads((results / "ranking.json").read_text()))
    tables = {"ranking.json": json_rows, "drupe.read": public.read(results).ranking}
    for name, table in tables.items():
        assert list(table.columns[-2:]) == ["Brix", "grower"], name
        columns = table.set_index("fruit_id")[["Brix", "grower"]].astype(object)
        assert columns.fillna("empty").to_dict() == written.astype(object).fillna("empty").to_dict(), name
    cells = {
        row["fruit_id"]: row
        for row in csv.DictReader((results / "ranking.csv").read_text("utf-8").splitlines())
    }
    assert (cells["A"]["Brix"], cells["A"]["grower"], cells["B"]["Brix"]) == ("12.5", "'=Huber", "")
    record = read_record(results / "fruits" / "A" / "record.json")
    assert record.given.columns == {"Brix": 12.5, "grower": "=Huber"}
    rows = csv.DictReader(io.StringIO(table_bytes(fruit_table([stored_batch(results)]), ".csv").decode()))
    assert [(row["Brix"], row["grower"]) for row in rows] == [("12.5", "'=Huber"), ("", "Mayr")]
    page = (results / "report.html").read_text(encoding="utf-8")
    assert '<th scope="col" class="n">Brix (°Brix)</th><th scope="col">grower</th>' in page
    assert '<td class="n" data-value="12.5">12.5</td><td>=Huber</td>' in page


def test_the_store_holds_users_columns_through_revisions_and_exports_them(drupe, batch, results, tmp_path):
    written = pd.read_csv(batch / "fruits.csv").set_index("fruit_id")[["Brix", "grower"]]
    exports = {
        ".csv": pd.read_csv,
        ".xlsx": partial(pd.read_excel, engine="openpyxl"),
        ".parquet": pd.read_parquet,
        ".json": pd.read_json,
    }
    store = tmp_path / "s"
    drupe("report", results)
    for ending, read in exports.items():
        assert drupe("history", results, "--store", store, "--export", tmp_path / f"t{ending}").status == 0
        table = read(tmp_path / f"t{ending}")
        assert list(table.columns[-2:]) == ["Brix", "grower"], ending
        cells = table.set_index("fruit_id")[["Brix", "grower"]].astype(object)
        safe = {".csv", ".xlsx"} & {ending}
        expected = written.replace("=Huber", "'=Huber") if safe else written
        assert cells.fillna("empty").to_dict() == expected.astype(object).fillna("empty").to_dict(), ending
    (batch / "fruits.csv").write_text(TABLE.replace("12.5", "14"))
    drupe("report", results)
    assert drupe("history", results, "--store", store).status == 0
    with closing(sqlite3.connect(store)) as connection:
        rows = connection.execute(
            "SELECT fruit_id, revision, json_extract(columns, '$.Brix'), json_extract(columns, '$.grower') "
            "FROM fruit JOIN result ON result.id = fruit.result ORDER BY fruit_id, revision"
        ).fetchall()
    assert rows[:2] == [("A", 0, 12.5, "=Huber"), ("A", 1, 14.0, "=Huber")]
    assert rows[2:] == [("B", 0, None, "Mayr"), ("B", 1, None, "Mayr")]


READINGS = [test.name for test in trade_tests()]


@pytest.mark.parametrize(
    "name",
    [
        *COLUMNS, *MORE_COLUMNS, *READINGS, *(f"{name}_sd" for name in READINGS),
        "firmness_8mm_N_low", "firmness_11.1mm_N_predicted",
    ],
)  # fmt: skip
def test_no_column_of_the_table_of_history_can_be_a_users_own(tmp_path, name):
    assert "is the name of a column of drupe" in settings_refusal(tmp_path, f'"{name}" = ""')


@pytest.mark.parametrize(
    "name", ["plates_2", "ball_1", "chord_3", "s368_b", "firmness_8mm", "plates_2pct_N_se"]
)
def test_a_name_that_drupe_firmness_never_gives_can_be_a_users_own(tmp_path, name):
    (tmp_path / "batch.toml").write_text(f'category = "plum"\n[columns]\n{name} = "mm"\n')
    assert read_settings(tmp_path / "batch.toml").columns == {name: "mm"}


@pytest.mark.parametrize("ending", ["", "_sd"])
def test_no_column_of_a_test_with_other_forces_can_be_a_users_own(tmp_path, ending):
    for test in trade_tests(chord_gf=(100.0, 250.5), ball_N=0.75):
        assert "is the name of a column of drupe" in settings_refusal(tmp_path, f'"{test.name}{ending}" = ""')


def test_a_name_with_separate_accents_is_the_same_name(tmp_path):
    """As macOS writes names of files; Python's own normalisation makes them."""
    (tmp_path / "batch.toml").write_text(
        normalize("NFD", 'category = "plum"\nlot = "Süd"\n[columns]\n"Größe" = "mm"\n'), encoding="utf-8"
    )
    settings = read_settings(tmp_path / "batch.toml")
    assert settings.lot == "S\u00fcd"
    path = table(tmp_path, "fruit_id,Gr\u00f6\u00dfe\nA,61\n")
    rows, problems = read_fruits(path, units=settings.columns)
    assert problems == []
    assert rows[0].columns == {"Gr\u00f6\u00dfe": 61.0}


def test_a_note_or_column_edited_after_grading_is_in_the_next_report(drupe, batch, results):
    drupe("report", results)
    (batch / "fruits.csv").write_text(TABLE.replace("soft", "cut open").replace("12.5", "14"))
    drupe("report", results)
    opened = (results / "report.html").read_text(encoding="utf-8").replace("\\u003c", "<")
    assert "<dt>Notes</dt><dd>cut open</dd>" in opened
    assert "<dt>Brix</dt><dd>14 °Brix</dd>" in opened
    assert read_record(results / "fruits" / "A" / "record.json").given.columns["Brix"] == 14


def test_a_misspelt_column_is_named_and_an_unlisted_one_is_told_how_to_be_listed(tmp_path):
    units = {"Brix": "°Brix", "grower": ""}
    said = said_of(tmp_path, "fruit_id,hight_mm,Brx,colour\nA,60,12,red\n", units)
    assert 'unknown column "hight_mm"; if you mean it, write height_mm with its values in mm.' in said
    assert 'unknown column "Brx"; if you mean it, write Brix.' in said
    assert 'write "colour" = "" under [columns] in batch.toml' in said
    assert 'unknown column "GROWER"; write grower.' in said_of(tmp_path, "fruit_id,GROWER\nA,x\n", units)


def test_a_column_with_a_unit_holds_numbers_and_one_without_keeps_leading_zeros(tmp_path):
    said = said_of(tmp_path, "fruit_id,Brix,box\nA,12x,007\n", {"Brix": "°Brix", "box": ""})
    assert 'line 2 (A): Brix is "12x"; expected a number, because [columns] in batch.toml' in said
    rows, _ = read_fruits(tmp_path / "fruits.csv", units={"Brix": "", "box": ""})
    assert rows[0].columns == {"Brix": "12x", "box": "007"}


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ('height_mm = ""', '"height_mm" is the name of a column of drupe (height_mm)'),
        ('"E MPa" = "MPa"', '"E MPa" is the name of a column of drupe (E_MPa)'),
        ('lot = ""', '"lot" is the name of a column of drupe (lot)'),
        ('"=cmd" = ""', '"=cmd" cannot name a column; start with a letter or digit'),
        ('Brix = ""\nbrix = ""', "names must differ by more than capitals and spaces"),
        ("Brix = 3", '"columns.Brix": found 3; expected a text in quotes'),
    ],
)
def test_a_name_that_is_drupes_or_none_is_refused(tmp_path, columns, says):
    assert says in settings_refusal(tmp_path, columns)


def test_a_fault_elsewhere_in_the_settings_does_not_make_the_users_columns_unknown(tmp_path):
    root = batch_of_balls(tmp_path / "b", "A", table=TABLE[:37], settings="lots = 1\n" + SETTINGS)
    said = "\n".join(map(str, survey(root).problems))
    assert 'unknown key "lots"' in said
    assert "unknown column" not in said


FIRMNESS = (
    "fruit_id,E_MPa,E_sd_MPa,plates_5pct_N,plates_5pct_N_sd,E_MPa_at_10_plates_5pct_N,reason\n"
    "A,0.3,0.015,6.25,0.42,0.48,\n"
    "B,0.5,0.025,9.5,0.61,0.52,\n"
)


def test_readings_of_firmness_are_columns_until_another_E_is_graded(drupe, batch, results, tmp_path):
    """The readings of B were made at E = 0.5 MPa, and its E is now 0.8 MPa."""
    write_whole(Results(results).firmness, FIRMNESS)
    assert drupe("report", results, "--lang", "de").status == 0
    of_tests = ["plates_5pct_N", "plates_5pct_N_sd"]
    table = public.read(results).ranking.set_index("fruit_id")
    assert list(table.columns[-4:]) == [*of_tests, "Brix", "grower"]
    assert table.loc["A", of_tests].tolist() == [6.25, 0.42]
    assert table.loc["B", of_tests].isna().all()
    page = (results / "report.html").read_text(encoding="utf-8").replace("\\u003c", "<")
    title = "Platten, 5\u00a0% des Durchmessers (N)"
    assert f'<th scope="col" class="n reading">{title}</th>' in page
    assert '<td class="n reading" data-value="6.25">6,25 ± 0,42</td>' in page
    assert f"<dt>{title}</dt><dd>6,25 ± 0,42</dd>" in page
    assert "Simulierte Festigkeitsprüfungen" in page
    store, export = tmp_path / "s", tmp_path / "t.csv"
    assert drupe("history", results, "--store", store).status == 0
    assert drupe("history", "--store", store, "--export", export).status == 0
    assert pd.read_csv(export).set_index("fruit_id").loc["A", of_tests].tolist() == [6.25, 0.42]
    Results(results).firmness.write_text(FIRMNESS.replace("6.25", "7"))
    assert "plates_5pct_N" not in stored_batch(results).fruit[0].columns


def test_settings_that_are_no_toml_do_not_make_the_users_columns_unknown(batch):
    (batch / "batch.toml").write_text(SETTINGS + "grower = \n")
    (problem,) = survey(batch).problems
    assert "batch.toml" in str(problem)
    (batch / "fruits.csv").write_text(TABLE.replace("notes", "Height mm"))
    assert 'unknown column "Height mm"; write height_mm.' in "\n".join(map(str, survey(batch).problems))
