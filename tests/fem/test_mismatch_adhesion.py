"""A gel that sticks: markers that pull once they have touched, and what only looks like it."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from injected_mismatch import (
    FLAT,
    GEL_N_PER_MM,
    NOISE_MM,
    PHASES,
    RADII_MM,
    TIME_S,
    Altered,
    Recording,
    injected_case,
)
from plain_model import case_model, screened_effects

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.effects import adhesion, sensor_drift, slip, third_contact
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.pulling_markers import LEAST_EVIDENCE, Pull
from fem.mismatch.selection.model_selection import ModelSelection, select_model
from fem.mismatch.selection.screening import screened

REACH_MM = 0.15
CURVATURE_MM = 30.0


def drawn_out(when: Callable[[str], bool]) -> Altered:
    """Skin of a sphere of radius CURVATURE_MM draws the gel out beside the contact, up to the reach.

    (r^2 - a^2) / 2R over a contact of radius a; at markers within the largest contact, in these phases.
    """
    r2 = (FLAT**2).sum(axis=1)
    height = (r2 - RADII_MM[:, None] ** 2) / 2 / CURVATURE_MM
    chosen = np.array([when(phase) for phase in PHASES])[:, None] & (RADII_MM[:, None] > 0)
    near = r2 < RADII_MM.max() ** 2
    stretch = np.where(chosen & near & (height > 0) & (height < REACH_MM), height, 0.0)

    def change(pad: Recording) -> Recording:
        along = stretch[..., None] * pad.axes[:, 2]
        return replace(
            pad,
            gel_mm=pad.gel_mm + along,
            position_mm=pad.position_mm + along,
            force_N=pad.force_N - GEL_N_PER_MM[2] * along,
        )

    return change


def unevenly(when: Callable[[str], bool]) -> Altered:
    """The same, each marker of the rim with all or nothing of what its square and a neighbour's pull with.

    A rim of pull is narrower than a marker's square. Every pad and every recording by draws of its own.
    """
    rng = np.random.default_rng(11)

    def change(pad: Recording) -> Recording:
        pulled = drawn_out(when)(pad)
        share = 2.0 * rng.integers(2, size=(len(FLAT), 1))
        return replace(pulled, force_N=pad.force_N + share * (pulled.force_N - pad.force_N))

    return change


def drifting(newton_per_s: float) -> Altered:
    """The normal force of a pad grows from the start, evenly over its markers."""
    grown = newton_per_s * TIME_S[:, None, None] / len(FLAT)
    return lambda pad: replace(pad, force_N=pad.force_N + grown * pad.axes[:, 2])


def unaltered(pad: Recording) -> Recording:
    return pad


STICKS = drawn_out(lambda phase: phase == "unload")
BULGES = drawn_out(lambda phase: phase != "air")


@cache
def model_of(altered: Altered) -> CaseModel:
    return case_model(injected_case(altered))[0]


@pytest.fixture
def sticky() -> CaseModel:
    return model_of(STICKS)


def chosen(model: CaseModel) -> ModelSelection:
    effects = [effect for effect in EFFECTS if effect.spec.name in ("adhesion", "slip")]
    assert len(effects) == 2
    linear = screened_effects(model, effects)
    return select_model(model, linear, p_value=0.0)


def test_a_gel_that_sticks_is_named_and_its_reach_is_where_it_lets_go(sticky):
    selection = chosen(sticky)
    assert selection.verdict == "adhesion"
    best = selection.ranking[0].refit
    (parameters,) = best.parameters
    assert parameters[adhesion.REACH] == pytest.approx(REACH_MM, abs=3 * NOISE_MM + 0.01)
    # the forces hold the pull: the response is the plain model's
    for unit, recording in zip(best.response.unit, sticky.grasps, strict=True):
        np.testing.assert_array_equal(unit, recording.tracks.unit_displacement)
    assert best.converged
    value, sd = sticky.pull.reach_mm
    assert NOISE_MM <= sd < 0.02
    assert abs(value - REACH_MM) < 3 * sd


def test_what_a_gel_pulls_with_is_noise_of_the_balance(sticky):
    """A rim of pull is narrower than a marker's square; the sum over markers is off by some of them."""
    pulls = 0
    for recording in sticky.grasps:
        equations = sticky.balance_equations(recording)
        variance = (1 / equations.weight[:, :3]).sum(axis=1)
        added = variance - variance.min()
        held = np.zeros(len(variance))
        for pad, motion in zip(recording.case.history.pads, recording.case.pads, strict=True):
            normal = np.einsum("tnx,tx->tn", pad.force_N, motion.pose[:, :3, 2])[recording.used]
            held += np.where(normal < -6 * pad.force_sd_N, normal**2, 0.0).sum(axis=1)
        assert (added[held == 0] == 0).all()
        assert added.max() == pytest.approx(held.max(), rel=0.2)
        pulls += int((added > variance.min()).sum())
    assert pulls > 0


def test_a_rim_that_is_felt_unevenly_is_no_third_contact(monkeypatch):
    """What the pads are out of balance by is then not borne by anything else."""
    case = injected_case(unevenly(lambda phase: phase == "unload"))
    model = case_model(case)[0]
    cases = [recording.case for recording in model.grasps]
    assert min(Pull.of([case]).evidence for case in cases) < LEAST_EVIDENCE < Pull.of(cases).evidence
    assert third_contact.EFFECT.signatures(model) == []
    with monkeypatch.context() as patched:
        patched.setattr(CaseModel, "gels_stick", False)
        assert third_contact.EFFECT.signatures(case_model(case)[0]) != []


def test_a_gel_that_bulges_beside_the_contact_adds_no_noise():
    model = model_of(BULGES)
    for recording in model.grasps:
        equations = model.balance_equations(recording)
        assert (equations.weight == equations.weight[0]).all()


@pytest.mark.parametrize(
    "altered",
    [unaltered, BULGES, drifting(-0.3)],
    ids=["null case", "a gel that bulges beside the contact", "a force that drifts to a pull"],
)
def test_what_only_looks_like_a_pull_has_no_signature(altered):
    assert adhesion.EFFECT.signatures(model_of(altered)) == []


def test_where_nothing_pulls_every_other_effect_counts_as_without_it():
    model = model_of(unaltered)
    recorded = [GraspEquations.of(model, recording) for recording in model.grasps]
    others = [sensor_drift.EFFECT, slip.EFFECT]
    with_it, without = (screened(model, recorded, tried) for tried in ([*others, adhesion.EFFECT], others))
    assert [fit.gain for fit in with_it.linear_fits] == [fit.gain for fit in without.linear_fits]
    assert with_it.null.chi2 == without.null.chi2
