"""E without an effect, as explaining is handed it: grading's number, or grading's reason."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

import pipeline.diagnosis.diagnosis as diagnosis
from fem.estimation.error_budget import ErrorBudget
from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.result import Modulus
from pipeline.diagnosis.diagnosis import graded_case
from pipeline.fruit.grasped import GraspedFruit

FRUIT = GraspedFruit(
    shape=None,
    pit=None,
    placed=(),
    failed=(),
    mesh="the mesh",
    poisson_ratio=0.45,
    budget=ErrorBudget(surface_sd_mm=0.2),
)


def case_with(surface_sd_mm):
    return SimpleNamespace(task="the task", mesh_sd_mm=surface_sd_mm)


def inference(*, grasps=(), warnings=()):
    modulus = SimpleNamespace(E_MPa=0.7, E_sd_MPa=0.02, warnings=warnings)
    return SimpleNamespace(modulus=modulus, models=grasps, final_models=grasps, grasps=grasps)


@pytest.mark.parametrize(("stated_mm", "counts_mm"), [(None, 0.2), (0.05, 0.05)])
def test_it_is_what_grading_infers_from_the_surface_that_the_case_states(monkeypatch, stated_mm, counts_mm):
    def inferred(task, fruit, *, solids, workers):
        assert (task, workers) == ("the task", 3)
        assert fruit == replace(FRUIT, budget=ErrorBudget(surface_sd_mm=counts_mm))
        solids["free"] = "factorised"
        return inference()

    monkeypatch.setattr(diagnosis, "fruit_modulus", inferred)
    graded, _ = graded_case(case_with(stated_mm), FRUIT, jobs=3)
    assert graded.modulus == Modulus(value=0.7, sd=0.02)
    assert graded.solids == {"free": "factorised"}


def test_where_no_recording_gives_a_modulus_the_first_ones_reason_is_said(monkeypatch):
    reason = FemFailure(FemProblem.NO_LOAD, "found no frame in which a pad presses")

    def inferred(*_, **__):
        raise ExceptionGroup("no grasp gives a modulus", [reason])

    monkeypatch.setattr(diagnosis, "fruit_modulus", inferred)
    with pytest.raises(FemFailure, match="no frame in which a pad presses"):
        graded_case(case_with(None), FRUIT)


def test_what_grading_warns_of_and_leaves_out_is_handed_on(monkeypatch):
    lost = FemFailure(FemProblem.TOO_FEW_MARKERS, "found 4 markers under load")
    fruit = replace(FRUIT, placed=(SimpleNamespace(name="grasp-1"),))
    contradicting = inference(grasps=(lost,), warnings=("the pads contradict each other",))
    monkeypatch.setattr(diagnosis, "fruit_modulus", lambda *_, **__: contradicting)
    _, notes = graded_case(case_with(None), fruit)
    assert "ignore grasp-1: found 4 markers under load." in notes[0]
    assert "the pads contradict each other" in notes[1]
