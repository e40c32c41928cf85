"""A reference ball graded with a batch of another category; its truth is CalculiX's (phantom_batches)."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from phantom_batches import BALL_MM, CORE_MM, E_MPA, ball, grasped_ball, phantom_batch
from sample_batches import drupe

# Unlike a phantom: a nectarine has a pit and its own sizes, a stem and a suture.
SETTINGS = 'category = "nectarine"\npoisson_ratio = 0.45\n[mesh]\nedge_mm = 8.0\npad_edge_mm = 2.0\n'


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """A solid ball as the reference, and one with a core as the fruit."""
    rng = np.random.default_rng(20261122)
    named = {"category": "nectarine"}
    batch = phantom_batch(
        tmp_path_factory.mktemp("reference") / "batch",
        SETTINGS,
        {
            "ball": (ball(BALL_MM), None, replace(grasped_ball(core=False, rng=rng), **named)),
            "fruit": (ball(BALL_MM), ball(CORE_MM), replace(grasped_ball(core=True, rng=rng), **named)),
        },
    )
    (batch / "fruits.csv").write_text(
        "fruit_id,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
        f"ball,true,{E_MPA},{0.01 * E_MPA},0.45\nfruit,,,,\n"
    )
    return batch, drupe("grade", batch, "--jobs", 1)


def record(batch, name):
    return json.loads((batch / "results" / "fruits" / name / "record.json").read_text())


@pytest.mark.slow
def test_the_reference_is_graded_solid_and_stands_after_the_fruit(graded):
    batch, ran = graded
    found = record(batch, "ball")
    assert found["modulus"]["E_MPa"] == pytest.approx(E_MPA, rel=0.03), ran.out
    assert found["pit"] is None
    assert found["mesh"]["stance"] is None
    assert found["warnings"] == []
    with (batch / "results" / "ranking.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert [(row["fruit_id"], row["rank"], row["reference"]) for row in rows] == [
        ("fruit", "1", ""), ("ball", "", "true")
    ]  # fmt: skip
    assert rows[1]["outcome"] == "graded"
    assert "1 of 1 fruit graded" in ran.out
