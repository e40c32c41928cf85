"""A number that no fruit has is said with the slip that it likely is; real fruit pass."""

import numpy as np
import pytest
from small_batches import batch_of_balls, write_ball

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.opening import open_batch, survey
from pipeline.batch.plausible_numbers import (
    grading_doubts,
    kind_of,
    mesh_doubt,
    row_doubts,
    table_doubts,
)
from pipeline.batch.settings import Grading, GradingClass
from pipeline.problem import BatchRefused
from pipeline.run.checking import check, implausible
from recon.pit.priors import load_prior
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import write_mesh

NECTARINE = kind_of(load_prior("nectarine"))
SOUND = {"height_mm": 55.3, "diameter_mm": 61.5, "mass_g": 112.0, "shore_oo": 69.0}


def doubts(kind=NECTARINE, **changed):
    return list(row_doubts(FruitRow(fruit_id="A", **{**SOUND, **changed}), kind))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"height_mm": 5.53}, "height_mm 5.53: a nectarine is 25 to 105 mm high; is it in cm (55.3 mm)?"),
        ({"height_mm": 2.16}, "is it in inches (54.86 mm)?"),
        ({"height_mm": 0.0553}, "is it in m (55.3 mm)?"),
        ({"height_mm": 553}, "is its decimal point missing (55.3 mm)?"),
        ({"height_mm": 1e300}, "height_mm 1e+300: a nectarine is 25 to 105 mm high; correct it."),
        ({"diameter_mm": 6.15}, "diameter_mm 6.15: a nectarine is 35 to 115 mm wide; is it in cm (61.5 mm)?"),
        ({"mass_g": 0.112}, "mass_g 0.112: a nectarine is 18 to 650 g in mass; is it in kg (112 g)?"),
        ({"mass_g": 3.95}, "is it in ounces (112 g)?"),
        ({"shore_oo": 580}, "is its decimal point missing (58)?"),
        ({"shore_oo": 0.58}, "is it a share of 1 (58)?"),
        ({"mass_g": 20.0}, "together they give a density of 0.18 g per cm3, but a nectarine has 0.55 to 1.8"),
        ({"diameter_mm": 112, "mass_g": 61.5}, "Check whether two are swapped"),
    ],
)
def test_the_likely_slip_is_named(changed, said):
    (sentence,) = doubts(**changed)
    assert said in sentence


@pytest.mark.parametrize("category", ["nectarine", "peach", "plum", "apricot", "cherry", "phantom"])
def test_fruit_of_every_size_and_shape_of_their_kind_pass(category):
    kind = kind_of(load_prior(category))
    rng = np.random.default_rng(1)
    for _ in range(300):
        # Sizes of the category's own fruit_mm, shapes to 1.45, densities of flesh: not of the ranges tested.
        size = rng.uniform(*load_prior(category).fruit_mm)
        ratio = rng.uniform(1 / 1.45, 1.45)
        height, wide = size * ratio ** (2 / 3), size * ratio ** (-1 / 3)
        mass = np.pi / 6000 * height * wide**2 * rng.uniform(0.9, 1.25)
        fair = all(
            low <= v <= high
            for v, (low, high) in ((height, kind.ranges.height_mm), (wide, kind.ranges.diameter_mm))
        )
        if fair:
            said = doubts(kind, height_mm=height, diameter_mm=wide, mass_g=mass)
            assert said == []


def test_a_whole_column_in_cm_is_one_sentence_and_not_one_for_each_fruit():
    rows = tuple(FruitRow(fruit_id=str(i), height_mm=5.5 + 0.1 * i, mass_g=110.0) for i in range(5))
    (said,) = table_doubts(rows, NECTARINE).values()
    assert said.startswith("height_mm of all 5 fruit is 5.5 to 5.9; a nectarine is 25 to 105 mm high")
    assert "is it in cm (57 mm)?" in said
    assert list(row_doubts(rows[0], NECTARINE, said={"height_mm"})) == []


