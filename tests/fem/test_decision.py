"""The finder's decision and the selection of models: Bayes factors against quadrature, verdict sets."""

import ast
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest, norm

from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch import effect_spec
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.evidence.model_error import NullDraws, ScalePrior
from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.result import NONE
from fem.mismatch.selection import decision, model_selection
from fem.mismatch.selection.decision import (
    FREEDOM,
    MISFIT,
    OUTSIDE,
    TEMPERATURE,
    Detection,
    Weighed,
    credible_set,
    detection,
    log_prior,
    probabilities,
)
from fem.mismatch.selection.grasp_explanations import Hypothesis
from fem.mismatch.selection.model_selection import MOST_REFITS, ModelSelection, select_model
from fem.mismatch.signature_variant import ONE_WAY, of_pad


def equations(rng: np.random.Generator, *, injected: float = 0.0) -> SignatureEquations:
    """Six signature columns of four effects in 400 numbers with unit noise; `injected` of the first."""
    fields = rng.normal(size=(400, 6))
    fields[:, 1] = 0.8 * fields[:, 0] + 0.6 * fields[:, 1]
    data = injected * fields[:, 0] + rng.normal(size=400)
    return SignatureEquations(
        normal=fields.T @ fields,
        right=fields.T @ data,
        sd=np.array([1.0, 2.0, 0.5, 1.0, 1.0, 1.0]),
        positive=np.array([False, True, False, False, True, False]),
        least=np.zeros(6),
        measured=np.zeros(6),
        ways={
            "skin": [(0,)],
            "slip": [(1,), (2,)],
            "pit_offset": [(3, 5)],
            "damage": [(4,)],
            "none here": [],
        },
    )


@pytest.mark.parametrize(("name", "column"), [("skin", 0), ("damage", 4)])
def test_a_bayes_factor_is_that_of_quadrature(name, column):
    """Integral of likelihood over prior, half a normal one where the amount is positive."""
    case = equations(np.random.default_rng(3), injected=0.1)
    normal, right, sd = case.normal[column, column], case.right[column], case.sd[column]

    def integrand(amount: float) -> float:
        return float(np.exp(right * amount - normal * amount**2 / 2) * norm.pdf(amount, scale=sd))

    low = 0.0 if case.positive[column] else -6 * sd
    integral, _ = quad(integrand, low, 6 * sd, points=[max(right / normal, low)], limit=200)
    expected = np.log(integral * (2.0 if case.positive[column] else 1.0))
    assert case.log_bayes_factors(case.right[None])[name][0] == pytest.approx(expected, abs=1e-6)


def test_alternatives_of_one_effect_share_its_prior():
    case = equations(np.random.default_rng(4), injected=0.3)
    both = case.log_bayes_factors(case.right[None])["slip"][0]
    alone = [
        SignatureEquations(
            normal=case.normal,
            right=case.right,
            sd=case.sd,
            positive=case.positive,
            least=case.least,
            measured=case.measured,
            ways={"slip": [way]},
        ).log_bayes_factors(case.right[None])["slip"][0]
        for way in case.ways["slip"]
    ]
    assert both == pytest.approx(np.log(np.mean(np.exp(alone))))


HEAVY, SURE = ScalePrior(size=0.7, freedom=3.0), ScalePrior(size=1.0, freedom=1e6)


def with_error(
    rng: np.random.Generator, prior: ScalePrior, *, sd: float
) -> tuple[SignatureEquations, NullDraws]:
    """Data of noise and of the model's error of a drawn scale; the equations have its usual size integrated
    out (GramMatrix.marginal).
    """
    bare = equations(rng)
    amounts = prior.drawn(1, rng) * sd * rng.standard_normal(6)
    bare = replace(bare, right=bare.right + bare.normal @ amounts)
    taken = bare.normal @ np.linalg.inv(bare.normal + np.eye(6) / sd**2)
    usual = replace(bare, normal=bare.normal - taken @ bare.normal, right=bare.right - taken @ bare.right)
    return usual, NullDraws(bare=bare, error_sd=np.full(6, sd), prior=prior)


def no_error(case: SignatureEquations) -> NullDraws:
    return NullDraws(bare=case, error_sd=np.zeros(len(case.sd)), prior=SURE)


def p_of(case: SignatureEquations, rng: np.random.Generator, **statistics: float) -> Detection:
    return detection(case, no_error(case), rng=rng, **statistics)


