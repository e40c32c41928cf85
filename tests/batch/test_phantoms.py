"""Cast specimens of PDMS with rigid cores and without, pressed and grasped, are graded as fruit are.

The truth is CalculiX's (phantom_batches). The paper reports means within 3.5 % of a tensile reference for
such specimens (Table I); 2 % is asked for here.
"""

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
    ran = drupe("grade", "--no-screen", batch, "--jobs", 1)
    assert ran.status == 0, ran.err
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
    ran = drupe("check", batch)
    assert ran.status == 0, ran.out
