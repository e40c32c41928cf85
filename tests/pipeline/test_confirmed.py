"""Effects: screened in a stage of its own, confirmed in the settings."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from bare_grasp_model import BARE_MODEL
from graded_results import graded as graded_fruit

import pipeline.fruit.missing_physics as stage
from fem.estimation.error_budget import ErrorBudget
from fem.estimation.modulus import ModulusEstimate
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import FleshMesh
from fem.mismatch.catalogue import SPECS
from fem.mismatch.mismatch_case import GraspCase
from fem.mismatch.screen import Amount, Screened
from pipeline.batch.confirmed_effects import ConfirmedEffect, PitFound, pit_found
from pipeline.batch.layout import FruitResults, Results
from pipeline.batch.records import ScreenRecord
from pipeline.batch.settings import PitSettings, Settings
from pipeline.fruit.flesh_effects import (
    MECHANICS,
    catalogue_parameters,
    unused_warnings,
    used,
    with_corrections,
)
from pipeline.fruit.flesh_model import error_budget, poisson_ratio
from pipeline.fruit.fruit_shape import embedded_pit
from pipeline.fruit.repeated_modulus import _shifted
from pipeline.ranking.report_entries import _explained, _screen
from pipeline.ranking.report_pictures import MANY_SCENES, fruit_pictures
from recon.surface.mesh_file import write_mesh

NU = ConfirmedEffect(effect="poisson_ratio", parameters={"nu": 0.41}, sd={"nu": 0.007})
OFFSET = ConfirmedEffect(
    effect="pit_offset", parameters={"offset_mm": (1.0, -2.0, 0.5)}, sd={"offset_mm": (0.1, 0.2, 0.1)}
)
SIZE = ConfirmedEffect(effect="pit_size", parameters={"scale": 0.8}, sd={"scale": 0.02})
SKIN = ConfirmedEffect(effect="skin", parameters={"Et_N_per_mm": 2.0}, sd={"Et_N_per_mm": 0.1})
BOX = trimesh.creation.box([2.0, 2.0, 2.0])


def settings(*effects, **rest):
    return Settings(category="nectarine", poisson_ratio=0.45, mismatch=effects, **rest)


def test_a_ratio_that_was_found_comes_before_the_settings():
    assert poisson_ratio(settings(NU), None) == (0.41, 0.007, "found by drupe explain")
    assert poisson_ratio(settings(), None)[:2] == (0.45, 0.0)


def test_a_pit_that_was_found_narrows_the_error_budget():
    task = SimpleNamespace(
        settings=settings(OFFSET, SIZE, pit=PitSettings(offset_sd_mm=0.5, size_sd=0.03)), prior=None
    )
    shape = SimpleNamespace(record=SimpleNamespace(surface_sd_mm=None))
    budget = error_budget(task, shape)
    assert budget.pit_offset_sd_mm == 0.2
    assert budget.pit_size_sd == pytest.approx(0.025)
    assert pit_found(()) == PitFound()
    robots = [SimpleNamespace(pose_sd_mm=sd) for sd in (0.4, 0.7)]
    assert error_budget(task, shape, robots).pose_sd_mm == 0.7
    robots.append(SimpleNamespace(pose_sd_mm=None))
    assert error_budget(task, shape, robots[-1:]).pose_sd_mm == budget.pose_sd_mm == 0.3


def test_a_pit_that_was_found_is_embedded_where_it_was_found(tmp_path):
    write_mesh(tmp_path / "pit.ply", 5.0 * BOX.vertices + [0, 0, 1], BOX.faces)
    folder = SimpleNamespace(pit_ply=tmp_path / "pit.ply")
    shape = SimpleNamespace(vertices=20.0 * BOX.vertices, faces=BOX.faces)
    plain = embedded_pit(SimpleNamespace(folder=folder, settings=settings(), prior=None), shape)
    moved = embedded_pit(SimpleNamespace(folder=folder, settings=settings(OFFSET, SIZE), prior=None), shape)
    assert np.subtract(moved.record.centre_mm, plain.record.centre_mm) == pytest.approx(
        [1.0, -2.0, 0.5], abs=1e-5
    )
    assert moved.record.volume_mm3 == pytest.approx(0.8**3 * plain.record.volume_mm3)
    assert "moved to where it was found" in moved.record.source


def test_what_effects_add_goes_to_the_grasps_that_have_a_model():
    lost = FemFailure(FemProblem.NO_LOAD, "no load")
    models = [BARE_MODEL, lost, replace(BARE_MODEL, displacement_correction=np.ones((3, 2, 3)))]
    first, second, third = with_corrections(models, [np.full((3, 2, 3), 2.0)] * 2)
    assert second is lost
    assert (first.displacement_correction == 2.0).all()
    assert (third.displacement_correction == 3.0).all()


def test_every_effect_that_can_be_confirmed_has_the_parameters_of_its_model():
    values = {"number": 0.4, "pair": (0.1, 0.2), "triple": (0.1, 0.2, 0.3), "pad": "left"}
    for name, spec in SPECS.items():
        parameters = {parameter.name: values[parameter.kind] for parameter in spec.parameters}
        effect = ConfirmedEffect(effect=name, parameters=parameters)
        assert used([effect]) == (effect,)
        if name in MECHANICS:
            wanted = {spec.name for spec in MECHANICS[name].spec.searched}
            assert catalogue_parameters(effect, 0.5).keys() == wanted


def test_a_skin_counts_in_the_stiffness_of_the_flesh_below_it():
    assert catalogue_parameters(SKIN, 0.4) == {"Et_over_E_mm": pytest.approx(5.0)}


def test_a_second_relaxing_arm_is_said_to_be_left_out():
    parameters = {"g": 0.2, "tau_s": 1.0, "g_2": 0.1, "tau_2_s": 9.0}
    arms = ConfirmedEffect(effect="viscoelastic", parameters=parameters)
    assert used([arms, SKIN]) == (SKIN,)
    (warning,) = unused_warnings([arms, SKIN])
    assert warning.startswith("batch.toml confirms viscoelastic with g_2, tau_2_s, which grading cannot")


def test_each_number_is_moved_by_its_own_spread_for_the_error_bar():
    moved = [shifted.vector("offset_mm") for _, shifted in _shifted(OFFSET)]
    assert moved == [(1.1, -2.0, 0.5), (1.0, -1.8, 0.5), (1.0, -2.0, 0.6)]
    ((name, shifted),) = _shifted(SIZE)
    assert (name, shifted.number("scale")) == ("scale", pytest.approx(0.82))


def test_an_answer_of_other_inputs_is_not_the_fruits(tmp_path):
    files, record = FruitResults(tmp_path), SimpleNamespace(key="k1")
    assert _explained(record, files) is None
    said = {"key": "k1", "verdict": ["skin", "slip"], "ranking": [{"effect": "slip"}, {"effect": "skin"}]}
    files.mismatch.write_text(json.dumps(said))
    assert _explained(record, files).names == ("slip", "skin")
    assert _explained(SimpleNamespace(key="k2"), files) is None
    files.mismatch.write_text("half a fi")
    assert _explained(record, files) is None


def test_many_fruit_are_not_shown_in_three_dimensions(tmp_path):
    results = Results(tmp_path)
    files = results.fruit("N01")
    files.root.mkdir(parents=True)
    for path, content in ((files.outlines, b"a link"), (files.scene, b"own")):
        path.write_bytes(content)
    for fruits, shown in ((1, b"own"), (MANY_SCENES + 1, b"")):
        assert fruit_pictures(results, files, fruits=fruits).scene == shown


MESH = FleshMesh(
    nodes_mm=np.zeros((10, 3)),
    tets=np.arange(10).reshape(1, 10),
    outer_faces=np.arange(6).reshape(1, 6),
    pit_nodes=np.zeros(0, dtype=np.int64),
)
SAID = Screened(
    p_value=0.01,
    names=("skin",),
    statistics={"best single": 9.0},
    gains={"skin": 9.0},
    amounts=(Amount(effect="sensor_gain", pad="left", parameter="gain", value=0.01, sd=0.003),),
)


def estimate(E_MPa=0.5):
    modulus = object.__new__(ModulusEstimate)
    object.__setattr__(modulus, "E_MPa", E_MPa)
    return modulus


def graded(*estimates):
    models = tuple(BARE_MODEL if isinstance(outcome, ModulusEstimate) else outcome for outcome in estimates)
    return SimpleNamespace(models=models, grasps=tuple(estimates))


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A task and a fruit of two grasps; `asked` is what the screen was handed."""
    asked = []
    times = np.arange(3.0)

    def case_of(grasp):
        history = GraspHistory(time_s=times, phase=("load",) * 3, pads=())
        return GraspCase(name=grasp.name, history=history, pads=(), support="free")

    monkeypatch.setattr(stage, "grasp_case", case_of)
    task = SimpleNamespace(
        results=SimpleNamespace(cache=tmp_path, traceback=tmp_path / "traceback.txt"),
        settings=Settings(category="nectarine", poisson_ratio=0.45),
    )
    fruit = SimpleNamespace(
        placed=tuple(SimpleNamespace(name=name, plain_jaw=False) for name in ("grasp-1", "grasp-2")),
        mesh=MESH,
        poisson_ratio=0.45,
        budget=ErrorBudget(),
    )

    def answers(answer):
        def screen(case, **options):
            asked.append((case, options))
            if isinstance(answer, BaseException):
                raise answer
            return answer

        monkeypatch.setattr(stage, "screen", screen)

    return SimpleNamespace(task=task, fruit=fruit, asked=asked, answers=answers, folder=tmp_path)


