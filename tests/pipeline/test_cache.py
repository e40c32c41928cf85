"""Stages: computed once per key, kept by content, compared with what they were."""

import io
import json
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from jaxtyping import Float, Int
from pydantic import ValidationError
from recorded_pad import recorded_pad

import pipeline.fruit.elasticity as elasticity
from fem.estimation.error_budget import ErrorBudget
from fem.estimation.grasp_model import GraspModel
from fem.estimation.prepared_grasp import prepared_grasp
from fem.estimation.sensitivity import Sensitivity
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import tetrahedralise
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes, pad_link
from pipeline.batch import cache
from pipeline.batch.cache import HEADER, StageRecord, cached, file_hash, stage_key
from pipeline.batch.records import MeshRecord, read_record
from pipeline.fruit.elasticity import KeptModels
from pipeline.fruit.grasped import GraspedFruit
from recon.checks.quality import ReconQuality


@pytest.mark.parametrize("changed", ["fem/law.py", "fem/laws/more/hertz.py", "fem/null_reference.csv"])
def test_a_change_of_a_rooms_code_is_another_version_of_it_alone(tmp_path, monkeypatch, changed):
    """Wherever drupe is installed, a folder called data included."""
    places = tmp_path / "data" / "packages"
    for name in (changed, "recon/mesh.py", "fem/data/sample.csv"):
        (places / name).parent.mkdir(parents=True, exist_ok=True)
        (places / name).write_text("1")
    monkeypatch.setattr(cache, "PACKAGES", places)

    def versions():
        cache.code_version.cache_clear()
        return [cache.code_version((room,)) for room in ("fem", "recon")]

    fem, recon = versions()
    (places / "fem/data/sample.csv").write_text("2")
    assert versions() == [fem, recon]
    (places / changed).write_text("2")
    after = versions()
    assert after[0] != fem
    assert after[1] == recon
    with pytest.raises(FileNotFoundError, match="holds no source files"):
        cache.code_version(("tactile",))
    cache.code_version.cache_clear()


def test_a_library_that_is_not_installed_has_no_version(monkeypatch):
    monkeypatch.setattr(cache, "LIBRARIES", ("numpy", "no-such-library"))
    assert dict(cache.library_versions.__wrapped__()) == {"numpy": np.__version__}


def test_every_rooms_own_files_are_its_version():
    versions = [cache.code_version((room,)) for room in cache.ROOMS]
    assert len(set(versions)) == len(cache.ROOMS)
    assert all((cache.PACKAGES / room / "__init__.py").is_file() for room in cache.ROOMS)


class Kept(StageRecord):
    a: Float[np.ndarray, " n"]
    n: int


def make(counter):
    def compute():
        counter.append(1)
        return Kept(a=np.arange(3.0), n=3)

    return compute


def keep(folder, stage, key, compute):
    return cached(folder, stage, key, compute, record=Kept)


@pytest.mark.parametrize(
    ("key", "most_bytes", "computed"), [("k", None, 1), ("other", None, 2), ("k", 100, 2)]
)
def test_only_a_second_call_with_the_same_key_and_the_whole_file_computes_nothing(
    tmp_path, key, most_bytes, computed
):
    calls, path = [], tmp_path / "mesh.npz"
    first = keep(tmp_path, "mesh", "k", make(calls))
    path.write_bytes(path.read_bytes()[:most_bytes])
    second = keep(tmp_path, "mesh", key, make(calls))
    assert len(calls) == computed
    np.testing.assert_array_equal(first.a, second.a)
    assert second.n == 3


@pytest.mark.parametrize(
    "text",
    [
        '{"n": 3}',
        '{"a": {"__array__": "a"}}',
        '{"a": {"__array__": "b"}, "n": 3}',
        '{"a": {"__array__": "a"}, "n": "x"}',
        "[]",
        "no JSON",
    ],
)
def test_a_file_of_the_key_that_holds_another_record_is_computed_again(tmp_path, text):
    header = json.dumps({"key": "k", "record": text})
    buffer = io.BytesIO()
    np.savez(buffer, **{HEADER: np.array(header), "a": np.arange(2.0)})
    (tmp_path / "mesh.npz").write_bytes(buffer.getvalue())
    calls = []
    assert len(keep(tmp_path, "mesh", "k", make(calls)).a) == 3
    assert len(calls) == 1


