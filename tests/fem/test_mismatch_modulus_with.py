"""What an answer says of E with an effect in place: its spread carries that of the effect's parameters."""

from dataclasses import replace

import numpy as np
import pytest
from injected_mismatch import injected_case, linear_and_refitted
from pinched_case_model import model_of
from plain_model import screened_effects
from test_mismatch_core_measurement import given_way

from fem.mismatch.effect_spec import EffectParameter
from fem.mismatch.effects import gripper_compliance, skin
from fem.mismatch.reported_values import _ninety
from fem.mismatch.result import NINETY
from fem.mismatch.selection.modulus_with import _law_widening, _relation_sd, modulus_of, modulus_with
from fem.mismatch.selection.refinement import Refit, refit
from fem.mismatch.signature_variant import ONE_WAY


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
    law_sd = np.hypot(_law_widening(again)[0] * noise_sd, _relation_sd(again)[0])
    other = again.model.modulus_scale / (again.model.compliance * (1 + again.fit.amounts[0]))
    apart = np.log(informed.at.value / other) / 2
    expected = informed.at.value * np.linalg.norm(
        [informed.at.sd / informed.at.value, change * law_sd, apart]
    )
    assert informed.known.sd == pytest.approx(expected, rel=0.1)
    assert informed.known.sd > 1.2 * informed.at.sd
    assert informed.known.value == informed.at.value
