"""Explanations: pairs against dense Gaussian evidence, which are refitted, and what they say of E."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from injected_mismatch import injected_case, linear_and_refitted
from pinched_case_model import COMPLIANCE, model_of
from plain_model import screened_effects
from scipy.stats import multivariate_normal, norm
from test_mismatch_core_measurement import given_way

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.effect import Signature
from fem.mismatch.effect_spec import LAW_ERROR, EffectParameter
from fem.mismatch.effects import anisotropy, damage, gripper_compliance, skin, soft_spot
from fem.mismatch.evidence.linear_evidence import GramMatrix
from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.procedure import ACROSS, SPEEDS, TURNED, TWICE, next_grasp
from fem.mismatch.reported_values import _ninety
from fem.mismatch.result import NINETY, NONE, UNKNOWN, HeldOut, Modulus, mixture
from fem.mismatch.selection import grasp_explanations
from fem.mismatch.selection.grasp_explanations import Hypothesis, all_explanations
from fem.mismatch.selection.modulus_with import SYSTEMATIC, _relation_sd, modulus_of, modulus_with
from fem.mismatch.selection.refinement import Refit, refit
from fem.mismatch.selection.reported_modulus import modulus_by, reported_modulus
from fem.mismatch.selection.screening import LinearRound, linear_round
from fem.mismatch.signature_variant import ONE_WAY

BY_NAME = {effect.spec.name: effect for effect in EFFECTS}
NUMBERS, SD = 60, 0.5
MEASURED = np.array([0.2, -0.1, 0.3])
"""Prior means of the amounts."""
NAMES = ("skin", "anisotropy", "gripper_compliance")


def fields(rng: np.random.Generator) -> np.ndarray:
    """Three columns of which the first two resemble each other."""
    drawn = rng.normal(size=(3, NUMBERS))
    drawn[1] = 0.7 * drawn[0] + 0.7 * drawn[1]
    return drawn


def equations(columns: np.ndarray, data: np.ndarray) -> SignatureEquations:
    return SignatureEquations(
        normal=columns @ columns.T,
        right=columns @ data,
        sd=np.full(len(columns), SD),
        positive=np.zeros(len(columns), dtype=bool),
        least=np.zeros(len(columns)),
        measured=MEASURED[: len(columns)],
        ways={name: [(k,)] for k, name in enumerate(NAMES)},
    )


def dense_evidence(
    data: np.ndarray, columns: np.ndarray, chosen: Sequence[int] = (), *, noise: float = 1.0
) -> float:
    """ln p of the data with Gaussian amounts of the chosen columns integrated out."""
    fields, mean = columns[list(chosen)], MEASURED[list(chosen)]
    covariance = noise * np.eye(len(data)) + SD**2 * fields.T @ fields
    return float(multivariate_normal.logpdf(data, mean=mean @ fields, cov=covariance))


def added(case: SignatureEquations, columns: tuple[int, ...]) -> float:
    return float(case.log_bayes_factor(columns, case.right[None])[0])


def test_a_second_signature_adds_what_dense_evidence_says():
    rng = np.random.default_rng(1)
    columns = fields(rng)
    data = 0.8 * columns[0] + 0.3 * columns[1] + rng.normal(size=NUMBERS)
    remaining, _ = equations(columns, data).given((0,))
    for second in (1, 2):
        expected = dense_evidence(data, columns, (0, second)) - dense_evidence(data, columns, (0,))
        assert added(remaining, (second,)) == pytest.approx(expected, abs=1e-9)


def test_more_noise_makes_evidence_weaker_as_dense_evidence_says():
    rng = np.random.default_rng(2)
    columns = fields(rng)
    data = 0.5 * columns[2] + rng.normal(size=NUMBERS)
    expected = dense_evidence(data, columns, (2,), noise=3.0) - dense_evidence(data, columns, noise=3.0)
    case = equations(columns, data)
    noisy = case.log_bayes_factor((2,), case.right[None], noise=3.0)
    assert float(noisy[0]) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0])
def test_a_signature_resembles_errors_of_a_law_by_its_energy_in_their_space(share):
    """`share` of a signature's energy is in the space of the errors, which are redundant and of any size. A
    nuisance absorbs the last error up to round-off.
    """
    axes = np.linalg.qr(np.random.default_rng(7).normal(size=(NUMBERS, 5)))[0].T
    errors = np.array([3.0 * axes[0], axes[0] + 5.0 * axes[1], axes[1], 1e-9 * axes[3]])
    columns = np.array([np.sqrt(share) * axes[1] + np.sqrt(1 - share) * axes[2], axes[3], axes[4]])
    alone = replace(equations(columns, columns[0]), ways={"skin": [(0,)], "anisotropy": [[0, 1]]})
    energy = np.full(len(errors), 30.0)
    given = alone.given_law(errors @ errors.T, columns @ errors.T, energy=energy)
    assert alone.resemblance[(0,)] == 1.0, "not known"
    assert given.resemblance[(0,)] == pytest.approx(share, abs=1e-6)
    assert given.resemblance[(0, 1)] == pytest.approx(share, abs=1e-6), "in the most similar direction"


def test_amounts_are_posterior_means():
    rng = np.random.default_rng(3)
    columns = fields(rng)
    data = 0.8 * columns[0] + rng.normal(size=NUMBERS)
    two, mean = columns[[0, 2]], MEASURED[[0, 2]]
    covariance = np.eye(NUMBERS) + SD**2 * two.T @ two
    dense = mean + SD**2 * two @ np.linalg.solve(covariance, data - mean @ two)
    np.testing.assert_allclose(equations(columns, data).amounts((0, 2)), dense, rtol=1e-9)


def round_of(
    amounts: tuple[float, ...],
    *,
    seed: int = 4,
    numbers: int = 4000,
    direct: float = 0.0,
    names: Sequence[str] = NAMES,
) -> LinearRound:
    """A linear round of the three effects `names`; the last one's amount is positive a priori. `direct`:
    direct evidence of the second.
    """
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(4, numbers))
    data = np.array([0.0, *amounts]) @ columns + rng.normal(size=numbers)
    rows = np.vstack([data, columns])
    regressors = [
        Regressor(name=name, sd=3.0 if name == "1/E" else 1.0, fields=(), positive=name == names[2])
        for name in ("1/E", *names)
    ]
    return linear_round(
        GramMatrix.from_products(regressors, [np.arange(4)], [rows @ rows.T]),
        (),
        [
            (BY_NAME[name], Signature(variant=ONE_WAY, columns=(regressors[k],)), (k,))
            for k, name in enumerate(names, 1)
        ],
        auxiliary=lambda effect, *_: (0.0, direct if effect.spec.name == names[1] else 0.0),
        surface_sd={},
        without={},
        numbers=numbers,
    )


def by_name(linear: LinearRound) -> dict[str, Hypothesis]:
    return {explanation.name: explanation for explanation in all_explanations(linear)}


def test_a_law_that_is_not_exact_hides_a_second_effect_of_less_than_its_error():
    """Equal signals are beyond a share of LAW_ERROR of one another; less than it is not."""
    equal = by_name(round_of((0.3, 0.3, 0.0)))
    pair = equal["anisotropy+skin"]
    assert pair.gain > max(equal[name].gain for name in NAMES) + 3
    assert pair.gain + pair.hidden > max(equal[name].gain + equal[name].hidden for name in NAMES) + 3
    weak = by_name(round_of((1.0, 0.8 * LAW_ERROR, 0.0)))
    pair, single = weak["anisotropy+skin"], weak["skin"]
    assert pair.gain > single.gain + 10, "if the law were exact"
    assert pair.gain + pair.hidden < single.gain + single.hidden + 3


def test_no_evidence_is_hidden_where_laws_are_exact(monkeypatch):
    monkeypatch.setattr(grasp_explanations, "LAW_ERROR", 0.0)
    assert max(abs(each.hidden) for each in all_explanations(round_of((1.0, 0.3, 0.2)))) < 1e-9


@pytest.mark.parametrize("resembles", [True, False])
def test_the_error_of_a_law_hides_a_second_effect_that_resembles_it(resembles):
    """Beside a full model of the first. The second signal is a seventieth of the first one."""
    linear = round_of((0.3, 0.3, 0.0))
    first = by_name(linear)["anisotropy"]
    rng = np.random.default_rng(5)
    columns = rng.normal(size=(3, 4000))
    error = columns[:1] if resembles else rng.normal(size=(1, 4000))
    others = replace(
        linear.equations,
        normal=columns @ columns.T,
        right=columns @ (0.12 * columns[0] + rng.normal(size=4000)),
    ).given_law(error @ error.T, columns @ error.T, energy=np.ones(1))
    refit = SimpleNamespace(others=others, signal=4000.0)
    in_full = {"anisotropy": replace(first, gain=first.gain + 400.0, refit=refit)}
    known = {each.name: each for each in all_explanations(linear, in_full)}
    pair, single = known["anisotropy+skin"], known["anisotropy"]
    exact = added(others, (0,))
    assert pair.gain - single.gain == pytest.approx(exact)
    assert exact > 10
    beyond = pair.gain + pair.hidden - single.gain - single.hidden
    assert beyond < 1 if resembles else beyond > 0.9 * exact


def test_direct_evidence_for_a_second_effect_is_not_hidden():
    """The pair's lead over its first effect grows by all of it."""
    lead = []
    for direct in (0.0, 60.0):
        known = by_name(round_of((1.0, 0.3, 0.0), direct=direct))
        pair, single = known["anisotropy+skin"], known["skin"]
        lead.append(pair.gain + pair.hidden - single.gain - single.hidden)
    assert lead[1] - lead[0] == pytest.approx(60.0, abs=1.0)


