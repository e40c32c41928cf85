"""Which explanations get full models, and what their outcome does to the verdict; `refit` is replaced."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.result import NONE
from fem.mismatch.selection import model_selection
from fem.mismatch.selection.decision import MISFIT
from fem.mismatch.selection.grasp_explanations import Hypothesis
from fem.mismatch.selection.model_selection import MOST_REFITS, ModelSelection, select_model
from fem.mismatch.signature_variant import ONE_WAY, of_pad

BY_NAME = {effect.spec.name: effect for effect in EFFECTS}
TYPICAL = 0.9 * MISFIT


def fit(name: str, gain: float, *, variant=ONE_WAY) -> SimpleNamespace:
    signature = SimpleNamespace(variant=variant)
    return SimpleNamespace(name=name, effect=BY_NAME[name], gain=gain, signature=signature, direct=0.0)


@dataclass
class Round:
    """What the linear round says, and what refits would: misfit, gain, failures, ends."""

    gains: dict[str, float]
    none_leaves: float = 3 * MISFIT
    left: dict[str, float] = field(default_factory=dict)
    evidence: dict[str, float] = field(default_factory=dict)
    fails: tuple[str, ...] = ()
    at_an_end: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()
    pads: dict[str, float] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    begun: dict[str, str | None] = field(default_factory=dict)

    def explanations(self) -> list[Hypothesis]:
        hypotheses = [Hypothesis(name=NONE, gain=0.0, misfit=self.none_leaves)]
        for name, gain in self.gains.items():
            fits = tuple(self.fits(part)[0] for part in name.split("+"))
            hypotheses.append(Hypothesis(name=name, gain=gain, misfit=TYPICAL, linear_fits=fits))
        return hypotheses

    def fits(self, name: str) -> list[SimpleNamespace]:
        if name not in self.pads:
            return [fit(name, self.gains.get(name, 10.0))]
        return [fit(name, gain, variant=of_pad(pad)) for pad, gain in self.pads.items() if pad != name]

    def refit(self, _forward, _linear, fits, first):
        name = "+".join(sorted(linear_fit.name for linear_fit in fits))
        self.asked.append(name)
        self.begun[name] = None if first is None else first.name
        variants = tuple(linear_fit.signature.variant for linear_fit in fits)
        pad = "".join(variant.pad for variant in variants)
        if {name, pad} & set(self.fails):
            raise FemFailure(FemProblem.NOT_CONVERGED, "no such flesh")
        return SimpleNamespace(
            name=name,
            variants=variants,
            log_evidence=self.evidence.get(pad or name, self.gains.get(name, 5.0)),
            converged=name not in self.lost,
            at_an_end=tuple(linear_fit.name in self.at_an_end for linear_fit in fits),
            fit=SimpleNamespace(chi2=self.left.get(name, TYPICAL)),
        )


@pytest.fixture
def selected(monkeypatch):
    def of(case: Round, *, p_value: float = 0.0) -> ModelSelection:
        monkeypatch.setattr(
            model_selection,
            "all_explanations",
            lambda _, in_full: [in_full.get(each.name, each) for each in case.explanations()],
        )
        monkeypatch.setattr(model_selection, "refit", case.refit)
        monkeypatch.setattr(model_selection, "_gain", lambda _, again: again.log_evidence)
        fits = [linear_fit for name in case.gains if name in BY_NAME for linear_fit in case.fits(name)]
        linear = SimpleNamespace(numbers=1, null=SimpleNamespace(log_evidence=0.0), linear_fits=fits)
        return select_model(SimpleNamespace(workers=1), linear, p_value=p_value)  # type: ignore[arg-type]

    return of


def test_effects_that_gain_nearly_as_much_are_refitted_and_no_others(selected):
    case = Round({"skin": 30.0, "slip": 20.0, "damage": 16.0, "stiffening": 14.0})
    selection = selected(case)
    assert selection.verdict == "skin"
    assert sorted(case.asked) == ["damage", "skin", "slip"]
    refits = {hypothesis.name: hypothesis.refit for hypothesis in selection.ranking}
    assert refits["skin"]
    assert refits["stiffening"] is None


def test_what_an_effect_gains_by_its_full_model_counts(selected):
    """Both ways: the best signature's model gains less, or another one's more."""
    gains = {"skin": 30.0, "slip": 20.0}
    for evidence in ({"skin": 10.0}, {"slip": 40.0}):
        selection = selected(Round(gains, evidence=evidence))
        assert selection.verdict == "slip"
        ranking = {hypothesis.name: hypothesis.gain for hypothesis in selection.ranking}
        assert ranking["skin"] == evidence.get("skin", 30.0)


def test_what_comes_into_the_verdict_later_is_refitted_then(selected):
    """A weaker effect, once the others gain less in full."""
    names = ("skin", "slip")
    case = Round(dict.fromkeys(names, 30.0) | {"clock_lag": 14.0}, evidence=dict.fromkeys(names, 2.0))
    selection = selected(case)
    assert selection.verdict == "clock_lag"
    assert case.asked[-1] == "clock_lag"


def test_nothing_is_refitted_where_no_mismatch_is_likeliest(selected):
    case = Round({"skin": 0.0}, none_leaves=TYPICAL)
    assert selected(case, p_value=0.3).verdict == NONE
    assert case.asked == []


def test_a_likely_effect_that_is_not_detected_stands_beside_none(selected):
    case = Round({"skin": 30.0})
    assert selected(case, p_value=0.3).verdict == ("skin", NONE)
    assert case.asked == ["skin"]


def test_an_explanation_without_a_full_model_is_dropped_and_said(selected):
    case = Round({"skin": 20.0, "slip": 19.0}, fails=("skin",))
    selection = selected(case)
    assert selection.verdict == "slip"
    assert selection.without == {"skin": "no such flesh"}
    assert sorted(case.asked) == ["skin", "slip"]
    assert "skin" not in [hypothesis.name for hypothesis in selection.ranking]


def test_unknown_physics_may_resemble_an_explanation_without_a_full_model(selected):
    """300 nats do not vanish with it: neither none nor a weak effect stands in."""
    assert selected(Round({"skin": 300.0, "slip": 15.0}, fails=("skin",))).verdict == "unknown"


def test_a_pair_whose_second_effect_ends_at_its_bounds_is_dropped(selected):
    case = Round({"skin": 20.0, "skin+slip": 24.0, "slip": 1.0}, at_an_end=("slip",))
    selection = selected(case)
    assert selection.verdict == "skin"
    assert selection.without == {"skin+slip": model_selection.AT_AN_END}
    single = selected(Round({"slip": 20.0}, at_an_end=("slip",)))
    assert single.verdict == "slip"


def test_what_a_full_model_leaves_counts(selected):
    """The best signature's full model explains nothing, so that the second is likelier."""
    selection = selected(Round({"skin": 30.0, "slip": 26.0}, left={"skin": 3 * MISFIT}))
    assert selection.ranking[0].name == "slip"


