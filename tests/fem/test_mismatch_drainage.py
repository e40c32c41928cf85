"""Flesh that loses juice: its modes against the samples' law and the elastic law it ends at; found again.

The coarse fruit's truth is stepped through time on a mesh of its own (drained_flesh).
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from coarse_fruit import NU
from drained_flesh import drained
from injected_mismatch import E_MPA, TIME_S, Altered, injected_case
from pinched_case_model import FRAMES, model_of
from plain_model import case_model, screened_effects

from fem.elements.assembly import unit_lame_constants
from fem.materials.relaxing_arm import RelaxingArm, lagging
from fem.mismatch.effects import clock_lag, drainage, poisson_ratio, viscoelastic
from fem.mismatch.effects.drainage import FadingVolume
from fem.mismatch.evidence.model_error import model_error_columns
from fem.mismatch.model.plain_model import GraspResponse
from fem.mismatch.model.reduced_law import ReducedLaw
from fem.mismatch.selection import screening
from fem.mismatch.selection.modulus_with import modulus_of
from fem.mismatch.selection.refinement import refit
from fem.mismatch.selection.screening import LinearRound
from fem.mismatch.signature_variant import ONE_WAY
from fem.solid.linear_solid import UnitModulusSolid
from samples.mismatch.flesh_laws import Draining, Lame, PlainFlesh

EFFECTS = [drainage.EFFECT, viscoelastic.EFFECT, poisson_ratio.EFFECT, clock_lag.EFFECT]
MU, LAME = unit_lame_constants(NU)
COARSE_MESH = {"poisson_ratio": 0.167}
"""Model error here: the finder's mesh is so coarse that its error looks like that of Poisson's ratio."""


def uniform_strain() -> ReducedLaw:
    """A cube of 1 mm3 in uniform strain along its axes, pulled at one pair of faces."""
    shear, volume = 2 * np.eye(3), np.ones((3, 3))
    shares = np.linspace(0.0, 1.0, FRAMES)[:, None] ** 0.3
    nothing = np.zeros((FRAMES, 1, 3))
    return ReducedLaw(
        parts=np.stack([shear, volume]),
        load=np.array([[0.01], [0.0], [0.0]]),
        recording=np.eye(3)[:, None],
        shares=shares,
        unchanged=nothing,
    )


@pytest.mark.parametrize(("share", "tau_s"), [(0.3, 0.2), (0.9, 0.05), (0.9, 2.0)])
def test_the_samples_law_gives_back_the_pull_from_the_strain(share: float, tau_s: float):
    law = uniform_strain()
    recording = model_of().grasps[0]

    def strained(law: ReducedLaw, recording: GraspResponse) -> np.ndarray:
        volume = FadingVolume.of(law, mu=MU, lame=LAME)
        return (law.response((MU, LAME)) + volume.change(recording, share=share, tau_s=tau_s))[:, 0]

    strain = strained(law, recording)
    # between frames the forces run straight: the strain there, by the same modes on a finer grid of times
    history = recording.case.history
    fine_s = np.linspace(0, history.time_s[-1], 70 * (FRAMES - 1) + 1)
    finer = replace(
        recording,
        used=np.ones(len(fine_s), dtype=bool),
        case=replace(recording.case, history=replace(history, time_s=fine_s, pads=())),
    )
    shares = np.interp(fine_s, history.time_s, law.shares[:, 0])[:, None]
    nothing = np.zeros((len(fine_s), 1, 3))
    fine_law = replace(law, shares=shares, unchanged=nothing)
    fine = strained(fine_law, finer)
    np.testing.assert_allclose(fine[::70], strain, atol=1e-12)
    lame = Lame(mu=MU, lam=LAME)
    truth = Draining(plain=PlainFlesh(lame=lame), volume_share=share, tau_s=tau_s)
    small = 1e-3  # of the strain: the samples' law is of finite strain
    state = truth.at_first((1,))
    for step in range(1, len(fine_s)):
        H = small * np.diag(fine[step])[None]
        stress, state = truth.stress(H, state, float(fine_s[step] - fine_s[step - 1]))
        np.testing.assert_allclose(stress[0] / small, np.diag([0.01 * shares[step, 0], 0, 0]), atol=3e-5)


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_drained_flesh_is_elastic_flesh_with_what_is_left_of_lambda(share: float):
    model = model_of()
    (recording,) = model.grasps
    gone = {"volume_share": share, "tau_s": 1e-6}
    response = drainage.EFFECT.respond(model, gone, ONE_WAY).unit[0]
    left = (1 - share) * LAME
    ratio = left / (2 * (left + MU))
    solid = UnitModulusSolid.factorise(model.mesh, poisson_ratio=ratio, support="free")
    solid = replace(solid, contact_nodes=recording.solid.contact_nodes)
    leading = recording.leading
    moved = solid.displacement(recording.loads(recording.patterns[leading])) / (2 * MU * (1 + ratio))
    change = recording.at_markers(moved) - recording.response[leading]
    expected = np.tensordot(recording.shares[:, leading], change, axes=1)
    more = response - recording.tracks.unit_displacement
    assert np.linalg.norm(more - expected) < 0.01 * np.linalg.norm(expected)
    assert np.linalg.norm(expected) > 0.03 * np.linalg.norm(recording.tracks.unit_displacement)


def rounds(altered: Altered, **options: object):
    model, _ = case_model(injected_case(altered, **options))
    model = replace(model, beyond_small_strain=False)  # flesh here moves by small strain
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(screening, "model_error_columns", partial(model_error_columns, shares=COARSE_MESH))
        return model, screened_effects(model, EFFECTS)


def gains(linear: LinearRound) -> dict[str, float]:
    return {linear_fit.effect.spec.name: linear_fit.gain for linear_fit in linear.best}


@pytest.mark.parametrize(
    ("share", "least_gain", "share_off", "tau_off"),
    [pytest.param(0.85, 2000, 0.05, 0.12, marks=pytest.mark.proof), (0.4, 150, 0.05, 0.15)],
)
def test_draining_flesh_is_found_with_its_share_its_time_and_the_modulus(
    share: float, least_gain: float, share_off: float, tau_off: float
):
    tau_s = 0.8
    model, linear = rounds(drained(share, tau_s))
    best, second = linear.best[:2]
    assert best.effect is drainage.EFFECT
    assert best.gain > max(least_gain, second.gain + 50)
    again = refit(model, linear, [best])
    (parameters,) = again.parameters
    assert parameters["volume_share"] == pytest.approx(share, abs=share_off)
    assert parameters["tau_s"] == pytest.approx(tau_s, rel=tau_off)
    assert modulus_of(again.model, again.response).value == pytest.approx(E_MPA, rel=0.02)


def test_an_unaltered_fruit_does_not_seem_to_drain():
    _, linear = rounds(lambda pad: pad)
    assert gains(linear)["drainage"] < 1.0


def test_flesh_whose_whole_resistance_fades_is_viscoelastic():
    def relaxed(unit: np.ndarray) -> np.ndarray:
        arm = RelaxingArm(g=0.3, tau_s=0.8)
        return unit + arm.creep_share * lagging(unit, TIME_S, arm.retardation_s)

    _, linear = rounds(lambda pad: pad, crept=relaxed)
    gain_of = gains(linear)
    assert linear.best[0].effect is viscoelastic.EFFECT
    assert gain_of["viscoelastic"] > gain_of["drainage"] + 50