@pytest.mark.parametrize("at", [b"k\0\0\0e\0\0\0y", b"\0\0\xf0?", b"PK\x01\x02"])
def test_a_damaged_file_is_computed_again(tmp_path, at):
    """Of the header, of the array and of the table of contents."""
    path, calls = tmp_path / "mesh.npz", []
    keep(tmp_path, "mesh", "k", make(calls))
    data = bytearray(path.read_bytes())
    data[data.index(at)] ^= 1
    path.write_bytes(data)
    np.testing.assert_array_equal(keep(tmp_path, "mesh", "k", make(calls)).a, np.arange(3.0))
    assert len(calls) == 2


def test_a_pipe_or_a_device_in_the_cache_is_never_waited_for(tmp_path):
    os.mkfifo(tmp_path / "mesh.npz")
    (tmp_path / "pit.npz").symlink_to("/dev/zero")
    for stage in ("mesh", "pit"):
        calls = []
        keep(tmp_path, stage, "k", make(calls))
        keep(tmp_path, stage, "k", make(calls))
        assert len(calls) == 1
    os.mkfifo(tmp_path / "pipe")
    assert file_hash(tmp_path / "pipe") == "unreadable: is a named pipe, not a file"
    assert read_record(tmp_path / "pipe") is None


def test_the_key_follows_contents_settings_and_stage(tmp_path):
    file = tmp_path / "f"
    file.write_text("one")

    def key(stage="mesh", setting=1):
        return stage_key(stage, files=[file], settings={"s": setting}, rooms=("recon",))

    first = key()
    assert key() == first
    assert key(setting=2) != first
    assert key(stage="pit") != first
    file.write_text("two")
    assert key() != first


class Part(StageRecord):
    points_mm: Float[np.ndarray, "n 3"]
    heights_mm: Float[np.ndarray, " n"] | None


class Whole(StageRecord):
    name: str
    parts: tuple[Part, ...]
    share: float
    faces: Int[np.ndarray, "m 3"]


def whole():
    rng = np.random.default_rng(1)
    parts = tuple(
        Part(points_mm=rng.normal(size=(n, 3)), heights_mm=h) for n, h in ((4, None), (2, np.ones(2)))
    )
    return Whole(name="Kirsche ✓", parts=parts, share=1 / 3, faces=np.array([[0, 1, 2]]))


def test_a_record_comes_back_as_it_was_with_records_and_arrays_inside():
    made = whole()
    text, arrays = made.stored()
    restored = Whole.restored(text, arrays)
    assert (restored.name, restored.share) == (made.name, made.share)
    for part, other in zip(restored.parts, made.parts, strict=True):
        np.testing.assert_array_equal(part.points_mm, other.points_mm)
    assert restored.parts[0].heights_mm is None
    np.testing.assert_array_equal(restored.parts[1].heights_mm, np.ones(2))
    assert restored.faces.dtype == made.faces.dtype


@pytest.mark.parametrize(
    "wrong",
    [
        {"points_mm": np.zeros((2, 2)), "heights_mm": None},
        {"points_mm": np.zeros((2, 3), dtype=int), "heights_mm": None},
        {"points_mm": np.zeros((2, 3)), "heights_mm": np.zeros(3)},
        {"points_mm": np.zeros((2, 3))},
        {"points_mm": np.zeros((2, 3)), "heights_mm": None, "more": 1},
        {"points_mm": [[0.0, 0.0, 0.0]], "heights_mm": None},
    ],
)
def test_another_shape_or_type_a_field_too_few_or_too_many_is_refused(wrong):
    with pytest.raises(ValidationError):
        Part(**wrong)


def test_a_record_whose_array_is_missing_is_none():
    text, arrays = whole().stored()
    with pytest.raises(ValueError, match="missing"):
        Whole.restored(text, {name: a for name, a in arrays.items() if name != "faces"})


