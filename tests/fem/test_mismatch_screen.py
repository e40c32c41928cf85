"""The screen: what it suggests of a coarse fruit with an injected fault, and what it spares."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from injected_mismatch import NU, finders_mesh, injected_case, on_pad, only_grasp

from fem.estimation.grasp_model import grasp_model
from fem.estimation.prepared_grasp import prepared_grasp
from fem.fem_failure import FemFailure
from fem.mismatch import screen as module
from fem.mismatch.effects import viscoelastic
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.model import plain_model
from fem.mismatch.screen import Screened, screen
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes

GAIN = 1.06


@cache
def solid() -> UnitModulusSolid:
    """What grading would have factorised."""
    nodes = contact_nodes(finders_mesh(), [grasp.history for grasp in injected_case().grasps])
    return UnitModulusSolid.factorise(finders_mesh(), poisson_ratio=NU, support="free", contact_nodes=nodes)


def screen_of(case: MismatchCase) -> Screened:
    return screen(case, solids={"free": solid()})


@cache
def sound() -> Screened:
    return screen_of(injected_case())


@cache
def gained() -> Screened:
    return screen_of(injected_case(on_pad("left", lambda pad: replace(pad, force_N=GAIN * pad.force_N))))


def amount(screened: Screened, effect: str, pad: str) -> tuple[float, float]:
    (of_pad,) = [listed for listed in screened.amounts if (listed.effect, listed.pad) == (effect, pad)]
    return of_pad.value, of_pad.sd


@pytest.mark.slow
def test_a_gain_of_one_pad_is_suggested_first_and_of_its_size():
    assert gained().p_value < 0.05
    assert "sensor_gain" in gained().names[0]
    value, sd = amount(gained(), "sensor_gain", "left")
    assert value == pytest.approx(1 - 1 / GAIN, abs=max(3 * sd, 0.01))
    assert amount(gained(), "sensor_gain", "right")[0] == pytest.approx(-(GAIN - 1), abs=0.015)


@pytest.mark.slow
def test_with_a_gain_of_one_pad_E_may_be_higher_or_lower_by_half_of_it():
    """Too much force on one pad and too little on the other leave the same imbalance: the flesh does not say
    which. E without the effect is too high by half of the gain, or too low.
    """
    ratio, added_sd = gained().moduli["sensor_gain"]
    half = (GAIN - 1) / 2
    assert abs(ratio - 1) < half
    assert added_sd == pytest.approx(np.sqrt(half**2 - (ratio - 1) ** 2), rel=0.2)
    assert abs(1 / (1 + half) - ratio) < 2 * added_sd


@pytest.mark.slow
def test_with_gradings_solid_nothing_is_assembled_or_factorised(monkeypatch):
    def none_needed(*_, **__):
        raise AssertionError("factorised again")

    solid()
    sound.cache_clear()  # it is screened here, whichever test ran before
    with monkeypatch.context() as patched:
        patched.setattr(UnitModulusSolid, "factorise", none_needed)
        patched.setattr(plain_model, "assemble", none_needed)
        screened = sound()
    anew = screen(injected_case())
    assert anew.p_value == pytest.approx(screened.p_value, rel=1e-3)
    assert anew.gains == pytest.approx(screened.gains, abs=1e-2)


@pytest.mark.slow
def test_a_sound_fruit_has_no_gain_and_no_drift():
    for effect in ("sensor_gain", "sensor_drift"):
        for pad in ("left", "right"):
            value, sd = amount(sound(), effect, pad)
            assert abs(value) < 4 * sd


@pytest.mark.slow
def test_an_effect_that_grading_takes_into_account_is_no_longer_found(monkeypatch):
    """Flesh that answers 15 % more from the hold on, once unsaid and once taken in."""
    monkeypatch.setattr(module, "_screened_effects", lambda: [viscoelastic.EFFECT])
    share = 0.15 * (np.arange(17) >= 9)[:, None, None]
    case = injected_case(crept=lambda unit: unit * (1 + share))
    plain = screen_of(case)
    taken = []
    for grasp in case.grasps:
        history = prepared_grasp(grasp.history, grasp.turns).history
        force = np.concatenate([pad.force_N for pad in history.pads], axis=1)
        response = grasp_model(history, solid()).unit_displacement(force)
        taken.append(replace(grasp, correction=share * response))
    left = screen_of(replace(case, grasps=tuple(taken)))
    assert plain.gains["viscoelastic"] > 10
    assert left.gains["viscoelastic"] < plain.gains["viscoelastic"] / 5
    assert left.statistics["misfit"] > plain.statistics["misfit"]


def test_one_recording_alone_is_not_screened():
    with pytest.raises(FemFailure, match="record a second grasp at another place"):
        screen(only_grasp(injected_case(), 0))