def test_so_many_are_refitted_at_most(selected):
    """Also where all models are poor, so that others come up in the ranking."""
    names = list(BY_NAME)[: MOST_REFITS + 1]
    for left in (TYPICAL, 3 * MISFIT):
        case = Round(dict.fromkeys(names, 30.0), left=dict.fromkeys(names, left))
        selected(case)
        assert len(case.asked) == MOST_REFITS


def test_other_pads_share_the_probability_by_their_full_models(selected):
    case = Round(
        {"sensor_gain": 30.0},
        pads={"sensor_gain": 0.0, "left": 12.0, "right": 11.0},
        evidence={"left": 5.0, "right": 5.0 + 1.5 * np.log(3.0)},
    )
    first = selected(case).ranking[0]
    assert first.refit.variants == (of_pad("right"),)
    ((share, other),) = first.alternatives
    assert share == pytest.approx(1 / 4)
    assert other.variants == (of_pad("left"),)


def gain_of_pads(selected, evidence: dict[str, float], *, right: float = 45.0, **more) -> float:
    """Of an effect whose signature gains 100 on the left pad and `right` on the other."""
    pads = {"sensor_gain": 0.0, "left": 100.0, "right": right}
    selection = selected(Round({"sensor_gain": 100.0}, pads=pads, evidence=evidence, **more))
    return next(each.gain for each in selection.ranking if each.name == "sensor_gain")


def test_a_pad_without_a_full_model_gains_no_more_than_the_best_in_full(selected):
    assert gain_of_pads(selected, {"left": 20.0}) == pytest.approx(20.0)
    assert gain_of_pads(selected, {"left": 80.0}) == pytest.approx(80.0 - np.log(2.0))


def test_a_pad_whose_model_fails_gains_nothing(selected):
    gain = gain_of_pads(selected, {"right": 30.0}, right=60.0, fails=("left",))
    assert gain == pytest.approx(30.0 - np.log(2.0))


def test_a_search_that_did_not_converge_costs_an_effect_nothing(selected):
    evidence = {"skin": 10.0}
    assert selected(Round({"skin": 30.0, "slip": 20.0}, evidence=evidence)).verdict == "slip"
    assert selected(Round({"skin": 30.0, "slip": 20.0}, evidence=evidence, lost=("skin",))).verdict == "skin"


def test_pairs_wait_for_the_single_effects(selected):
    """However many there are: the full model of the first may leave nothing for a second."""
    others = [name for name in BY_NAME if name != "skin"][: MOST_REFITS + 1]
    case = Round({"skin": 40.0} | {f"skin+{name}": 60.0 for name in others})
    selected(case)
    assert case.asked[0] == "skin"
    assert len(case.asked) == MOST_REFITS
    assert case.begun == dict.fromkeys(case.asked, "skin") | {"skin": None}, "pairs begin at its model"


@pytest.mark.parametrize("better", ["left", "right"])
def test_a_pair_gains_what_its_best_pad_gains(selected, better):
    case = Round(
        {"skin": 40.0, "sensor_gain": 13.0, "skin+sensor_gain": 60.0},
        pads={"sensor_gain": 0.0, "left": 12.0, "right": 11.0},
        evidence={"left": 20.0, "right": 20.0, better: 55.0},
    )
    pair = next(each for each in selected(case).ranking if each.name == "skin+sensor_gain")
    assert pair.gain == 55.0