@pytest.mark.parametrize("sd", [0.0, 0.2])
def test_p_values_of_recordings_without_mismatch_are_even(sd):
    """Both statistics drawn by their own distributions: 5 % below 0.05 within three standard deviations."""
    rng = np.random.default_rng(5)
    p = []
    for _ in range(300):
        usual, draws = with_error(rng, HEAVY, sd=max(sd, 1e-6))
        misfit = MISFIT * rng.chisquare(FREEDOM) / FREEDOM
        p.append(detection(usual, draws, misfit=misfit, direct=0.0, rng=rng).p_value)
    assert kstest(p, "uniform").pvalue > 0.01
    assert abs(np.mean(np.array(p) < 0.05) - 0.05) < 3 * np.sqrt(0.05 * 0.95 / len(p))


def test_draws_of_a_sure_scale_have_the_covariance_of_the_equations():
    """With the usual error integrated out, the covariance of b is N."""
    rng = np.random.default_rng(8)
    usual, draws = with_error(rng, SURE, sd=0.2)
    covariance = np.cov(draws.drawn(100_000, rng).T)
    np.testing.assert_allclose(covariance, usual.normal, atol=0.03 * np.diag(usual.normal).max())


def test_a_scale_without_bounds_makes_large_errors_usual():
    """An apparent amount of six usual errors is rare at a sure scale and not at the heavy one."""
    rng = np.random.default_rng(9)
    usual, sure = with_error(rng, SURE, sd=0.2)
    odd = replace(usual, right=6 * 0.2 * usual.normal[:, 0])
    p = [
        detection(odd, replace(sure, prior=prior), misfit=MISFIT, direct=0.0, rng=rng).p_values["effects"]
        for prior in (SURE, HEAVY)
    ]
    assert p[0] < 0.002 < 0.01 < p[1]


def test_what_speaks_against_an_effect_raises_p():
    """Slip resembles the injected skin."""
    case = equations(np.random.default_rng(10), injected=0.25)
    doubted = {
        name: [-20.0 if name in ("skin", "slip") else 0.0] * len(ways) for name, ways in case.ways.items()
    }
    p = [
        p_of(case, np.random.default_rng(1), misfit=MISFIT, direct=0.0, against=against).p_values["effects"]
        for against in (None, doubted)
    ]
    assert p[0] < 0.01 < p[1]


