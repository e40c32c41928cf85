"""Cast specimens of PDMS with rigid cores and without, and a reference ball, are graded as fruit are.

The truth is CalculiX's (phantom_batches). The paper reports means within 3.5 % of a tensile reference for
such specimens (Table I); 2 % is asked for here.
"""

import csv
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import trimesh
from phantom_batches import (
    BALL_MM,
    CORE_MM,
    CUBE_CORE_MM,
    CUBE_MM,
    E_MPA,
    HEADER,
    ball,
    box,
    glued_pads,
    grasped_ball,
    phantom_batch,
)  # fmt: skip
from sample_batches import drupe, record_of

from recon.surface.mesh_file import read_mesh


def cube(rng):
    return box(*3 * [CUBE_MM], edge_mm=3.0), box(*3 * [CUBE_CORE_MM]), glued_pads("press-100mm2", rng=rng)


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """Balls with and without a core and a cuboid in a grasp, a cube under a press."""
    rng = np.random.default_rng(20261121)
    batch = phantom_batch(
        tmp_path_factory.mktemp("phantoms") / "batch",
        HEADER + '[pit]\nprior = "none"\n[sensor]\nname = "marker gel"\npicture_scale_sd = 0.01\n',
        {
            "ball": (ball(BALL_MM), ball(CORE_MM), grasped_ball(core=True, rng=rng)),
            "cube": cube(rng),
            "cuboid": (box(40.0, 30.0, 30.0, edge_mm=3.0), ball(10.0), glued_pads("grasp", rng=rng)),
            "solid": (ball(BALL_MM), None, grasped_ball(core=False, rng=rng)),
        },
    )
    ran = drupe("grade", "--no-screen", batch, "--jobs", 1, status=0)
    return batch / "results", ran


@pytest.mark.proof
@pytest.mark.parametrize("name", ["ball", "cube", "cuboid", "solid"])
def test_the_modulus_is_within_two_percent_and_within_its_error_bar(graded, name):
    modulus = record_of(graded[0], name)["modulus"]
    assert modulus["E_MPa"] == pytest.approx(E_MPA, rel=0.02)
    assert abs(modulus["E_MPa"] - E_MPA) < 3 * modulus["E_sd_MPa"]
    assert modulus["E_sd_MPa"] < 0.05 * E_MPA


@pytest.mark.proof
@pytest.mark.parametrize("name", ["ball", "cube", "cuboid", "solid"])
def test_nothing_of_a_fruit_is_missed_in_a_phantom(graded, name):
    """No stem, no suture, no doubt about shape or size, and Poisson's ratio as the batch says."""
    record = record_of(graded[0], name)
    assert record["warnings"] == []
    assert record["mesh"]["stance"] is None
    assert (record["flesh"]["poisson_ratio"], record["flesh"]["poisson_ratio_source"]) == (0.45, "batch.toml")


@pytest.mark.proof
def test_a_specimen_without_a_core_has_none_in_its_results(graded):
    results, _ = graded
    assert record_of(results, "solid")["pit"] is None
    assert not (results / "fruits" / "solid" / "pit.ply").exists()
    assert record_of(results, "cube")["pit"]["volume_mm3"] == pytest.approx(CUBE_CORE_MM**3, rel=1e-6)
    assert "pit size" not in record_of(results, "solid")["modulus"]["parts_sd_MPa"]


@pytest.mark.proof
def test_soft_bodies_are_printed_with_digits_enough(graded):
    results, ran = graded
    table = pd.read_csv(results / "ranking.csv").set_index("fruit_id")
    assert f"{table.E_MPa['ball']:.4f}" in ran.out
    assert "± 0.000 MPa" not in ran.out + ran.err + (results / "report.html").read_text()


@pytest.fixture
def one_cube(tmp_path):
    """A batch of one cube without a core, its recording a press; the settings are the test's own."""

    def make(settings):
        skin, _, recording = cube(np.random.default_rng(1))
        return phantom_batch(tmp_path / "batch", settings, {"cube": (skin, None, recording)})

    return make


@pytest.mark.parametrize("prior", ["core.stl", "none"])
def test_check_finds_a_measured_core_for_all_and_none_at_all_in_order(one_cube, prior):
    batch = one_cube(HEADER + f'[pit]\nprior = "{prior}"\n')
    if prior == "core.stl":
        trimesh.creation.box(3 * [CUBE_CORE_MM]).export(batch / prior)
        assert read_mesh(batch / prior)[1].shape == (12, 3)
    drupe("check", batch, status=0)


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
def reference_graded(tmp_path_factory):
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
def test_the_reference_is_graded_solid_and_stands_after_the_fruit(reference_graded):
    batch, ran = reference_graded
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
def test_a_gain_of_both_pads_is_found_doubted_and_corrected_without_grading_again(reference_graded):
    """The ball is said to be softer by a fifth than it is: a gripper that reads 1.25 times too much."""
    batch, first = reference_graded
    measured = record_of(batch / "results", "fruit")["modulus"]
    assert first.status == 0, first.out
    assert "within 2 standard deviations of 1" in first.out
    table = (batch / "fruits.csv").read_text()
    (batch / "fruits.csv").write_text(table.replace(f"true,{E_MPA}", f"true,{E_MPA / 1.25}"))
    doubted = drupe("grade", "--no-screen", batch, status=4)
    assert "2 of 2 fruit unchanged" in doubted.err
    assert "warning: The gripper reads 1.2" in doubted.out
    wanted = SETTINGS + "[reference]\ncorrect = true\n"
    (batch / "batch.toml").write_text(wanted)
    assert "2 of 2 fruit unchanged" in drupe("grade", "--no-screen", batch, status=0).err
    kept = record_of(batch / "results", "fruit")
    assert kept["modulus"] == measured
    with (batch / "results" / "ranking.csv").open() as file:
        row = next(csv.DictReader(file))
    assert float(row["E_MPa"]) == pytest.approx(E_MPA / 1.25, rel=0.03)
    assert float(row["E_uncorrected_MPa"]) == pytest.approx(measured["E_MPa"], rel=1e-3)
    assert kept["reference"]["E_MPa"] == pytest.approx(float(row["E_MPa"]), rel=1e-3)
    assert json.loads((batch / "results" / "batch.json").read_text())["reference"]["corrected"]