@pytest.mark.parametrize(
    ("names", "apart"), [(NAMES, False), (("gel_creep", "sensor_nonlinear", "skin"), True)]
)
def test_two_faults_of_a_gel_relation_make_no_pair_and_hide_nothing_from_each_other(names, apart):
    linear = round_of((1.0, 0.3, 0.0), names=names)
    known = by_name(linear)
    law = grasp_explanations._law(linear, known[names[0]])
    assert ("+".join(sorted(names[:2])) not in known) == apart
    assert (names[1] not in grasp_explanations._hidden(law.equations, {names[0]: law})) == apart


def test_an_effect_of_the_wrong_sign_is_no_second_one():
    assert "gripper_compliance+skin" in by_name(round_of((0.3, 0.0, 0.3)))
    assert "gripper_compliance+skin" not in by_name(round_of((0.3, 0.0, -0.3)))


def test_each_explanation_leaves_its_own_misfit():
    """Data of unit noise: with the true effects the chi-square per number is one."""
    explanations = by_name(round_of((0.5, 0.0, 0.4)))
    assert explanations["none"].misfit == pytest.approx(1 + 0.5**2 + 0.4**2, rel=0.05)
    assert explanations["skin"].misfit == pytest.approx(1 + 0.4**2, rel=0.05)
    assert explanations["gripper_compliance+skin"].misfit == pytest.approx(1.0, rel=0.05)
    thinned = by_name(replace(round_of((0.5, 0.0, 0.4)), numbers=2 * 4000))
    assert thinned["skin"].misfit == pytest.approx(explanations["skin"].misfit / 2)


