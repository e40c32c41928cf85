"""Columns that users add to fruits.csv reach every table; drupe's own keep their names."""

import csv
import io
import json
import sqlite3
from contextlib import closing
from functools import partial

import pandas as pd
import pytest
from graded_results import graded, results_of
from small_batches import batch_of_balls

import drupe as public
from pipeline.batch.fruits_table import read_fruits
from pipeline.batch.layout import Results, write_whole
from pipeline.batch.opening import survey
from pipeline.batch.records import read_record
from pipeline.batch.settings_file import read_settings
from pipeline.history.history_table import COLUMNS, MORE_COLUMNS, fruit_table
from pipeline.history.stored_batch import stored_batch
from pipeline.history.table_file import table_bytes
from pipeline.problem import BatchRefused

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
    tables = {
        "ranking.json": json_rows,
        "drupe.read": public.read(results).ranking,
    }
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


@pytest.mark.parametrize("name", [*COLUMNS, *MORE_COLUMNS])
def test_no_column_of_the_table_of_history_can_be_a_users_own(tmp_path, name):
    assert "is the name of a column of drupe" in settings_refusal(tmp_path, f'"{name}" = ""')


def test_a_note_or_column_edited_after_grading_is_in_the_next_report(drupe, batch, results):
    drupe("report", results)
    (batch / "fruits.csv").write_text(TABLE.replace("soft", "cut open").replace("12.5", "14"))
    drupe("report", results)
    page = (results / "report.html").read_text(encoding="utf-8")
    opened = page.replace("\\u003c", "<")
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
    assert '<th scope="col" class="n reading">plates_5pct_N</th>' in page
    assert '<td class="n reading" data-value="6.25">6,25 ± 0,42</td>' in page
    assert "<dt>plates_5pct_N</dt><dd>6,25 ± 0,42</dd>" in page
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
