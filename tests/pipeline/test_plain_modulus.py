"""E without an effect, as explaining is handed it: grading's number, or grading's reason."""

from types import SimpleNamespace

import pytest

import pipeline.diagnosis.diagnosis as diagnosis
from fem.estimation.error_budget import ErrorBudget
from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.result import Modulus
from pipeline.diagnosis.diagnosis import plain_modulus
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


@pytest.mark.parametrize(("stated_mm", "counts_mm"), [(None, 0.2), (0.05, 0.05)])
def test_it_is_what_grading_infers_from_the_surface_that_the_case_states(monkeypatch, stated_mm, counts_mm):
    def inferred(task, placed, mesh, *, poisson_ratio, budget):
        assert (task, placed, mesh, poisson_ratio) == ("the task", (), "the mesh", 0.45)
        assert budget.surface_sd_mm == counts_mm
        return SimpleNamespace(modulus=SimpleNamespace(E_MPa=0.7, E_sd_MPa=0.02))

    monkeypatch.setattr(diagnosis, "fruit_modulus", inferred)
    assert plain_modulus(case_with(stated_mm), FRUIT) == Modulus(value=0.7, sd=0.02)


def test_where_no_recording_gives_a_modulus_the_first_ones_reason_is_said(monkeypatch):
    reason = FemFailure(FemProblem.NO_LOAD, "found no frame in which a pad presses")

    def inferred(*_, **__):
        raise ExceptionGroup("no grasp gives a modulus", [reason])

    monkeypatch.setattr(diagnosis, "fruit_modulus", inferred)
    with pytest.raises(FemFailure, match="no frame in which a pad presses"):
        plain_modulus(case_with(None), FRUIT)