@pytest.mark.parametrize("left", [0.0, 0.3])
def test_beside_a_full_model_a_second_effect_counts_by_what_that_model_leaves(left):
    """A signature leaves what is not in proportion to it; the second effect must not be named for that."""
    linear = round_of((0.3, 0.3, 0.0))
    first = by_name(linear)["anisotropy"]
    rng = np.random.default_rng(5)
    columns = rng.normal(size=(3, 4000))
    others = replace(
        linear.equations,
        normal=columns @ columns.T,
        right=columns @ (left * columns[0] + rng.normal(size=4000)),
    )
    signal = 500.0
    refit = SimpleNamespace(others=others, signal=signal)
    in_full = {"anisotropy": replace(first, gain=first.gain + 100.0, refit=refit)}
    pair = {each.name: each for each in all_explanations(linear, in_full)}.get("anisotropy+skin")
    if left:
        assert pair.gain == pytest.approx(first.gain + 100.0 + added(others, (0,)))
        drop = others.right[0] ** 2 / (others.normal[0, 0] + others.sd[0] ** -2.0)
        assert pair.misfit == pytest.approx(first.misfit - drop / linear.numbers)
        for more in (5.0, -5.0):
            refitted = replace(pair, gain=pair.gain + more, misfit=0.5, refit=refit)
            again = all_explanations(linear, in_full | {pair.name: refitted})
            bounded = replace(refitted, gain=pair.gain + min(more, 0.0))
            assert next(each for each in again if each.name == pair.name) == bounded
    else:
        assert pair is None


PLAIN = Modulus(value=0.4, sd=0.004)
Z = norm.ppf(0.95)