def test_limits_in_kilopascal_are_said():
    classes = (GradingClass(name="soft", E_max_MPa=300), GradingClass(name="firm"))
    (said,) = grading_doubts(Grading(classes=classes), NECTARINE)
    assert 'E_max_MPa of "soft" is 300' in said
    assert "is it in kPa (0.3 MPa)?" in said
    fine = (GradingClass(name="soft", E_max_MPa=0.3), GradingClass(name="firm"))
    assert list(grading_doubts(Grading(classes=fine), NECTARINE)) == []


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (
            0.001,
            "the mesh measures 0.061 x 0.059 x 0.055 mm; a nectarine is 25 to 115 mm in size; is it in m "
            "(61 mm)?",
        ),
        (0.1, "is it in cm"),
        (1 / 25.4, "is it in inches"),
        (1000, "is it in µm"),
    ],
)
def test_a_mesh_in_another_unit_is_said(factor, said):
    box = np.array([61.0, 59.0, 55.0]) * factor
    assert said in mesh_doubt(box, NECTARINE)
    assert mesh_doubt(box / factor, NECTARINE) == ""
    assert mesh_doubt(box, kind_of(None)) == ""


@pytest.fixture
def batch(tmp_path):
    table = "fruit_id,height_mm,mass_g\nA,55.9,90\nB,55.9,90\n"
    return batch_of_balls(tmp_path, "A", "B", table=table)


def said(root):
    return "\n".join(str(p).replace(f"{root}/", "") for p in check(root))


def test_one_fruit_costs_itself_and_a_column_costs_the_batch_unless_forced(batch):
    (batch / "fruits.csv").write_text("fruit_id,height_mm,mass_g\nA,5.59,90\nB,55.9,90\n")
    opened = open_batch(batch)
    assert [bool(implausible(opened, row)) for row in opened.rows] == [True, False]
    (batch / "fruits.csv").write_text("fruit_id,height_mm,mass_g\nA,5.59,90\nB,5.59,90\n")
    with pytest.raises(BatchRefused, match="height_mm of all 2 fruit is 5"):
        open_batch(batch)
    assert open_batch(batch, force=True).rows[0].height_mm == 5.59


def test_a_mesh_in_metres_is_the_first_and_only_thing_said_of_it(batch):
    write_ball(batch / "fruits" / "A" / "fruit.ply", radius_mm=0.028)
    lines = [line for line in said(batch).splitlines() if "A/fruit.ply" in line]
    (line,) = lines
    assert "is it in m (" in line
    assert "flesh" not in line


def test_category_table_and_numbers_are_said_in_one_go(batch):
    (batch / "batch.toml").write_text(
        'category = "nectarine"\npulp_temperature_C = 68\n[[grading.classes]]\nname = "soft"\n'
        'E_max_MPa = 300\n[[grading.classes]]\nname = "firm"\n'
    )
    (batch / "fruits.csv").write_text("fruit_id;height_mm;mass_g\nA;5,59;90\nB;55,9;90\n")
    (batch / "fruits" / "B" / "fruit.ply").write_bytes(b"no mesh")
    text = said(batch)
    for words in (
        "is it in Fahrenheit (20.0 C)?",
        "is it in kPa (0.3 MPa)?",
        "A: height_mm 5.59: a nectarine is 25 to 105 mm high; is it in cm",
        "B/fruit.ply is broken",
    ):
        assert words in text


def test_two_bodies_are_no_fruit(batch):
    directions, faces = ball(3)
    two = np.concatenate([28 * directions, 28 * directions + [80, 0, 0]])
    write_mesh(batch / "fruits" / "A" / "fruit.ply", two, np.concatenate([faces, faces + len(directions)]))
    assert "2 separate surfaces; expected one closed surface" in said(batch)


def test_numbers_are_never_said_twice(batch):
    (batch / "fruits.csv").write_text("fruit_id,height_mm,mass_g\nA,5.59,90\nB,55.9,90\n")
    assert said(batch).count("5.59") == 1
    assert survey(batch).problems == ()
