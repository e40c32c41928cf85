"""The shipped batches, the sample generator and the mat, through the command as a user runs it.

The larger shipped batch is graded from its photos before a change lands, and its moduli held against its
answers (benchmarks/sample_answers.py); the tiny one is a proof.
"""

import json
import re

import cv2
import pandas as pd
import pytest
from sample_batches import drupe, drupe_alone

from pipeline.batch.opening import read_mat


@pytest.fixture(scope="module")
def two_fruits(tmp_path_factory):
    """The tiny shipped batch, copied with `drupe sample` and graded without the screen."""
    folder = tmp_path_factory.mktemp("two") / "batch"
    sampled = drupe_alone("sample", folder, "--name", "two-fruits")
    assert sampled.status == 0, sampled.err
    return folder, drupe("grade", "--no-screen", folder)


@pytest.mark.proof
def test_the_tiny_batch_ends_with_status_three_and_grades_the_fruit_that_can_be(two_fruits):
    folder, graded = two_fruits
    assert graded.status == 3, graded.err
    ranking = pd.read_csv(folder / "results" / "ranking.csv", dtype={"fruit_id": str})
    answers = json.loads((folder / "answers.json").read_text())["fruits"]
    assert ranking["outcome"].tolist() == ["graded", "too-few-views"]
    first = ranking.iloc[0]
    assert first["E_MPa"] == pytest.approx(answers[first["fruit_id"]]["E_MPa"], rel=0.08)
    assert "2" in ranking.iloc[1]["reason"]
    assert ranking.iloc[1]["fruit_id"] in graded.out


@pytest.mark.proof
def test_the_report_needs_no_network(two_fruits):
    folder, _ = two_fruits
    page = (folder / "results" / "report.html").read_text()
    assert not re.search(r"""(?:src|href|action)\s*=\s*["']?\s*(?:https?:)?//""", page)
    assert "url(" not in page.replace("url(data:", "")


@pytest.mark.proof
def test_the_meshes_are_written_beside_the_record(two_fruits):
    folder, _ = two_fruits
    graded = folder / "results" / "fruits" / pd.read_csv(folder / "results" / "ranking.csv")["fruit_id"][0]
    assert {"fruit.ply", "pit.ply", "record.json"} <= {p.name for p in graded.iterdir()}


def test_sample_refuses_an_unknown_name(tmp_path):
    ran = drupe("sample", tmp_path / "new", "--name", "durians", status=2)
    assert "nectarines" in ran.one_line_error()


@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_the_mat_is_written_as_pdf_with_a_mat_json_that_grade_reads(tmp_path, paper):
    drupe("mat", tmp_path / "mat", "--paper", paper, status=0)
    assert (tmp_path / "mat" / "mat.pdf").read_bytes().startswith(b"%PDF")
    mat = read_mat(tmp_path / "mat" / "mat.json")
    assert len(mat.corners_mm) == 40
    assert hasattr(cv2.aruco, f"DICT_{mat.dictionary}")


def test_the_small_mat_for_cherries_has_smaller_tags(tmp_path):
    assert drupe("mat", tmp_path, "--cherry").status == 0
    assert read_mat(tmp_path / "mat.json").tag_mm == pytest.approx(9.0)
