"""A reference body of known modulus stands in the table of the fruit and under rules of its own."""

import pytest
from small_batches import NECTARINE, batch_of_balls, write_ball

from pipeline.batch.fruits_table import read_fruits
from pipeline.batch.layout import Results
from pipeline.batch.opening import open_batch
from pipeline.batch.task import fruit_task
from pipeline.problem import BatchRefused
from pipeline.run.checking import check, implausible
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import write_mesh

DIRECTIONS, FACES = ball(3)
HEAD = "fruit_id,mass_g,reference,reference_E_MPa,reference_E_sd_MPa,reference_poisson_ratio\n"
FRUITS = "".join(f"F{k},90,,,,\n" for k in range(4))
BALL = "ball,9,true,0.5,0.01,0.48\n"


@pytest.fixture
def made(tmp_path):
    """Four ready nectarines of radius 28 mm and a reference ball of 10 mm: no nectarine's size or mass."""

    def make(rows=FRUITS + BALL, settings=NECTARINE):
        names = ("F0", "F1", "F2", "F3", "ball")
        batch_of_balls(tmp_path, *names, table=HEAD + rows, settings=settings)
        write_ball(tmp_path / "fruits" / "ball" / "fruit.ply", radius_mm=10)
        return tmp_path

    return make


def said(tmp_path, row):
    path = tmp_path / "fruits.csv"
    path.write_text(HEAD + "F0,90,,,,\n" + row + "\n")
    return "\n".join(map(str, read_fruits(path)[1]))


@pytest.mark.parametrize("yes", ["true", "True", "yes", "1"])
def test_a_reference_is_read_and_a_fruit_is_none(tmp_path, yes):
    path = tmp_path / "fruits.csv"
    path.write_text(HEAD + f"F0,90,,,,\nF1,90,false,,,\nball,9,{yes},0.5,0.01,0.48\n")
    rows, faults = read_fruits(path)
    assert not faults
    assert [row.reference for row in rows] == [False, False, True]
    body = rows[2]
    assert (body.reference_E_MPa, body.reference_E_sd_MPa, body.reference_poisson_ratio) == (0.5, 0.01, 0.48)


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        (
            "ball,,maybe,0.5,0.01,0.48",
            'reference is "maybe"; expected true for a reference body of known modulus',
        ),
        ("ball,,,0.5,,", 'reference_E_MPa is "0.5", but reference is not true; write true'),
        ("ball,,true,,0.01,0.48", "reference_E_MPa is empty; expected the reference body's Young's modulus"),
        ("ball,,true,500,10,0.48", "0.0005 to 60 MPa; is it in kPa (0.5 MPa)?"),
        ("ball,,true,-0.5,0.01,0.48", 'reference_E_MPa is "-0.5"; expected'),
        ("ball,,true,0.5,,0.48", "reference_E_sd_MPa is empty; expected one standard deviation"),
        ("ball,,true,0.5,0.3,0.48", "at most 0.25 MPa (half of its modulus)"),
        ("ball,,true,0.5,0.01,0.5", 'reference_poisson_ratio is "0.5"; expected 0.1 to 0.4999'),
    ],
)
def test_a_bad_cell_is_named_by_file_line_and_column(tmp_path, row, sentence):
    text = said(tmp_path, row)
    assert sentence in text
    assert str(tmp_path / "fruits.csv") in text
    assert "line 3 (ball)" in text
    assert len(text.splitlines()) == 1


def test_a_reference_is_graded_as_a_solid_phantom_of_its_own_ratio(made):
    settings = (
        'category = "nectarine"\npoisson_ratio = 0.42\npoisson_ratio_sd = 0.02\n'
        '[[mismatch]]\neffect = "skin"\nparameters = { Et_N_per_mm = 0.2 }\n'
        '[[mismatch]]\neffect = "sensor_gain"\nparameters = { pad = "left", gain = 1.1 }\n'
    )
    batch = open_batch(made(settings=settings))
    results = Results(batch.folder.default_results)
    ball, fruit = (fruit_task(batch, name, results) for name in ("ball", "F0"))
    assert ball.settings.pit.none
    assert (ball.category, ball.body.stem_and_suture) == ("phantom", False)
    assert ball.settings.poisson_ratio is None
    assert ball.prior.poisson_ratio == 0.48
    assert [effect.effect for effect in ball.settings.mismatch] == ["sensor_gain"]
    assert (fruit.category, fruit.settings.pit.none, fruit.settings.poisson_ratio) == (
        "nectarine", False, 0.42
    )  # fmt: skip
    assert [effect.effect for effect in fruit.settings.mismatch] == ["skin", "sensor_gain"]


def test_the_known_modulus_is_no_part_of_what_is_computed(made):
    """A certificate corrected later costs no second grading; another Poisson's ratio does."""
    keys = []
    for row in (BALL, BALL.replace("0.5,", "0.6,"), BALL.replace("0.48", "0.47")):
        batch = open_batch(made(FRUITS + row))
        keys.append(fruit_task(batch, "ball", Results(batch.folder.default_results)).key)
    assert keys[0] == keys[1] != keys[2]


def test_neither_fruit_nor_reference_is_held_against_the_other(made):
    sound = open_batch(made())
    assert {implausible(sound, row) for row in sound.rows} == {""}
    as_fruit = open_batch(made(FRUITS + "ball,9,,,,\n"))
    assert "a nectarine is 18 to 650 g" in implausible(as_fruit, as_fruit.row_of["ball"])


def test_a_reference_without_a_ratio_or_with_a_pit_is_refused(made):
    root = made(FRUITS + "ball,9,true,0.5,0.01,\n")
    with pytest.raises(BatchRefused, match='reference_poisson_ratio of "ball" is empty; expected'):
        open_batch(root)
    assert open_batch(made(FRUITS + "ball,9,true,0.5,0.01,\n", 'category = "phantom"\npoisson_ratio = 0.4\n'
                           '[pit]\nprior = "none"\n')).rows[-1].reference  # fmt: skip
    root = made()
    write_mesh(root / "fruits" / "ball" / "pit.ply", 3 * DIRECTIONS, FACES)
    with pytest.raises(
        BatchRefused, match=r"pit\.ply: gives a pit for a reference body, which must be solid"
    ):
        open_batch(root)


def test_check_has_nothing_against_a_reference_but_that_it_was_not_grasped(made):
    problems = [str(problem) for problem in check(made()) if "ball" in str(problem)]
    assert len(problems) == 1
    assert "needs at least one recording (.h5" in problems[0]