def test_what_was_found_stands_in_the_record(place):
    place.answers(SAID)
    record = stage.screened_fruit(place.task, place.fruit, graded(estimate(0.4), estimate(0.6)), {})
    assert (record.p_value, record.names, record.failure, record.note) == (0.01, ("skin",), "", "")
    assert [(amount.pad, amount.value, amount.sd) for amount in record.amounts] == [("left", 0.01, 0.003)]


CONFIRMED = SimpleNamespace(effect="skin", spec=SimpleNamespace(holds_large_deformation=False))


def corrected(model):
    """A model with what finite strain adds."""
    return replace(model, displacement_correction=np.zeros((1, *model.place_mm.shape)))


@pytest.mark.parametrize(
    ("law", "confirmed", "beyond"),
    [
        ("linear", (), True),
        ("neo-hookean", (), True),
        ("neo-hookean", (CONFIRMED,), False),
        ("linear", (CONFIRMED,), True),
    ],
)
def test_finite_strain_is_left_to_the_screen_unless_effects_are_confirmed(
    place, monkeypatch, law, confirmed, beyond
):
    place.answers(SAID)
    monkeypatch.setattr(stage, "in_the_model", lambda _: confirmed)
    place.task.settings = Settings(category="nectarine", poisson_ratio=0.45, flesh={"model": law})
    inference = graded(estimate(), estimate())
    inference.models = tuple(corrected(model) for model in inference.models)
    stage.screened_fruit(place.task, place.fruit, inference, {})
    (case, asked), *_ = place.asked
    assert asked["beyond_small_strain"] == beyond
    assert [grasp.correction is None for grasp in case.grasps] == [not confirmed] * 2


