"""A fruit's shape and category: meshes as they are written."""

import json

import numpy as np
import pytest
import trimesh
from in_this_process import InThisProcess
from rich.console import Console

import pipeline.run.grading
from pipeline.batch.layout import FruitResults, Results
from pipeline.batch.opening import open_batch
from pipeline.batch.records import MeshRecord, PitRecord
from pipeline.batch.task import fruit_task
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.fruit.fruit_shape import FruitPit, FruitShape, embedded_pit, fruit_shape, write_meshes
from pipeline.problem import BatchRefused
from pipeline.run.batch_run import GradeOptions
from pipeline.run.grading import grade
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import read_mesh, write_mesh
from recon.triangle_mesh import volume_mm3

DIRECTIONS, FACES = ball(4)
PHANTOM = 'category = "phantom"\npoisson_ratio = 0.47\n'
OWN = """
category = "kaki"
given_by_batch = ["pit"]
offset_sd_mm = { value = 0.7, source = "own" }
size_sd = { value = 0.05, source = "own" }
poisson_ratio = { value = 0.44, source = "own" }
poisson_ratio_sd = { value = 0.01, source = "own" }
density_g_per_cm3 = { value = [1.0, 1.2], source = "own" }
stem_and_suture = { value = false, source = "own" }
"""
"""A seedless fruit without a groove."""


@pytest.fixture
def made(tmp_path):
    """A batch of two ready fruit, balls of radius 20 mm, the first with a pit of 8 mm."""

    def make(settings, **files):
        for name in ("A", "B"):
            folder = tmp_path / "fruits" / name
            folder.mkdir(parents=True, exist_ok=True)
            write_mesh(folder / "fruit.ply", 20 * DIRECTIONS, FACES)
        write_mesh(tmp_path / "fruits" / "A" / "pit.ply", 8 * DIRECTIONS, FACES)
        (tmp_path / "fruits.csv").write_text("fruit_id,mass_g\nA,90\nB,\n")
        (tmp_path / "batch.toml").write_text(settings)
        for name, text in files.items():
            (tmp_path / f"{name}.toml").write_text(text)
        return tmp_path

    return make


def problems(root):
    with pytest.raises(BatchRefused) as caught:
        open_batch(root)
    return [str(p).removeprefix(f"{root}/") for p in caught.value.problems]


def tasks(root):
    batch = open_batch(root)
    return [fruit_task(batch, row.fruit_id, Results(root / "results")) for row in batch.rows]


def test_what_a_phantom_lacks_is_named_with_the_fruit_that_lack_it(made):
    (line,) = problems(made(PHANTOM))
    assert line.startswith('batch.toml: the category "phantom" has no default pit, and B has no pit.ply')
    assert 'prior = "none"' in line
    both = problems(made('category = "phantom"\n'))
    unknown = 'unknown for the category "phantom"; add poisson_ratio to batch.toml'
    assert any(unknown in sentence for sentence in both)
    assert len(both) == 2


def test_a_slip_in_a_name_is_guessed(made):
    (line,) = problems(made(PHANTOM.replace("phantom", "phantm")))
    assert line == 'batch.toml: "category": found "phantm"; did you mean "phantom"?'
    (line,) = problems(made(PHANTOM + '[pit]\nprior = "None"\n'))
    assert line == 'batch.toml: "pit.prior": found "None"; did you mean "none"?'


def test_a_fruit_with_a_pit_keeps_it_where_the_others_have_none(made):
    with_pit, without = tasks(made(PHANTOM + '[pit]\nprior = "none"\n'))
    shape = fruit_shape(with_pit)
    assert embedded_pit(with_pit, shape).record.source == "pit.ply"
    solid = embedded_pit(without, fruit_shape(without))
    assert solid.record is None
    assert len(solid.faces) == 0
    assert volume_mm3(*solid.skin) == pytest.approx(shape.record.volume_mm3)


