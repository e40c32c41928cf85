"""Responses are kept by content; a grasp that fails costs only itself; the record says what came of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import pipeline.fruit.elasticity as elasticity
from fem.estimation.error_budget import ErrorBudget
from fem.estimation.prepared_grasp import prepared_grasp
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory, PadHistory
from fem.mesh.flesh_mesh import tetrahedralise
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes, pad_link
from pipeline.fruit.grasped import GraspedFruit

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
        pads.append(
            PadHistory(
                name=name,
                rest_mm=np.column_stack([FLAT_MM, np.zeros(len(FLAT_MM))]),
                surface_mm=place,
                position_mm=place + np.zeros_like(force),
                gel_displacement_mm=np.zeros_like(force),
                force_N=force,
                episode=np.zeros(force.shape[:2], dtype=np.int64),
                displacement_sd_mm=0.001,
                force_sd_N=1e-4,
                lag1=0.0,
            )
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