def test_the_same_inputs_are_screened_once_and_another_mesh_again(place):
    place.answers(SAID)
    both = graded(estimate(), estimate())
    first = stage.screened_fruit(place.task, place.fruit, both, {})
    assert stage.screened_fruit(place.task, place.fruit, both, {}) == first
    assert len(place.asked) == 1
    moved = SimpleNamespace(**vars(place.fruit) | {"mesh": replace(MESH, nodes_mm=MESH.nodes_mm + 1e-9)})
    stage.screened_fruit(place.task, moved, both, {})
    assert len(place.asked) == 2


def test_a_failure_of_the_mechanics_is_a_sentence(place):
    place.answers(FemFailure(FemProblem.NO_LOAD, "pad left never presses"))
    record = stage.screened_fruit(place.task, place.fruit, graded(estimate(), estimate()), {})
    assert (record.p_value, record.names, record.failure) == (None, (), "pad left never presses")
    assert not record.again


def test_a_fault_of_the_screen_costs_the_screen_alone_and_leaves_its_traceback(place):
    place.answers(ZeroDivisionError("by nothing"))
    record = stage.screened_fruit(place.task, place.fruit, graded(estimate(), estimate()), {})
    assert (record.failure, record.again) == (stage.INTERNAL, True)
    assert "ZeroDivisionError: by nothing" in (place.folder / "traceback.txt").read_text()


def test_a_grasp_without_a_modulus_is_left_out_and_named(place):
    place.answers(SAID)
    inference = graded(estimate(), FemFailure(FemProblem.NO_MODULUS, "no modulus"))
    record = stage.screened_fruit(place.task, place.fruit, inference, {})
    assert [grasp.name for grasp in place.asked[0][0].grasps] == ["grasp-1"]
    assert record.note == "without grasp-2, which give no E from first contact"


def graded_record(**screen):
    return graded_fruit("N01", 0.5, changes={"screen": ScreenRecord(**screen)})


def test_two_effects_at_once_are_told_with_the_words_of_both():
    (both,) = _screen(graded_record(p_value=0.01, names=("pit_offset+slip",))).suspects
    assert both.name == "pit_offset+slip"
    assert all(SPECS[name].words.short in both.short for name in ("pit_offset", "slip"))


def test_every_name_that_the_screen_may_suggest_has_words():
    for name in (*SPECS, "unknown"):
        (suspect,) = _screen(graded_record(p_value=0.01, names=(name,))).suspects
        assert suspect.short


def test_a_fruit_that_was_not_graded_shows_no_screen():
    lost = graded_record(p_value=0.01).model_copy(update={"outcome": "implausible-modulus"})
    assert _screen(lost) is None
    assert _screen(graded_record(failure="too few.")).verdict == "not screened: too few"


def test_a_plain_jaw_is_not_screened_and_it_is_said(place):
    placed = (*place.fruit.placed[:1], SimpleNamespace(name="grasp-2", plain_jaw=True))
    fruit = SimpleNamespace(**vars(place.fruit) | {"placed": placed})
    said = stage.screened_fruit(place.task, fruit, graded(estimate(0.4), estimate(0.6)), {})
    assert said.failure.startswith("one jaw has no gel (grasp-2)")
    assert not place.asked