def grasp_model(rng, markers=3):
    half = rng.normal(size=(3 * markers, 3 * markers))
    return GraspModel(
        place_mm=rng.normal(size=(markers, 3)),
        normal=rng.normal(size=(markers, 3)),
        compliance=half + half.T,
        sensitivity=Sensitivity(causes=("pit x", "left across"), values=rng.normal(size=(2, 4, markers, 3))),
        discretisation=0.01,
        fruit_moves=True,
        displacement_correction=rng.normal(size=(5, markers, 3)),
    )


def test_grasp_models_come_back_to_single_precision_and_failures_with_their_words():
    given = [grasp_model(np.random.default_rng(2)), FemFailure(FemProblem.OFF_SURFACE, "off by 3 mm")]
    model, failed = KeptModels.of(given).unpacked()
    assert isinstance(model, GraspModel)
    for name in ("place_mm", "normal", "compliance", "displacement_correction"):
        np.testing.assert_allclose(getattr(model, name), getattr(given[0], name), rtol=1e-6)
    np.testing.assert_allclose(model.sensitivity.values, given[0].sensitivity.values, rtol=1e-6)
    assert model.sensitivity.causes == given[0].sensitivity.causes
    assert (model.discretisation, model.fruit_moves) == (0.01, True)
    assert isinstance(failed, FemFailure)
    assert (failed.problem, failed.detail) == (FemProblem.OFF_SURFACE, "off by 3 mm")


def test_a_grasp_model_whose_normals_are_of_other_markers_is_refused():
    text, arrays = KeptModels.of([grasp_model(np.random.default_rng(3))]).stored()
    arrays["models.0.normal"] = arrays["models.0.normal"][:-1]
    with pytest.raises(ValidationError):
        KeptModels.restored(text, arrays)


def test_of_a_meshs_quality_only_what_is_known_is_written():
    record = MeshRecord(
        source="photos", vertices=4, faces=4, volume_mm3=1.0, height_mm=1.0, box_mm=(1.0, 1.0, 1.0),
        quality=ReconQuality().known(),
    )  # fmt: skip
    known = {"views_given": 0, "views_used": 0, "relief_share": 0.0, "flipped_views": 0}
    assert record.model_dump()["quality"] == known
    assert MeshRecord.model_validate_json(record.model_dump_json()) == record


NU, E_MPA = 0.45, 0.6
AXIS = np.linspace(-3.0, 3.0, 5)
FLAT_MM = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1).reshape(-1, 2)
LOAD = np.array([0.3, 0.6, 1.0, 0.7])
RADIUS_MM = 15.0


@pytest.fixture(scope="module")
def mesh():
    fruit = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_MM)
    pit = trimesh.creation.icosphere(subdivisions=3, radius=6.0)
    surfaces = (np.asarray(fruit.vertices), np.asarray(fruit.faces, dtype=np.int64))
    inner = (np.asarray(pit.vertices), np.asarray(pit.faces, dtype=np.int64))
    return tetrahedralise(*surfaces, *inner, edge_mm=5.0)


def pressed(mesh, axis):
    """A grasp along an axis, as a fruit of this mesh and of E_MPA would answer it."""
    bowl = 0.03 * np.exp(-(FLAT_MM**2).sum(axis=1) / 8)
    pads = []
    for name, side in (("left", -1.0), ("right", 1.0)):
        force = np.zeros((len(LOAD), len(FLAT_MM), 3))
        force[:, :, axis] = -side * np.outer(LOAD, bowl)
        place = np.insert(FLAT_MM, axis, side * np.sqrt(RADIUS_MM**2 - (FLAT_MM**2).sum(axis=1)), axis=1)
        rest = np.column_stack([FLAT_MM, np.zeros(len(FLAT_MM))])
        pads.append(
            recorded_pad(place, force, touching=True, sd_mm=0.001, sd_N=1e-4, name=name, rest_mm=rest)
        )
    history = GraspHistory(time_s=np.arange(4.0), phase=("load",) * 3 + ("unload",), pads=tuple(pads))
    solid = UnitModulusSolid.factorise(
        mesh, poisson_ratio=NU, support="free", contact_nodes=contact_nodes(mesh, [history])
    )
    links = [pad_link(pad, solid) for pad in pads]
    nodal = sum(link.nodal_force(pad.force_N) for link, pad in zip(links, pads, strict=True))
    flat = nodal.reshape(len(LOAD), -1) @ solid.contact_compliance
    moved = flat.reshape(nodal.shape) / E_MPA
    seen = tuple(
        replace(pad, position_mm=pad.position_mm + link.at_markers(moved))
        for pad, link in zip(pads, links, strict=True)
    )
    return replace(history, pads=seen)