def explanation(
    name: str, probability: float, *, E: float | None = None, change: tuple[float, float] | None = None
) -> tuple[Hypothesis, Modulus | None]:
    """`E` by a refit; `change` (ratio, added spread) by a linear signature."""
    refit = None if E is None else SimpleNamespace()
    known = {"refit": refit, "modulus_change": change}
    hypothesis = Hypothesis(name=name, gain=0.0, probability=probability, **known)
    return hypothesis, None if E is None else Modulus(value=E, sd=0.01)


def reported(
    *explanations: tuple[Hypothesis, Modulus | None], verdict: str = "skin", heldout: HeldOut | None = None
) -> Modulus:
    weighed = [(known.probability, modulus_by(known, E, PLAIN, heldout)) for known, E in explanations]
    return reported_modulus(verdict, weighed, PLAIN)


def test_without_a_mismatch_E_is_the_plain_models() -> None:
    modulus = reported(explanation(NONE, 1.0))
    assert (modulus.value, modulus.sd) == (PLAIN.value, pytest.approx(PLAIN.sd))


def test_an_effect_that_was_not_detected_widens_E_and_does_not_move_it() -> None:
    """By hand: 0.2 of the upper component, which has a quarter of the probability, lie above the interval."""
    modulus = reported(explanation(NONE, 0.75), explanation("skin", 0.25, E=0.5), verdict=NONE)
    assert modulus.value == PLAIN.value
    assert modulus.sd * Z == pytest.approx(0.5 + 0.01 * norm.ppf(0.8) - PLAIN.value)


def test_explanations_share_E_by_their_probabilities() -> None:
    """Two components of probability 3/4 and 1/4, 0.1 apart: mean and quantiles of the mixture, by hand."""
    modulus = reported(explanation("skin", 0.6, E=0.3), explanation("poisson_ratio", 0.2, E=0.4))
    assert modulus.value == pytest.approx(0.325)
    assert modulus.sd * Z == pytest.approx(0.4 + 0.01 * norm.ppf(0.8) - modulus.value)


def test_an_explanation_of_little_weight_hardly_widens_E() -> None:
    """The standard deviation of this mixture would be five times as large."""
    modulus = reported(explanation("skin", 0.975, E=0.4), explanation(UNKNOWN, 0.025))
    assert 0.01 < modulus.sd < 0.0115


def test_an_interval_holds_nine_tenths_of_draws() -> None:
    rng = np.random.default_rng(1)
    weights, values, sds = [0.5, 0.3, 0.2], np.array([1, 1.3, 0.6]), np.array([0.1, 0.2, 0.05])
    component = rng.choice(3, size=100_000, p=weights)
    drawn = values[component] + sds[component] * rng.normal(size=len(component))
    modulus = mixture(weights, [Modulus(value=v, sd=s) for v, s in zip(values, sds, strict=True)])
    low, high = np.quantile(drawn, [0.05, 0.95])
    assert modulus.value == pytest.approx(drawn.mean(), abs=3e-3)
    assert modulus.sd * Z == pytest.approx(max(high - modulus.value, modulus.value - low), rel=0.01)


def test_an_effect_that_was_not_refitted_counts_by_its_linear_signature() -> None:
    """By hand: none with 0.4, an effect with 0.5 and 10 % more spread, at odds of 3 to 1."""
    modulus = reported(explanation(NONE, 0.75), explanation("skin", 0.25, change=(1.25, 0.1)))
    sd_skin = math.hypot(1.25 * PLAIN.sd, 0.1 * 0.5)
    assert modulus.value == pytest.approx(0.425)
    high = modulus.value + modulus.sd * Z
    assert 0.75 * norm.cdf(high, 0.4, PLAIN.sd) + 0.25 * norm.cdf(high, 0.5, sd_skin) == pytest.approx(0.95)


@pytest.mark.parametrize(("rms", "spread"), [(0.015, 0.17), (0.05, 0.3)])
def test_unknown_physics_makes_E_uncertain_and_does_not_move_it(rms, spread) -> None:
    heldout = HeldOut(rms_before=rms, rms_after=rms, noise_rms=0.01)
    modulus = reported(explanation(UNKNOWN, 1.0), heldout=heldout)
    assert modulus.value == PLAIN.value
    assert modulus.sd == pytest.approx(math.hypot(PLAIN.sd, spread * PLAIN.value))


def test_an_explanation_without_an_E_leaves_the_plain_models() -> None:
    assert reported(explanation("skin", 1.0)) == PLAIN


