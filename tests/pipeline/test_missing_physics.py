"""The screen's stage: kept by content, and whatever happens in it, the fruit is graded."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
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
from pipeline.batch.records import ScreenRecord
from pipeline.batch.settings import Settings
from pipeline.ranking.report_entries import _screen

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