@pytest.fixture(scope="module")
def histories(mesh):
    return {"along-x": pressed(mesh, 0), "along-y": pressed(mesh, 1)}


def turns_of(name):
    """Axes of both pads: the third one into the fruit."""
    axis = 0 if name == "along-x" else 1
    return np.stack([np.roll(np.eye(3), 2 - axis, axis=1) * [1.0, 1.0, into] for into in (1.0, -1.0)])


def off_the_skin(history):
    return replace(history, pads=tuple(replace(p, surface_mm=1.5 * p.surface_mm) for p in history.pads))


@pytest.fixture
def workplace(tmp_path, monkeypatch, histories):
    """A fruit's task with an empty cache, its grasps by name, and a count of the factorisations."""
    known = dict(histories, lost=off_the_skin(histories["along-y"]))
    monkeypatch.setattr(
        elasticity,
        "grasp_case",
        lambda grasp: SimpleNamespace(history=known[grasp.name], turns=turns_of(grasp.name)),
    )
    made = []
    factorise = UnitModulusSolid.factorise

    def counted(*args, **options):
        made.append(options["support"])
        return factorise(*args, **options)

    monkeypatch.setattr(UnitModulusSolid, "factorise", counted)
    task = SimpleNamespace(
        results=SimpleNamespace(cache=tmp_path),
        settings=SimpleNamespace(flesh=SimpleNamespace(model="linear"), mismatch=()),
    )
    return task, made


def grasps(*names):
    return tuple(SimpleNamespace(name=name, recording=SimpleNamespace(support="free")) for name in names)


def grasped(mesh, *names, poisson_ratio=NU):
    return GraspedFruit(
        shape=None,
        pit=None,
        placed=grasps(*names),
        failed=(),
        mesh=mesh,
        poisson_ratio=poisson_ratio,
        budget=ErrorBudget(),
    )


def modulus(task, mesh, *names, poisson_ratio=NU):
    return elasticity.fruit_modulus(task, grasped(mesh, *names, poisson_ratio=poisson_ratio))


def kept_models(task, mesh, histories, *names, workers=1):
    """The models of these grasps, as they are stored under a key of their own."""
    prepared = [prepared_grasp(histories[name], turns_of(name)) for name in names]
    fruit = grasped(mesh, *names)
    return elasticity.responses(task, f"response-{workers}", fruit, prepared, workers=workers)


@pytest.mark.slow
def test_a_second_run_with_the_same_content_factorises_nothing(workplace, mesh):
    task, made = workplace
    first = modulus(task, mesh, "along-x", "along-y")
    assert made == ["free"]
    again = modulus(task, mesh, "along-x", "along-y")
    assert made == ["free"]
    assert again.modulus.E_MPa == pytest.approx(first.modulus.E_MPa, rel=1e-6)
    assert again.modulus.E_sd_MPa == pytest.approx(first.modulus.E_sd_MPa, rel=1e-6)
    np.testing.assert_allclose(again.modulus.pit.offset_mm, first.modulus.pit.offset_mm, atol=1e-9)
    modulus(task, mesh, "along-x", "along-y", poisson_ratio=NU - 0.01)
    assert made == ["free", "free"]


def test_what_is_kept_is_what_was_computed_to_single_precision(workplace, mesh, histories):
    task, _ = workplace
    (kept,) = kept_models(task, mesh, histories, "along-x")
    prepared = prepared_grasp(histories["along-x"], turns_of("along-x"))
    solid = UnitModulusSolid.factorise(
        mesh, poisson_ratio=NU, support="free", contact_nodes=contact_nodes(mesh, [histories["along-x"]])
    )
    made = elasticity.grasp_model(prepared.history, solid)
    np.testing.assert_allclose(kept.compliance, made.compliance, atol=2e-7 * np.abs(made.compliance).max())
    np.testing.assert_array_equal(kept.compliance, kept.compliance.T)
    np.testing.assert_array_equal(kept.place_mm, made.place_mm)
    assert kept.sensitivity.causes == made.sensitivity.causes
    assert kept.fruit_moves
    assert kept.displacement_correction is None