@pytest.mark.parametrize(
    ("verdict", "asked"),
    [
        (NONE, None),
        ("viscoelastic", None),
        (("soft_spot", "sensor_gain"), TURNED),
        (("sensor_gain+skin", "skin"), TURNED),
        (("anisotropy", "poisson_ratio"), ACROSS),
        (("damage", "stiffening"), TWICE),
        (("plastic_set", "viscoelastic"), TWICE),
        (("viscoelastic", "drainage"), SPEEDS),
    ],
)
def test_the_first_difference_between_the_remaining_effects_decides(verdict, asked):
    assert next_grasp(verdict, grasps=4) == asked


def test_a_single_recording_asks_for_another():
    assert ACROSS in next_grasp("viscoelastic", grasps=1)


def test_the_unknown_asks_for_speeds_and_a_turned_fruit():
    asked = next_grasp(UNKNOWN, grasps=4)
    assert SPEEDS in asked
    assert TURNED in asked


SOFTER = 1.25
TRUTH = {"dmax": 0.35, "W0_over_E": 0.004}


@cache
def injected():
    """Flesh that is damaged, and softer than the plain model's by SOFTER."""
    model = model_of()
    truly = replace(model, compliance=SOFTER * COMPLIANCE)
    moved = truly.compliance * damage.EFFECT.respond(truly, TRUTH, ONE_WAY).unit[0]
    return model_of(moved - COMPLIANCE * model.grasps[0].tracks.unit_displacement)


def rounds(effects, *, workers: int = 1) -> LinearRound:
    return screened_effects(replace(injected(), workers=workers), effects)


@cache
def damage_refit() -> Refit:
    linear = rounds([damage.EFFECT])
    return refit(injected(), linear, (linear.best[0],))


def test_a_law_that_bends_comes_back_with_the_modulus_that_goes_with_it():
    assert damage_refit().model.compliance == pytest.approx(SOFTER * COMPLIANCE, rel=0.03)
    assert damage_refit().parameters[0]["dmax"] == pytest.approx(TRUTH["dmax"], rel=0.1)
    assert damage_refit().parameters[0]["W0_over_E"] == pytest.approx(TRUTH["W0_over_E"], rel=0.2)
    assert damage_refit().at_an_end == (False,)


def test_threads_change_no_number():
    effects = [damage.EFFECT, skin.EFFECT, soft_spot.EFFECT]
    serial, threaded = (rounds(effects, workers=workers) for workers in (1, 3))
    assert serial.null.log_evidence == threaded.null.log_evidence
    assert [shown.gain for shown in serial.linear_fits] == [shown.gain for shown in threaded.linear_fits]
    assert [shown.signature.variant for shown in serial.linear_fits] == [
        shown.signature.variant for shown in threaded.linear_fits
    ]


def test_beside_a_full_model_a_signature_explains_as_much_as_in_a_fit_of_both():
    linear = rounds([damage.EFFECT, skin.EFFECT])
    by_name = {shown.name: shown for shown in linear.best}
    first, second = by_name["damage"], by_name["skin"]
    again = refit(injected(), linear, (first,))
    _, drop = again.others.given(again.others.numbers(second.columns))
    products, chosen = linear.products.about(
        again.model,
        again.response,
        (*linear.nuisances, *second.columns),
        [again.products.columns[j] for j in again.slopes],
        signatures=first.columns,
    )
    assert drop == pytest.approx(again.fit.chi2 - products.fit(chosen).chi2, rel=1e-4)


def test_a_pair_begins_where_its_first_effect_ended():
    linear = rounds([damage.EFFECT, skin.EFFECT])
    by_name = {shown.name: shown for shown in linear.best}
    first, second = by_name["damage"], by_name["skin"]
    alone = refit(injected(), linear, (first,))
    pair = refit(injected(), linear, (first, second), first=alone)
    assert pair.fit.chi2 < alone.fit.chi2
    assert pair.parameters[0]["dmax"] == pytest.approx(alone.parameters[0]["dmax"], rel=0.05)