def test_an_amount_without_meaning_gains_nothing():
    case = equations(np.random.default_rng(11), injected=0.5)
    column = SignatureEquations(
        normal=case.normal, right=case.right, sd=case.sd, positive=np.ones(6, dtype=bool),
        least=np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]), measured=np.zeros(6), ways={"skin": [(0,)]},
    )  # fmt: skip
    assert column.log_bayes_factors(case.right[None])["skin"][0] == 0.0
    enough = replace(column, least=np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert enough.log_bayes_factors(case.right[None])["skin"][0] > 10.0


def test_a_injected_effect_a_large_misfit_and_direct_marks_are_each_detected():
    rng = np.random.default_rng(6)
    usual = {"misfit": MISFIT, "direct": 0.0}
    assert p_of(equations(rng, injected=0.5), rng, **usual).p_values["effects"] < 0.005
    assert p_of(equations(rng), rng, misfit=3 * MISFIT, direct=0.0).p_value < 1e-4
    test = p_of(equations(rng), rng, misfit=MISFIT, direct=10.0)
    assert test.p_values["gel"] == pytest.approx(np.exp(-10.0))
    assert test.p_value == pytest.approx(3 * np.exp(-10.0), rel=1e-3)


def weighed(
    *explanations: tuple[str, float, float], direct: float = 0.0, read_correctly: float | None = None
) -> dict[str, float]:
    """Probabilities of (name, gain, misfit over MISFIT), and of "unknown"."""
    of_effects = {"direct": direct, "read_correctly": read_correctly}
    known = [
        Weighed(name=name, gain=gain, misfit=ratio * MISFIT, **({} if name == NONE else of_effects))
        for name, gain, ratio in explanations
    ]
    shares, unknown = probabilities(known)
    probability = dict(zip([name for name, _, _ in explanations], shares, strict=True)) | {"unknown": unknown}
    assert sum(probability.values()) == pytest.approx(1.0)
    return probability


def test_without_gain_and_with_the_usual_misfit_there_is_most_likely_no_mismatch():
    probabilities_of = weighed((NONE, 0.0, 1.0), *((f"effect {k}", -1.0 + 0.1 * k, 1.0) for k in range(20)))
    assert (
        probabilities_of[NONE]
        > max(probability for name, probability in probabilities_of.items() if name != NONE) * 5
    )


def test_an_effect_that_gains_and_leaves_little_is_named():
    probabilities_of = weighed((NONE, 0.0, 3.0), ("skin", 40.0, 1.1), ("slip", 10.0, 2.5))
    assert probabilities_of["skin"] > 0.95


def test_a_large_misfit_that_no_effect_explains_is_unknown():
    probabilities_of = weighed((NONE, 0.0, 20.0), ("skin", 12.0, 19.8), ("slip", 3.0, 20.0))
    assert probabilities_of["unknown"] > 0.8
    assert probabilities_of[NONE] < 1e-3


def test_what_recordings_show_directly_cannot_be_unknown_physics():
    without = weighed((NONE, 0.0, 8.0), ("adhesion", 30.0, 7.9))
    directly = weighed((NONE, 0.0, 8.0), ("adhesion", 30.0, 7.9), direct=30.0)
    assert without["unknown"] > 0.5 > directly["unknown"]


@pytest.mark.parametrize("flesh", [10.0, 0.0, -20.0])
def test_the_flesh_separates_a_faulty_reading_from_a_gel_that_truly_behaves_so(flesh):
    """Where the flesh is indifferent, the odds are those of the catalogue to half of the physics outside."""
    direct, case = 60.0, [(NONE, 0.0, 1.0), ("sensor_nonlinear", 60.0 + flesh, 1.0)]
    probability = weighed(*case, direct=direct, read_correctly=direct)
    ratio = 2 * (1 - OUTSIDE) / OUTSIDE * np.exp(flesh / TEMPERATURE)
    assert probability["sensor_nonlinear"] / probability["unknown"] == pytest.approx(ratio, rel=1e-6)
    assert probability[NONE] < 1e-6
    assert weighed(*case, direct=direct)["sensor_nonlinear"] > 0.99


def test_a_gel_that_truly_behaves_so_beside_another_effect_is_no_faulty_reading():
    """A skin gains 100, the gel's relation shows 60, and the flesh denies the faulty reading by 20."""
    case = [
        Weighed(name=NONE, gain=0.0, misfit=MISFIT),
        Weighed(name="skin", gain=100.0, misfit=MISFIT),
        Weighed(name="sensor_nonlinear", gain=40.0, direct=60.0, read_correctly=60.0, misfit=MISFIT),
        Weighed(name="sensor_nonlinear+skin", gain=140.0, direct=60.0, read_correctly=160.0, misfit=MISFIT),
    ]
    shares, unknown = probabilities(case)
    assert unknown > 0.99
    assert max(shares) < 0.01


def test_a_pair_needs_more_than_a_single_effect():
    """By the number of pairs: at equal gain the single is likelier by the ratio of the priors."""
    probabilities_of = weighed((NONE, 0.0, 3.0), ("skin", 40.0, 1.0), ("skin+slip", 40.0, 1.0))
    assert probabilities_of["skin"] / probabilities_of["skin+slip"] == pytest.approx(
        np.exp(log_prior("skin", effects=1) - log_prior("skin+slip", effects=1))
    )


def test_the_verdict_is_the_smallest_set_that_holds_the_probability():
    assert credible_set(["a", "b", "c"], [0.96, 0.03, 0.01]) == ("a",)
    assert credible_set(["a", "b", "c"], [0.1, 0.6, 0.3]) == ("b", "c", "a")
    assert credible_set(["a", "b"], [0.5, 0.45]) == ("a", "b")


def test_an_effect_stands_for_pairs_that_hold_it_and_a_pair_for_itself_alone():
    assert credible_set(["a", "a+b", "c"], [0.6, 0.36, 0.04]) == ("a",)
    assert credible_set(["a+b", "a", "c"], [0.6, 0.36, 0.04]) == ("a+b", "a")


def test_at_most_twelve_numbers_decide():
    """Numbers of the module's constants, and the error of laws; draws bound the time, not the answer."""
    decides = {decision.__file__: lambda name: name != "DRAWS", effect_spec.__file__: "LAW_ERROR".__eq__}
    decide = [
        node
        for path, counts in decides.items()
        for node in ast.parse(Path(path).read_text("utf-8")).body
        if isinstance(node, ast.Assign | ast.AnnAssign) and counts(ast.unparse(node).split()[0])
    ]
    numbers = [
        leaf
        for node in decide
        for leaf in ast.walk(node)
        if isinstance(leaf, ast.Constant) and isinstance(leaf.value, int | float)
    ]
    assert 8 <= len(numbers) <= 12


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
    assert selected(case).verdict == "clock_lag"
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
    """The evidence of 300 nats remains: the verdict is not "none" and not a weak effect."""
    assert selected(Round({"skin": 300.0, "slip": 15.0}, fails=("skin",))).verdict == "unknown"


def test_a_pair_whose_second_effect_ends_at_its_bounds_is_dropped(selected):
    case = Round({"skin": 20.0, "skin+slip": 24.0, "slip": 1.0}, at_an_end=("slip",))
    selection = selected(case)
    assert selection.verdict == "skin"
    assert selection.without == {"skin+slip": model_selection.AT_AN_END}
    assert selected(Round({"slip": 20.0}, at_an_end=("slip",))).verdict == "slip"


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
