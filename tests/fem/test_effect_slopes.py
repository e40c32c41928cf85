"""Every effect: its signatures are the slopes of its full model, which with no amount changes nothing."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest
from injected_mismatch import injected_case
from pinched_case_model import model_of
from plain_model import case_model

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.effect import Effect, Response
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.signature_variant import ONE_WAY, Variant, of_pad

CATALOGUE = {effect.spec.name: effect for effect in EFFECTS}


@cache
def flesh() -> CaseModel:
    """A coarse fruit, pinched; the same for all effects of the flesh."""
    return model_of()


@cache
def recordings() -> CaseModel:
    """Two grasps without noise, for effects of sensors and machines."""
    return case_model(injected_case(noise=0.0))[0]


def answer(effect: Effect, model: CaseModel, values: Sequence[float], variant: Variant) -> Response:
    names = [spec.name for spec in effect.spec.searched]
    return effect.respond(model, dict(zip(names, values, strict=True)), variant)


@pytest.mark.parametrize(
    ("name", "model", "variant", "null", "steps", "tolerance"),
    [
        ("skin", flesh, ONE_WAY, (0.0,), (1e-3,), 1e-3),
        ("graded_modulus", flesh, ONE_WAY, (0.0,), (1e-3,), 1e-3),
        ("anisotropy", flesh, ONE_WAY, (0.0,), (1e-3,), 1e-3),
        ("poisson_ratio", flesh, ONE_WAY, (0.45,), (1e-5,), 1e-3),
        ("sensor_gain", recordings, of_pad("left"), (1.0,), (1e-4,), 1e-3),
        ("sensor_drift", recordings, of_pad("right"), (0.0,), (1e-3,), 1e-9),
        ("gripper_compliance", recordings, ONE_WAY, (0.0,), (1e-3,), 1e-9),
        ("clock_lag", recordings, ONE_WAY, (0.0,), (0.05,), 1e-9),
        ("pose_error", recordings, of_pad("left"), (0.0, 0.0, 0.0), (0.15, 0.15, 0.15), 0.03),
    ],
)
def test_each_signature_is_the_slope_of_its_own_model(name, model, variant, null, steps, tolerance):
    effect, model = CATALOGUE[name], model()
    signature = next(way for way in effect.signatures(model) if way.variant == variant)
    for k, step in enumerate(steps):
        two_sided = model is flesh()
        ends = np.array(null) + step * np.eye(len(null))[k] * [[1.0], [-1.0 if two_sided else 0.0]]
        ahead, back = (answer(effect, model, end, variant) for end in ends)
        run = (1 + two_sided) * step
        for grasp, field in enumerate(signature.columns[k].fields):
            slope = model.compliance * (ahead.unit[grasp] - back.unit[grasp])
            if ahead.shift_mm is not None:
                slope = slope + ahead.shift_mm[grasp] - back.shift_mm[grasp]
            assert np.linalg.norm(slope / run - field.markers) <= tolerance * np.linalg.norm(field.markers)
            if ahead.balance is not None:
                unbalanced = (ahead.balance[grasp] - back.balance[grasp]) / run
                off = np.linalg.norm(unbalanced - field.balance)
                assert off <= tolerance * np.linalg.norm(field.balance)
    if len(null) == 1 and model is flesh():
        start = effect.start(model, signature, np.zeros(1))
        assert list(start.values()) == pytest.approx(null)


@pytest.mark.parametrize("name", ["viscoelastic", "drainage"])
def test_each_signature_of_fading_flesh_is_the_slope_at_its_own_time(name):
    effect, model, small = CATALOGUE[name], flesh(), 1e-5
    for signature in effect.signatures(model):
        more = answer(effect, model, (small, *signature.variant.values), ONE_WAY).unit[0]
        slope = model.compliance * (more - model.plain[0]) / small
        markers = signature.columns[0].fields[0].markers
        assert np.linalg.norm(slope - markers) < 1e-3 * np.linalg.norm(markers)


@pytest.mark.parametrize(
    ("name", "variant", "values"),
    [
        ("sensor_gain", of_pad("left"), (1.0,)),
        ("sensor_drift", of_pad("left"), (0.0,)),
        ("gripper_compliance", ONE_WAY, (0.0,)),
        ("clock_lag", ONE_WAY, (0.0,)),
        ("drainage", ONE_WAY, (0.0, 1.0)),
        ("sensor_nonlinear", ONE_WAY, (0.0,)),
        ("gel_creep", ONE_WAY, (0.0, 0.1)),
        ("gel_hysteresis", ONE_WAY, (0.0,)),
        ("thermal_drift", ONE_WAY, (0.0, 0.0)),
    ],
)
def test_no_amount_of_it_changes_nothing(name, variant, values):
    response = answer(CATALOGUE[name], recordings(), values, variant)
    for grasp, plain in enumerate(recordings().plain):
        np.testing.assert_allclose(response.unit[grasp], plain, atol=1e-6 * np.abs(plain).max())
        for channel in (response.shift_mm, response.balance, response.rest):
            if channel is not None:
                np.testing.assert_allclose(channel[grasp], 0, atol=1e-9)
