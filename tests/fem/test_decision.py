"""The finder's decision: Bayes factors against quadrature, p-values without a bank, verdict sets."""

import ast
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest, norm

from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.result import NONE
from fem.mismatch.selection import decision
from fem.mismatch.selection.decision import (
    FREEDOM,
    MISFIT,
    Weighed,
    credible_set,
    log_prior,
    p_values,
    probabilities,
)


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
    peak = right / normal
    integral, _ = quad(integrand, low, 6 * sd, points=[max(peak, low)], limit=200)
    expected = np.log(integral * (2.0 if case.positive[column] else 1.0))
    assert case.log_bayes_factors(case.right[None])[name][0] == pytest.approx(expected, abs=1e-6)


def test_alternatives_of_one_effect_share_its_prior():
    case = equations(np.random.default_rng(4), injected=0.3)
    both = case.log_bayes_factors(case.right[None])["slip"][0]
    alone = [
        SignatureEquations(
            normal=case.normal, right=case.right, sd=case.sd, positive=case.positive, ways={"slip": [way]}
        ).log_bayes_factors(case.right[None])["slip"][0]
        for way in case.ways["slip"]
    ]
    assert both == pytest.approx(np.log(np.mean(np.exp(alone))))


def test_p_values_of_recordings_without_mismatch_are_even():
    """Both statistics drawn by their own distributions: 5 % below 0.05 within three standard deviations."""
    rng = np.random.default_rng(5)
    p = np.array(
        [
            p_values(
                equations(rng),
                misfit=MISFIT * rng.chisquare(FREEDOM) / FREEDOM,
                direct=0.0,
                rng=rng,
            )[0]
            for _ in range(300)
        ]
    )
    assert kstest(p, "uniform").pvalue > 0.01
    assert abs((p < 0.05).mean() - 0.05) < 3 * np.sqrt(0.05 * 0.95 / len(p))


def test_a_injected_effect_a_large_misfit_and_direct_marks_are_each_detected():
    rng = np.random.default_rng(6)
    usual = {"misfit": MISFIT, "direct": 0.0}
    assert p_values(equations(rng, injected=0.5), **usual, rng=rng)[1]["effects"] < 0.005
    assert p_values(equations(rng), misfit=3 * MISFIT, direct=0.0, rng=rng)[0] < 1e-4
    p, each = p_values(equations(rng), misfit=MISFIT, direct=10.0, rng=rng)
    assert each["gel"] == pytest.approx(np.exp(-10.0))
    assert p == pytest.approx(3 * np.exp(-10.0), rel=1e-3)


def weighed(*explanations: tuple[str, float, float], direct: float = 0.0) -> dict[str, float]:
    """Probabilities of (name, gain, misfit over MISFIT), and of "unknown"."""
    known = [
        Weighed(name=name, gain=gain, misfit=ratio * MISFIT, direct=0.0 if name == NONE else direct)
        for name, gain, ratio in explanations
    ]
    shares, unknown = probabilities(known)
    found = dict(zip([name for name, _, _ in explanations], shares, strict=True)) | {"unknown": unknown}
    assert sum(found.values()) == pytest.approx(1.0)
    return found


def test_without_gain_and_with_the_usual_misfit_there_is_most_likely_no_mismatch():
    found = weighed((NONE, 0.0, 1.0), *((f"effect {k}", -1.0 + 0.1 * k, 1.0) for k in range(20)))
    assert found[NONE] > max(probability for name, probability in found.items() if name != NONE) * 5


def test_an_effect_that_gains_and_leaves_little_is_named():
    found = weighed((NONE, 0.0, 3.0), ("skin", 40.0, 1.1), ("slip", 10.0, 2.5))
    assert found["skin"] > 0.95


def test_a_large_misfit_that_no_effect_explains_is_unknown():
    found = weighed((NONE, 0.0, 20.0), ("skin", 12.0, 19.8), ("slip", 3.0, 20.0))
    assert found["unknown"] > 0.8
    assert found[NONE] < 1e-3


def test_what_recordings_show_directly_cannot_be_unknown_physics():
    without = weighed((NONE, 0.0, 8.0), ("adhesion", 30.0, 7.9))
    directly = weighed((NONE, 0.0, 8.0), ("adhesion", 30.0, 7.9), direct=30.0)
    assert without["unknown"] > 0.5 > directly["unknown"]


def test_a_pair_needs_more_than_a_single_effect():
    """By the number of pairs: at equal gain the single is likelier by the ratio of the priors."""
    found = weighed((NONE, 0.0, 3.0), ("skin", 40.0, 1.0), ("skin+slip", 40.0, 1.0))
    assert found["skin"] / found["skin+slip"] == pytest.approx(
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
    """Numbers of the module's constants; draws bound the time, not the answer."""
    tree = ast.parse(Path(decision.__file__).read_text("utf-8"))
    constants = [node for node in tree.body if isinstance(node, ast.Assign | ast.AnnAssign)]
    decide = [node for node in constants if "DRAWS" not in ast.unparse(node)]
    numbers = [
        leaf
        for node in decide
        for leaf in ast.walk(node)
        if isinstance(leaf, ast.Constant) and isinstance(leaf.value, int | float)
    ]
    assert 8 <= len(numbers) <= 12