def test_a_core_for_all_is_set_in_the_middle_in_its_own_size(made):
    root = made(PHANTOM + '[pit]\nprior = "core.stl"\n')
    trimesh.creation.box([9.0, 9.0, 9.0]).apply_translation([50, 0, 0]).export(root / "core.stl")
    given_core, common = (embedded_pit(task, fruit_shape(task)) for task in tasks(root))
    assert given_core.record.source == "pit.ply"
    assert common.record.volume_mm3 == pytest.approx(9.0**3, rel=1e-6)
    assert common.record.centre_mm == pytest.approx([0, 0, 0], abs=1e-3)
    assert common.record.source == "measured pit, placed as for phantom"


def test_an_own_category_is_called_by_its_own_name_and_judged_by_its_own_limits(made):
    root = made('category = "mine.toml"\n[pit]\nprior = "none"\n', mine=OWN)
    batch = open_batch(root)
    assert (batch.category, batch.prior.poisson_ratio) == ("kaki", 0.44)
    first, _ = tasks(root)
    assert first.category == "kaki"
    shape = fruit_shape(first)
    (doubt,) = shape.warnings
    assert "the density would be 2.69 g" in doubt
    assert "expected 1.00 to 1.20" in doubt
    assert shape.record.stance is None


def test_limits_are_the_categorys_where_the_pit_is_another_files(made):
    core = OWN.replace('given_by_batch = ["pit"]\n', "").replace("kaki", "bead") + (
        'axis_ratios = { value = [0.3, 0.3, 0.3], source = "own" }\n'
        'raised = { value = [0, 0, 0], source = "own" }\nexponent = { value = 2, source = "own" }\n'
    )
    root = made(PHANTOM + '[pit]\nprior = "core.toml"\n', core=core)
    batch = open_batch(root)
    assert (batch.category, batch.prior.category) == ("phantom", "bead")
    assert batch.body.density_g_per_cm3 == (0.2, 8)
    _, second = tasks(root)
    pit = embedded_pit(second, fruit_shape(second))
    assert pit.record.box_mm == pytest.approx([12, 12, 12], rel=0.01)
    (root / "batch.toml").write_text('category = "phantom"\n[pit]\nprior = "core.toml"\n')
    (line,) = problems(root)
    assert 'unknown for the category "phantom"; add poisson_ratio to batch.toml' in line


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("offset_sd_mm", "# "), "mine.toml: offset_sd_mm is None; expected { value = a number from 0 to 20"),
        (
            ('given_by_batch = ["pit"]', 'axis_ratios = { value = [0.4, 0.4, 0.4], source = "own" }'),
            "mine.toml: raised is None; expected { value = 3 numbers from -0.5 to 0.5",
        ),
        (("0.44", "0.7"), "mine.toml: poisson_ratio is {'value': 0.7"),
        (('["pit"]', '["pips"]'), "mine.toml: given_by_batch is ['pips']; expected a list of"),
        (
            ('["pit"]', '["poisson_ratio"]'),
            'given_by_batch leaves "poisson_ratio" to the batch; remove one of',
        ),
        (("[1.0, 1.2]", "[1.2, 1.0]"), "the smaller first"),
        (
            ("= false,", '= "no",'),
            "stem_and_suture is {'value': 'no', 'source': 'own'}; expected { value = true",
        ),
        (("density_g_per_cm3", "densities_g_per_cm3"), 'unknown key "densities_g_per_cm3"; did you mean'),
        (("= false, ", "= false }#"), "stem_and_suture is {'value': False}; expected"),
        (('category = "kaki"', "category ="), "is not valid TOML"),
    ],
)
def test_a_fault_of_an_own_category_names_file_field_and_what_is_expected(made, change, says):
    lines = problems(made('category = "mine.toml"\n', mine=OWN.replace(*change)))
    assert any(line.startswith('batch.toml: "category": ') and says in line for line in lines)


def test_an_own_category_that_is_not_there_is_named_even_where_all_fruit_bring_pits(made):
    root = made(PHANTOM.replace("phantom", "mine.toml"))
    write_mesh(root / "fruits" / "B" / "pit.ply", 8 * DIRECTIONS, FACES)
    (line,) = problems(root)
    assert 'batch.toml: "category": ' in line
    assert "mine.toml is no file; write the file" in line


