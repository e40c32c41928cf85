"""Which of two linear rounds stands: of flesh that deforms largely, or of flesh that moves little."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fem.mismatch import procedure
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.selection import model_selection
from fem.mismatch.selection.model_selection import ModelSelection, select_likelier_model
from fem.mismatch.selection.screening import LinearRound, violates_sign_constraint
from fem.mismatch.thresholds import CLEARLY_LARGELY

LITTLE, LARGELY, STILL_LESS = -130.0, -100.0, -140.0
"""ln evidence of the plain model, by which a round is known here."""
GAINS = {LITTLE: 40.0, LARGELY: 5.0, STILL_LESS: 40.0}
ONE_WORKER = SimpleNamespace(workers=1)


def linear_round(
    log_evidence: float, *, largely: float = 0.0, other: LinearRound | None = None
) -> LinearRound:
    return LinearRound(
        products=None,
        nuisances=(),
        null=SimpleNamespace(log_evidence=log_evidence),
        linear_fits=(),
        best=(),
        pairs=(),
        without={},
        largely=largely,
        other=other,
    )


@pytest.fixture
def selected(monkeypatch):
    """Whose full models were asked for: they gain GAINS beside flesh of each kind."""
    asked = []

    def select_model(_, linear, **__):
        asked.append(linear.null.log_evidence)
        gain = GAINS[linear.null.log_evidence]
        return ModelSelection(ranking=(SimpleNamespace(gain=gain),), verdict=f"{gain:g}", without={})

    monkeypatch.setattr(model_selection, "select_model", select_model)
    return asked


def likelier(
    largely: float, *, detected: bool = True, other: float = LITTLE
) -> tuple[LinearRound, ModelSelection]:
    first = linear_round(LARGELY, largely=largely, other=linear_round(other))
    return select_likelier_model(ONE_WORKER, first, detected=detected)


def test_full_models_decide_where_signatures_leave_it_open(selected):
    linear, found = likelier(10.0)
    assert selected == [LARGELY, LITTLE]
    assert (linear.null.log_evidence, found.verdict) == (LITTLE, "40")
    assert linear.largely == pytest.approx(-5.0)  # -130 + 40 against -100 + 5
    assert linear.other is not None
    assert linear.other.null.log_evidence == LARGELY


def test_two_threads_give_the_same(selected):
    first = linear_round(LARGELY, largely=10.0, other=linear_round(LITTLE))
    linear, found = select_likelier_model(SimpleNamespace(workers=2), first, detected=True)
    assert sorted(selected) == [LITTLE, LARGELY]
    assert (linear.null.log_evidence, found.verdict) == (LITTLE, "40")


def test_a_round_that_still_stands_has_the_full_models_evidence(selected):
    linear, found = likelier(10.0, other=STILL_LESS)
    assert selected == [LARGELY, STILL_LESS]
    assert (linear.null.log_evidence, found.verdict) == (LARGELY, "5")
    assert linear.largely == pytest.approx(5.0)  # -100 + 5 against -140 + 40


@pytest.mark.parametrize(("largely", "detected"), [(CLEARLY_LARGELY + 1, True), (10.0, False)])
def test_where_it_is_clear_or_nothing_is_found_the_other_is_not_tried(selected, largely, detected):
    linear, found = likelier(largely, detected=detected)
    assert selected == [LARGELY]
    assert (linear.null.log_evidence, linear.largely, found.verdict) == (LARGELY, largely, "5")


def test_without_large_deformation_there_is_one_round(selected):
    alone = linear_round(LARGELY)
    linear, _ = select_likelier_model(ONE_WORKER, alone, detected=True)
    assert linear is alone
    assert selected == [LARGELY]


def test_large_deformation_is_told_by_the_plain_models_alone():
    """Whichever round stands with an effect beside it."""
    large, little = linear_round(LARGELY), linear_round(LITTLE)
    products = SimpleNamespace(amount_of=lambda *_: (0.9, 0.1))
    assert replace(large, products=products, largely=8.0, other=little).large_deformation == (0.9, 0.1)
    stands = replace(little, largely=-8.0, other=replace(large, products=products))
    assert stands.large_deformation == (0.9, 0.1)
    assert replace(little, largely=8.0, other=large).large_deformation is None
    assert large.large_deformation is None


def test_p_is_that_of_the_round_which_recordings_contradict_less(monkeypatch):
    p_of = {LITTLE: 0.13, LARGELY: 0.1}
    asked = []

    def tested(linear, kept):
        asked.append(kept)
        p = p_of[linear.null.log_evidence]
        return procedure.CaseDetection(p_value=p, p_values={"misfit": p}, linear=linear)

    monkeypatch.setattr(procedure, "_tested", tested)
    first = linear_round(LARGELY, other=linear_round(LITTLE))
    found = procedure.detected(first, kept=0.5)
    assert (found.p_value, found.linear.null.log_evidence) == (0.13, LITTLE)
    assert asked == [0.5, 0.5]
    assert procedure.detected(linear_round(LARGELY)).p_value == 0.1


def test_an_amount_that_is_less_than_means_anything_violates_its_sign():
    path = Regressor(name="path", sd=1.0, fields=(), positive=True, least=0.5)
    products = SimpleNamespace(columns=[None, path])
    assert violates_sign_constraint(products, (1,), np.array([0.4]))
    assert not violates_sign_constraint(products, (1,), np.array([0.6]))


def test_a_round_without_effects_has_the_plain_models_evidence():
    assert linear_round(LITTLE).evidence == LITTLE
