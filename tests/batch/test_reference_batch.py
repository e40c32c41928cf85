"""A reference ball graded with a batch of another category; its truth is CalculiX's (phantom_batches)."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from phantom_batches import BALL_MM, CORE_MM, E_MPA, ball, grasped_ball, phantom_batch
from sample_batches import drupe, record_of

SETTINGS = 'category = "stone.toml"\npoisson_ratio = 0.45\n[mesh]\nedge_mm = 8.0\npad_edge_mm = 2.0\n'
SETTINGS += '[flesh]\nmodel = "linear"\n'  # as the truth
CATEGORY = """
category = "stone"
given_by_batch = ["pit", "poisson_ratio"]
offset_sd_mm = { value = 0.2, source = "test" }
size_sd = { value = 0.01, source = "test" }
"""
"""Unlike a phantom's: every fruit brings a pit, and has stem and suture."""


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """A solid ball as the reference, and one with a core as the fruit."""
    rng = np.random.default_rng(20261122)
    named = {"category": "stone"}
    batch = phantom_batch(
        tmp_path_factory.mktemp("reference") / "batch",
        SETTINGS,
        {
            "ball": (ball(BALL_MM), None, replace(grasped_ball(core=False, rng=rng), **named)),
            "fruit": (ball(BALL_MM), ball(CORE_MM), replace(grasped_ball(core=True, rng=rng), **named)),
        },
    )
    (batch / "stone.toml").write_text(CATEGORY)
    (batch / "fruits.csv").write_text(
        "fruit_id,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
        f"ball,true,{E_MPA},{0.01 * E_MPA},0.45\nfruit,,,,\n"
    )
    return batch, drupe("grade", "--no-screen", batch, "--jobs", 1)


@pytest.mark.slow
def test_the_reference_is_graded_solid_and_stands_after_the_fruit(graded):
    batch, ran = graded
    body = record_of(batch / "results", "ball")
    assert body["modulus"]["E_MPa"] == pytest.approx(E_MPA, rel=0.03), ran.out
    assert body["pit"] is None
    assert body["mesh"]["stance"] is None
    assert body["warnings"] == []
    with (batch / "results" / "ranking.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert [(row["fruit_id"], row["rank"], row["reference"]) for row in rows] == [
        ("fruit", "1", ""), ("ball", "", "true")
    ]  # fmt: skip
    assert rows[1]["outcome"] == "graded"
    assert "1 of 1 fruit graded" in ran.out


@pytest.mark.slow
def test_a_gain_of_both_pads_is_found_doubted_and_corrected_without_grading_again(graded):
    """The ball is said to be softer by a fifth than it is: a gripper that reads 1.25 times too much."""
    batch, first = graded
    measured = record_of(batch / "results", "fruit")["modulus"]
    assert first.status == 0, first.out
    assert "within 2 standard deviations of 1" in first.out
    table = (batch / "fruits.csv").read_text()
    (batch / "fruits.csv").write_text(table.replace(f"true,{E_MPA}", f"true,{E_MPA / 1.25}"))
    doubted = drupe("grade", "--no-screen", batch)
    assert doubted.status == 4, doubted.out
    assert "2 of 2 fruit unchanged" in doubted.err
    assert "warning: The gripper reads 1.2" in doubted.out
    wanted = SETTINGS + "[reference]\ncorrect = true\n"
    (batch / "batch.toml").write_text(wanted)
    corrected = drupe("grade", "--no-screen", batch)
    assert corrected.status == 0, corrected.out
    assert "2 of 2 fruit unchanged" in corrected.err
    kept = record_of(batch / "results", "fruit")
    assert kept["modulus"] == measured
    with (batch / "results" / "ranking.csv").open() as file:
        row = next(csv.DictReader(file))
    assert float(row["E_MPa"]) == pytest.approx(E_MPA / 1.25, rel=0.03)
    assert float(row["E_uncorrected_MPa"]) == pytest.approx(measured["E_MPa"], rel=1e-3)
    assert kept["reference"]["E_MPa"] == pytest.approx(float(row["E_MPa"]), rel=1e-3)
    assert json.loads((batch / "results" / "batch.json").read_text())["reference"]["corrected"]