def test_an_effect_of_the_pit_is_refused_where_there_is_none(made):
    effect = '[[mismatch]]\neffect = "pit_size"\nparameters = {{ scale = 1.1 }}\nfruits = ["{}"]\n'
    none = PHANTOM + '[pit]\nprior = "none"\n'
    (line,) = problems(made(none + effect.format("B")))
    assert 'pit_size is an effect of the pit, but B has no pit (pit.prior is "none")' in line
    assert open_batch(made(none + effect.format("A"))).prior.category == "phantom"


def test_own_files_are_among_the_inputs_of_the_results(made, monkeypatch):
    monkeypatch.setattr(pipeline.run.grading, "LocalPool", lambda *_, **__: InThisProcess())
    root = made('category = "mine.toml"\n[pit]\nprior = "none"\n', mine=OWN)
    status, _ = grade(root, None, GradeOptions(jobs=1, time_limit_s=600), console=Console(quiet=True))
    assert status == 3  # no recordings
    assert "mine.toml" in json.loads((root / "results" / "batch.json").read_text())["inputs"]


def test_a_case_of_a_phantom_needs_its_core_and_poissons_ratio(tmp_path):
    write_mesh(tmp_path / "fruit.ply", 20 * DIRECTIONS, FACES)
    (tmp_path / "case.toml").write_text('category = "phantom"\n')
    with pytest.raises(BatchRefused, match=r"add pit\.ply and the key poisson_ratio\.$"):
        open_case(tmp_path, fruit_id=None, work=tmp_path / "work", out=None)
    write_mesh(tmp_path / "pit.ply", 8 * DIRECTIONS, FACES)
    (tmp_path / "case.toml").write_text(PHANTOM)
    case = open_case(tmp_path, fruit_id=None, work=tmp_path / "work", out=None)
    assert (case.task.category, case.task.body.stem_and_suture) == ("phantom", False)
    assert np.isclose(case.task.settings.poisson_ratio, 0.47)


COARSE_DIRECTIONS, COARSE_FACES = ball(3)
BOX = (60.0, 60.0, 60.0)


def pit():
    record = PitRecord(
        source="pit.ply", volume_mm3=1.0, centre_mm=(0, 0, 0), box_mm=BOX, thinnest_flesh_mm=1.0,
        flesh_volume_mm3=1.0,
    )  # fmt: skip
    return FruitPit(
        vertices=10 * COARSE_DIRECTIONS,
        faces=COARSE_FACES,
        skin=(30 * COARSE_DIRECTIONS, COARSE_FACES),
        record=record,
    )


def shape(views):
    counts = {"vertices": len(COARSE_DIRECTIONS), "faces": len(COARSE_FACES), "volume_mm3": 1.0}
    record = MeshRecord(source="photos", **counts, height_mm=60.0, box_mm=BOX)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1.0, 2.0, 3.0]
    return FruitShape(
        vertices=30 * COARSE_DIRECTIONS,
        faces=COARSE_FACES,
        mesh_from_fruit=pose,
        record=record,
        warnings=(),
        views=views,
    )


@pytest.mark.parametrize("known", [True, False])
def test_views_stay_with_their_vertices_and_both_meshes_go_back_to_their_frame(tmp_path, known):
    views = np.arange(len(COARSE_DIRECTIONS)) % 7
    results = FruitResults(tmp_path)
    write_meshes(results, shape(views if known else None), pit())
    for path, radius in ((results.fruit_ply, 30), (results.pit_ply, 10)):
        x, y, z = (radius * COARSE_DIRECTIONS).T
        np.testing.assert_allclose(read_mesh(path)[0], np.column_stack([1 - y, 2 + x, 3 + z]), atol=1e-5)
    table = trimesh.load_mesh(results.fruit_ply, process=False).metadata["_ply_raw"]["vertex"]["data"]
    assert ("views" in table.dtype.names) is known
    if known:
        assert np.array_equal(table["views"].ravel(), views)
