"""Refits: an injected law comes back with its modulus, 1/E is followed, bounds and threads."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pinched_case_model import COMPLIANCE, model_of
from plain_model import screened_effects

from fem.mismatch.effects import anisotropy, damage, skin, soft_spot
from fem.mismatch.selection.refinement import Refit, refit
from fem.mismatch.selection.screening import LinearRound
from fem.mismatch.signature_variant import ONE_WAY

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
    model = replace(injected(), workers=workers)
    return screened_effects(model, effects)


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
