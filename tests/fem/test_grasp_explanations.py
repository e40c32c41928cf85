"""Explanations: pairs against dense Gaussian evidence, and which of them are tried."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.effect import Signature
from fem.mismatch.effect_spec import LAW_ERROR
from fem.mismatch.evidence.linear_evidence import GramMatrix
from fem.mismatch.evidence.signature_equations import SignatureEquations
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.selection import grasp_explanations
from fem.mismatch.selection.grasp_explanations import Hypothesis, all_explanations
from fem.mismatch.selection.screening import LinearRound, linear_round
from fem.mismatch.signature_variant import ONE_WAY

BY_NAME = {effect.spec.name: effect for effect in EFFECTS}
NUMBERS, SD = 60, 0.5
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
        ways={name: [(k,)] for k, name in enumerate(NAMES)},
    )


def dense_evidence(data: np.ndarray, *columns: np.ndarray, noise: float = 1.0) -> float:
    """ln p of the data with Gaussian amounts of these columns integrated out."""
    covariance = noise * np.eye(len(data)) + SD**2 * sum((np.outer(c, c) for c in columns), np.zeros(1))
    return float(multivariate_normal.logpdf(data, cov=covariance))


def added(case: SignatureEquations, columns: tuple[int, ...]) -> float:
    return float(case.log_bayes_factor(columns, case.right[None])[0])


def test_a_second_signature_adds_what_dense_evidence_says():
    rng = np.random.default_rng(1)
    columns = fields(rng)
    data = 0.8 * columns[0] + 0.3 * columns[1] + rng.normal(size=NUMBERS)
    remaining, _ = equations(columns, data).given((0,))
    for second in (1, 2):
        expected = dense_evidence(data, columns[0], columns[second]) - dense_evidence(data, columns[0])
        assert added(remaining, (second,)) == pytest.approx(expected, abs=1e-9)


def test_more_noise_makes_evidence_weaker_as_dense_evidence_says():
    rng = np.random.default_rng(2)
    columns = fields(rng)
    data = 0.5 * columns[2] + rng.normal(size=NUMBERS)
    expected = dense_evidence(data, columns[2], noise=3.0) - dense_evidence(data, noise=3.0)
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
    dense = (
        SD**2
        * columns[[0, 2]]
        @ np.linalg.solve(np.eye(NUMBERS) + SD**2 * columns[[0, 2]].T @ columns[[0, 2]], data)
    )
    np.testing.assert_allclose(equations(columns, data).amounts((0, 2)), dense, rtol=1e-9)


def round_of(
    amounts: tuple[float, ...], *, seed: int = 4, numbers: int = 4000, direct: float = 0.0
) -> LinearRound:
    """A linear round of the three effects; the last one's amount is positive a priori. `direct`: direct
    evidence of the second.
    """
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(4, numbers))
    data = np.array([0.0, *amounts]) @ columns + rng.normal(size=numbers)
    rows = np.vstack([data, columns])
    regressors = [
        Regressor(name=name, sd=3.0 if name == "1/E" else 1.0, fields=(), positive=name == NAMES[2])
        for name in ("1/E", *NAMES)
    ]
    return linear_round(
        GramMatrix.from_products(regressors, [np.arange(4)], [rows @ rows.T]),
        (),
        [
            (BY_NAME[name], Signature(variant=ONE_WAY, columns=(regressors[k],)), (k,))
            for k, name in enumerate(NAMES, 1)
        ],
        auxiliary=lambda effect, *_: (0.0, direct if effect.spec.name == NAMES[1] else 0.0),
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
        linear = round_of((1.0, 0.3, 0.0), direct=direct)
        known = by_name(linear)
        pair, single = known["anisotropy+skin"], known["skin"]
        lead.append(pair.gain + pair.hidden - single.gain - single.hidden)
    assert lead[1] - lead[0] == pytest.approx(60.0, abs=1.0)


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