@pytest.mark.parametrize(
    ("effect", "truth"),
    [(anisotropy.EFFECT, {"axial": 0.1}), (skin.EFFECT, {"Et_over_E_mm": 0.1})],
    ids=["of either sign", "positive"],
)
def test_a_small_effect_has_the_same_evidence_by_its_signature_and_in_full(effect, truth):
    """The full model has the signature's prior. With one as wide as the bounds it loses 0.9 and 2.0."""
    model = model_of()
    changed = effect.respond(model, truth, ONE_WAY).change(model, 0).markers
    model = model_of(changed + np.random.default_rng(3).normal(scale=0.004, size=changed.shape))
    linear = screened_effects(model, [effect])
    again = refit(model, linear, (linear.best[0],))
    assert again.log_evidence - linear.null.log_evidence == pytest.approx(linear.best[0].gain, abs=0.4)


@pytest.fixture(scope="module")
def jaws() -> Refit:
    return linear_and_refitted(injected_case(given_way(0.4)), gripper_compliance.EFFECT)[2]


@pytest.fixture(scope="module")
def thick_skin() -> Refit:
    model = model_of()
    unit = skin.EFFECT.respond(model, {"Et_over_E_mm": 6.0}, ONE_WAY).unit[0]
    injected = model_of(model.compliance * (unit - model.grasps[0].tracks.unit_displacement))
    linear = screened_effects(injected, [skin.EFFECT])
    return refit(injected, linear, (linear.best[0],))


def asked(again: Refit, share: float) -> float:
    """d ln E / d parameter (of its logarithm where it is searched on one), of the effect itself."""
    (effect,), (variant,), (values,) = again.effects, again.variants, again.parameters
    (spec,) = effect.spec.searched
    ends = []
    for way in (1, -1):
        on = values[spec.name] * (1 + way * share)
        ends.append(modulus_of(again.model, effect.respond(again.model, {spec.name: on}, variant)).value)
    step = np.log((1 + share) / (1 - share)) if spec.log else 2 * share * values[spec.name]
    return float(np.log(ends[0] / ends[1]) / step)


def test_intervals_stay_within_what_makes_sense():
    logarithmic = EffectParameter("b", "1", "", low=0.1, high=400.0, log=True)
    low, high = _ninety(0.8, 1.0, logarithmic)
    assert 0 < low < 0.8 < high
    assert np.log(high / 0.8) == pytest.approx(np.log(0.8 / low)) == pytest.approx(NINETY / 0.8)
    assert _ninety(60.0, 0.6, logarithmic) == pytest.approx((60 - 0.987, 60 + 0.987), rel=1e-3)
    bounded = EffectParameter("gap_mm", "mm", "", low=0.0, high=3.0)
    assert _ninety(1.0, 1.0, bounded) == pytest.approx((0.0, 1 + NINETY))
    assert _ninety(2.0, 1.0, bounded, scale=0.5) == pytest.approx((2 - NINETY, 1.5))


def test_two_inferences_of_E_that_disagree_leave_it_as_uncertain_as_their_scatter(thick_skin):
    """The evidence's 1/E moved by a fifth: E of 1 and of 1/1.2 lie ln(1.2) / 2 from their mean."""
    before = modulus_with(thick_skin)
    fit = thick_skin.fit
    agreed = thick_skin.model.modulus_scale / (thick_skin.model.compliance * before.at.value) - 1
    sds = []
    for share in (1.0, 1.2):
        amounts = fit.amounts.copy()
        amounts[0] = (1 + agreed) * share - 1
        sds.append(modulus_with(replace(thick_skin, fit=replace(fit, amounts=amounts))).known.sd)
    more = np.sqrt(sds[1] ** 2 - sds[0] ** 2) / before.at.value
    assert more == pytest.approx(np.log(1.2) / 2, rel=1e-6)


@pytest.mark.parametrize("name", ["jaws", "thick_skin"])
def test_e_changes_with_a_parameter_as_the_effect_itself_says(name, request):
    again = request.getfixturevalue(name)
    informed = modulus_with(again)
    change = asked(again, 0.02)
    assert informed.change[0] == pytest.approx(change, rel=0.1)
    noise_sd = np.sqrt(again.fit.covariance[-1, -1])
    parameter_sd = np.hypot(SYSTEMATIC * noise_sd, _relation_sd(again)[0])
    other = again.model.modulus_scale / (again.model.compliance * (1 + again.fit.amounts[0]))
    apart = np.log(informed.at.value / other) / 2
    expected = informed.at.value * np.linalg.norm(
        [informed.at.sd / informed.at.value, change * parameter_sd, apart]
    )
    assert informed.known.sd == pytest.approx(expected, rel=0.1)
    assert informed.known.sd > 1.2 * informed.at.sd
    assert informed.known.value == informed.at.value
