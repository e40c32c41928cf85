"""The screen, and E with a known effect in the model, by the solids that grading factorised."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from injected_mismatch import E_MPA, NU, finders_mesh, injected_case, on_pad, only_grasp
from pinched_case_model import as_case, long_pinch, model_of
from plain_model import kept_solid
from refusals import refused
from test_mismatch_flesh_laws import relaxed

from fem.estimation.grasp_model import grasp_model
from fem.estimation.modulus import estimate_modulus
from fem.estimation.prepared_grasp import prepared_grasp
from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch import displacement_correction
from fem.mismatch import screen as module
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.displacement_correction import KnownEffect, displacement_corrections
from fem.mismatch.effect_spec import Entry
from fem.mismatch.effects import skin, viscoelastic
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.model import plain_model
from fem.mismatch.model.plain_model import solids_of
from fem.mismatch.screen import Screened, screen
from fem.mismatch.signature_variant import ONE_WAY
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
    """Without large deformation, which the truth lacks."""
    case = injected_case(on_pad("left", lambda pad: replace(pad, force_N=GAIN * pad.force_N)))
    return screen(case, solids={"free": solid()}, beyond_small_strain=False)


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


G, TAU_S = 0.35, 1.2
RELAXING = KnownEffect(effect=viscoelastic.EFFECT, parameters=lambda _: {"g": G, "tau_s": TAU_S})


@cache
def relaxed_case() -> MismatchCase:
    """A grasp of flesh that relaxes, by the convolution that defines it."""
    return only_grasp(injected_case(crept=partial(relaxed, g=G, tau_s=TAU_S)), 1)


@pytest.mark.slow
def test_relaxing_flesh_is_too_soft_without_its_law_and_right_with_it():
    case = relaxed_case()
    history = case.grasps[0].history
    solid = replace(
        kept_solid(case.mesh, case.poisson_ratio, "free"), contact_nodes=contact_nodes(case.mesh, [history])
    )
    model = grasp_model(history, solid)
    (beyond,) = displacement_corrections(case, [RELAXING], at_finite_strain=True)
    informed = replace(model, displacement_correction=beyond)
    without, with_law = (estimate_modulus(history, each, budget=case.budget) for each in (model, informed))
    assert without.E_MPa < 0.93 * E_MPA
    assert with_law.E_MPa == pytest.approx(E_MPA, rel=0.02)
    assert not beyond[:3].any()


def test_known_effects_whose_modulus_does_not_settle_say_so(monkeypatch):
    monkeypatch.setattr(displacement_correction, "STILL", -1.0)
    with refused(FemProblem.NOT_CONVERGED, "E with viscoelastic still changes"):
        displacement_corrections(relaxed_case(), [RELAXING], at_finite_strain=True)


@pytest.mark.parametrize("at_finite_strain", [True, False])
def test_a_skin_of_so_many_newtons_per_millimetre_counts_in_the_modulus_that_comes_with_it(
    at_finite_strain: bool,
):
    E_MPa, Et_N_per_mm = 0.3, 1.5
    model = replace(model_of(), compliance=1 / E_MPa, beyond_small_strain=at_finite_strain)
    recording = model.grasps[0]
    (stiff,) = skin.EFFECT.respond(model, {"Et_over_E_mm": Et_N_per_mm / E_MPa}, ONE_WAY).unit
    history = long_pinch()
    ends = np.cumsum([len(pad.rest_mm) for pad in history.pads])[:-1]
    pads = tuple(
        replace(pad, position_mm=pad.surface_mm + displacement / E_MPa)
        for pad, displacement in zip(history.pads, np.split(stiff, ends, axis=1), strict=True)
    )
    known = KnownEffect(effect=skin.EFFECT, parameters=lambda E: {"Et_over_E_mm": Et_N_per_mm / E})
    (beyond,) = displacement_corrections(
        as_case(replace(history, pads=pads)), [known], at_finite_strain=at_finite_strain
    )
    wanted = stiff - recording.tracks.unit_displacement
    assert np.abs(beyond - wanted).max() < 0.01 * np.abs(wanted).max()


def test_known_effects_of_a_fruit_that_does_not_move_have_no_modulus():
    known = KnownEffect(effect=skin.EFFECT, parameters=lambda E: {"Et_over_E_mm": 1.5 / E})
    with refused(FemProblem.NO_MODULUS, "do not move the fruit"):
        displacement_corrections(as_case(long_pinch()), [known], at_finite_strain=True)


VALUES = {"radius_mm": 5.0, "ratio": 0.5, "nu": 0.42, "scale": 0.95, "mu": 0.3, "gap_mm": 0.006}
"""Where a small share of the upper bound, as taken for the other parameters, is no effect that can be."""


@pytest.mark.parametrize(
    "effect",
    [effect for effect in EFFECTS if effect.spec.enters is Entry.RESPONSE],
    ids=lambda effect: effect.spec.name,
)
def test_every_effect_that_changes_the_response_has_a_correction(effect):
    """By its parameters alone: settings know no more of it."""
    model = model_of()
    values = {
        spec.name: VALUES.get(spec.name, 0.05 * spec.high if spec.low >= 0 else 0.01 * spec.high)
        for spec in effect.spec.searched
    }
    (correction,) = displacement_correction._corrections(
        model, [KnownEffect(effect=effect, parameters=lambda _: values)]
    )
    assert correction.shape == model.grasps[0].tracks.unit_displacement.shape
    assert np.isfinite(correction).all()
    if effect.spec.family == "object":  # a contact corrects what the recording shows of it, here nothing
        assert np.abs(correction).max() > 0


@pytest.fixture
def factorised(monkeypatch):
    """What is factorised anew, by mesh and Poisson's ratio; nothing is computed."""
    asked, known = [], grading_solid()

    def factorise(mesh, *, poisson_ratio, support, parts):
        asked.append((mesh, poisson_ratio))
        return known

    monkeypatch.setattr(UnitModulusSolid, "factorise", factorise)
    return asked


@cache
def case() -> MismatchCase:
    return injected_case()


def grading_solid() -> UnitModulusSolid:
    return kept_solid(case().mesh, case().poisson_ratio, "free")


def test_a_given_solid_is_taken_with_all_the_skin_as_contact(factorised):
    free_solid = solids_of(case(), {"free": grading_solid()})["free"]
    assert factorised == []
    assert free_solid.factor is grading_solid().factor
    assert sorted(free_solid.contact_nodes.tolist()) == sorted(case().mesh.outer_nodes.tolist())


def test_one_of_another_poisson_ratio_or_mesh_is_not_taken(factorised):
    solids_of(case(), {"free": replace(grading_solid(), poisson_ratio=0.4)})
    solids_of(case(), {"free": replace(grading_solid(), mesh=replace(case().mesh))})
    solids_of(case(), {})
    assert factorised == [(case().mesh, case().poisson_ratio)] * 3
