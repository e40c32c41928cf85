"""Size against staff's own numbers: a slip of 3 % shows, a calliper's error does not."""

import pytest

from pipeline.batch.fruits_table import Given
from pipeline.batch.records import MeshRecord
from pipeline.fruit.category_doubts import size_doubts
from recon.pit.priors import load_prior

MESH = MeshRecord(
    source="photos", vertices=1, faces=1, volume_mm3=107_000.0, height_mm=56.0, box_mm=(61.0, 59.5, 56.0),
    scale_sd=0.001, surface_sd_mm=0.15,
)  # fmt: skip
PRIOR = load_prior("nectarine")


def doubts(on_mat=True, mesh=MESH, **given):
    return size_doubts(Given(**given), mesh, PRIOR, on_mat=on_mat)


def test_numbers_that_fit_raise_no_doubt():
    assert doubts() == []
    assert doubts(height_mm=56.7, diameter_mm=60.5, mass_g=109) == []
    assert doubts(height_mm=55.3, diameter_mm=61.9) == []


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"height_mm": 56.0 * 0.97}, "says height_mm 54.32"),
        ({"height_mm": 5.6}, "check the units"),
        ({"diameter_mm": 61.0 * 1.04}, "59.5 to 61.0 mm wide"),
        ({"mass_g": 60}, "the density would be 0.56 g/cm³"),
    ],
)
def test_numbers_that_do_not_fit_name_field_value_and_what_to_check(given, words):
    (doubt,) = doubts(**given)
    assert words in doubt
    assert "mat as it was printed" in doubt


def test_a_mat_of_half_the_size_shows_by_the_kind_of_fruit():
    half = MESH.model_copy(update={"box_mm": (30.5, 29.8, 28.0), "height_mm": 28.0, "volume_mm3": 13_400.0})
    (doubt,) = doubts(mesh=half)
    assert "a nectarine has 40 to 95 mm" in doubt


def test_size_from_height_alone_is_said_and_a_second_number_settles_it():
    (doubt,) = doubts(on_mat=False, height_mm=56.0)
    assert "depends on height_mm (56) alone" in doubt
    assert "[photos] coin" in doubt
    assert doubts(on_mat=False, height_mm=56.0, diameter_mm=60.0) == []
    assert size_doubts(Given(height_mm=56.0), MESH, PRIOR, on_mat=False, by_coin=True) == []
    (doubt,) = doubts(on_mat=False, height_mm=56.0, diameter_mm=57.0)
    assert "mm wide" in doubt
    assert "check the units (mm, g), the photos of this fruit, and height_mm (56)" in doubt
    assert "mat.json" not in doubt


def test_a_ready_mesh_is_held_against_the_numbers_too():
    ready = MESH.model_copy(update={"source": "fruit.ply", "scale_sd": None, "surface_sd_mm": None})
    assert doubts(on_mat=False, mesh=ready, height_mm=56.5) == []
    (doubt,) = doubts(on_mat=False, mesh=ready, height_mm=60.0)
    assert "the mesh is in mm, with z up, and of this fruit" in doubt