@pytest.mark.slow
def test_two_threads_give_the_same_models(workplace, mesh, histories):
    task, _ = workplace
    serial, parallel = (
        kept_models(task, mesh, histories, "along-x", "along-y", workers=workers) for workers in (1, 2)
    )
    for model, other in zip(serial, parallel, strict=True):
        np.testing.assert_array_equal(model.compliance, other.compliance)
        np.testing.assert_array_equal(model.place_mm, other.place_mm)


def test_a_grasp_off_the_skin_does_not_cost_the_others(workplace, mesh):
    task, made = workplace
    inference = modulus(task, mesh, "lost", "along-x")
    lost, good = inference.grasps
    assert isinstance(lost, FemFailure)
    assert lost.problem is FemProblem.OFF_SURFACE
    assert "from the skin" in lost.detail
    assert inference.modulus.grasps == 1
    assert good.E_MPa == pytest.approx(E_MPA, rel=0.05)
    again = modulus(task, mesh, "lost", "along-x")
    assert made == ["free"]
    assert (again.grasps[0].problem, again.grasps[0].detail) == (lost.problem, lost.detail)


def test_all_grasps_off_the_skin_are_all_named(workplace, mesh):
    task, made = workplace
    with pytest.raises(ExceptionGroup) as caught:
        modulus(task, mesh, "lost")
    assert [exception.problem for exception in caught.value.exceptions] == [FemProblem.OFF_SURFACE]
    assert made == []


def test_the_record_holds_a_pit_from_two_grasps_and_none_from_one(workplace, mesh):
    task, _ = workplace
    modulus_along_x = elasticity.modulus_record(modulus(task, mesh, "along-x").modulus)
    assert modulus_along_x.pit_found is None
    both = modulus(task, mesh, "along-x", "along-y").modulus
    record = elasticity.modulus_record(both)
    assert record.E_MPa == both.E_MPa
    assert record.pit_found.offset_prior_sd_mm == (0.5, 0.5, 0.5)
    assert all(sd <= 0.5 * (1 + 1e-9) for sd in record.pit_found.offset_sd_mm)
    assert record.pit_found.size == pytest.approx(np.exp(both.pit.ln_size))
    assert record.common_sd_MPa == pytest.approx(both.parts_sd_MPa["discretisation"])
    assert type(record).model_validate_json(record.model_dump_json()) == record


def test_a_recording_without_equilibrium_at_finite_strain_enters_E_at_small_strain(
    workplace, mesh, monkeypatch
):
    """E is that at small strain, a warning names the recording, and the error bar is a tenth of E wider."""
    task, _ = workplace
    linear = modulus(task, mesh, "along-x", "along-y")
    assert elasticity.at_small_strain(grasps("along-x", "along-y"), linear) == []

    def unsettled(small, *_, **__):
        raise FemFailure(FemProblem.NOT_CONVERGED, "E still changes in round 10")

    monkeypatch.setattr(elasticity, "with_finite_strain", unsettled)
    task.settings.flesh.model = "neo-hookean"
    inference = modulus(task, mesh, "along-x", "along-y")
    assert inference.modulus.E_MPa == pytest.approx(linear.modulus.E_MPa, rel=1e-9)
    for kept in (inference, modulus(task, mesh, "along-x", "along-y")):
        first, second = elasticity.at_small_strain(grasps("along-x", "along-y"), kept)
        assert first.startswith("along-x: ")
        assert "E still changes in round 10" in first
        assert second.startswith("along-y: ")
    plain, wider = (elasticity.modulus_record(inference.modulus, small_strain=share) for share in (0.0, 1.0))
    assert wider.parts_sd_MPa[elasticity.SMALL_STRAIN] == pytest.approx(0.1 * plain.E_MPa)
    assert wider.E_sd_MPa == pytest.approx(np.hypot(plain.E_sd_MPa, 0.1 * plain.E_MPa))
