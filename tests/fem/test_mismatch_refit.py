"""Refits: an injected law comes back with its modulus, 1/E is followed, bounds and threads."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pinched_case_model import COMPLIANCE, model_of
from plain_model import screened_effects

from fem.mismatch.effects import damage, skin, soft_spot
from fem.mismatch.selection.refinement import MARGIN, Refit, _Search, refit
from fem.mismatch.selection.screening import LinearRound
from fem.mismatch.signature_variant import ONE_WAY

SOFTER = 1.25
STARTED = {"dmax": 0.3, "W0_over_E": 0.006}
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


def test_another_modulus_is_taken_up_so_that_the_law_sees_the_same():
    linear = rounds([damage.EFFECT])
    search = _Search(injected(), linear, (linear.best[0],), damage.EFFECT.spec.searched)
    before = search.linearised(search.scaled([STARTED]))
    after, followed = search.followed(before)
    assert followed
    grown = search.model.compliance / COMPLIANCE
    assert abs(grown - 1) > 0.01
    assert after.at[0] == before.at[0]
    assert after.at[1] - before.at[1] == pytest.approx(2 * np.log(grown))
    unit = before.response.unit[0]
    assert np.linalg.norm(after.response.unit[0] - unit) < 2e-3 * np.linalg.norm(unit)
    assert not search.followed(after)[1]


def test_a_parameter_at_the_end_of_its_bounds_is_said_of_its_own_effect():
    linear = rounds([damage.EFFECT, skin.EFFECT])
    shown = {linear_fit.effect.spec.name: linear_fit for linear_fit in linear.best}
    effects = (shown["damage"], shown["skin"])
    specs = [spec for effect in effects for spec in effect.effect.spec.searched]
    search = _Search(injected(), linear, effects, specs)
    middle = (search.low + search.high) / 2
    assert search.at_an_end(middle) == (False, False)
    low, high = middle.copy(), middle.copy()
    low[1], high[2] = search.low[1] - 1.0, search.high[2] + 1.0
    assert search.at_an_end(search.bounded(low)) == (True, False)
    assert search.at_an_end(search.bounded(high)) == (False, True)
    near = middle.copy()
    near[1] = search.low[1] + 3 * MARGIN * (search.high[1] - search.low[1])
    assert search.at_an_end(near) == (False, False)


def test_threads_change_no_number():
    effects = [damage.EFFECT, skin.EFFECT, soft_spot.EFFECT]
    serial, threaded = (rounds(effects, workers=workers) for workers in (1, 3))
    assert serial.null.log_evidence == threaded.null.log_evidence
    assert [shown.gain for shown in serial.linear_fits] == [shown.gain for shown in threaded.linear_fits]
    assert [shown.signature.variant for shown in serial.linear_fits] == [
        shown.signature.variant for shown in threaded.linear_fits
    ]
