"""All grasps of a fruit in one inference: known truths, closed forms of its error bar, and its warnings."""

from dataclasses import replace

import numpy as np
import pytest

from fem.estimation import joint_inference
from fem.estimation.error_budget import (
    DISCRETISATION,
    MODEL,
    PIT_PLACE,
    REGISTRATION,
    SCATTER,
    TACTILE,
    ErrorBudget,
)
from fem.estimation.information import GraspInformation
from fem.estimation.joint_inference import GraspEvidence, joint_modulus
from fem.estimation.sensitivity import PIT, PIT_SIZE, POISSON_RATIO, SURFACE
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory, PadHistory

E_MPA = 0.5
WIDE = ErrorBudget(pit_offset_sd_mm=2.0, pit_size_sd=0.5)
NOISE = 0.01


def evidence(slopes, seen, *, causes=PIT, at=None, relative_sd=NOISE, misfit_sd=1e-6, discretisation_sd=1e-6):
    """A grasp whose pads show 1/E times (1 + slopes @ causes), each with noise, about causes `at`."""
    slopes, seen = np.atleast_2d(slopes), np.atleast_1d(seen)
    here = 1 + slopes @ (np.zeros(len(causes)) if at is None else at)
    fields = np.column_stack([here, slopes])
    weight = (relative_sd * seen.mean()) ** -2
    return GraspEvidence(
        information=GraspInformation(
            causes=tuple(causes), normal=weight * fields.T @ fields, right=weight * fields.T @ seen
        ),
        E_MPa=float(1 / (seen / here).mean()),
        misfit_sd=misfit_sd,
        discretisation_sd=discretisation_sd,
    )


def of_known(slopes, place, **options):
    return evidence(slopes, (1 + np.atleast_2d(slopes) @ place) / E_MPA, **options)


def test_without_a_grasp_it_is_refused():
    with pytest.raises(ValueError, match="at least one grasp"):
        joint_modulus([], budget=WIDE, infer_pit=True)


def test_a_modulus_that_does_not_settle_is_refused(monkeypatch):
    monkeypatch.setattr(joint_inference, "STILL", -1.0)
    grasp = of_known(np.full((2, 4), 0.1), np.zeros(4))
    with pytest.raises(FemFailure, match="still changes") as failure:
        joint_modulus([grasp], budget=WIDE, infer_pit=False)
    assert failure.value.problem is FemProblem.NOT_CONVERGED


@pytest.mark.parametrize("infer_pit", [False, True])
def test_the_parts_add_up_to_the_error_bar_in_squares(infer_pit):
    place = np.array([0.1, -0.2, 0.05, 0.02])
    rng = np.random.default_rng(0)
    grasps = [
        of_known(rng.normal(0, 0.1, (2, 4)), place, misfit_sd=0.01, discretisation_sd=0.003) for _ in range(3)
    ]
    fruit = joint_modulus(grasps, budget=WIDE, infer_pit=infer_pit)
    assert np.linalg.norm(list(fruit.parts_sd_MPa.values())) == pytest.approx(fruit.E_sd_MPa, rel=1e-9)
    assert set(fruit.parts_sd_MPa) <= {TACTILE, PIT_PLACE, PIT_SIZE, DISCRETISATION, MODEL, SCATTER}
    assert fruit.parts_sd_MPa[DISCRETISATION] == pytest.approx(0.003 * fruit.E_MPa, rel=1e-6)
    assert fruit.parts_sd_MPa[MODEL] < 0.01 * fruit.E_MPa


def pressed(*surface_sd_mm):
    """A recording of which only the mesh's errors under its pads are known."""
    nothing = np.zeros((0, 3))
    return GraspHistory(
        time_s=np.zeros(0),
        phase=(),
        pads=tuple(
            PadHistory(
                name=str(k), rest_mm=nothing, surface_mm=nothing, position_mm=np.zeros((0, 0, 3)),
                gel_displacement_mm=np.zeros((0, 0, 3)), force_N=np.zeros((0, 0, 3)),
                episode=np.zeros((0, 0), int), displacement_sd_mm=0.01, force_sd_N=0.01, lag1=0.0,
                surface_sd_mm=sd_mm,
            )
            for k, sd_mm in enumerate(surface_sd_mm)
        ),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("under_pads_mm", "counts_mm"),
    [
        ((0.3, 0.4), np.sqrt((0.09 + 0.16) / 2)),
        ((0.3, None), np.sqrt((0.09 + 0.04) / 2)),
        ((None, None), 0.2),
    ],
)
def test_the_surface_counts_by_its_error_under_the_pads_where_that_is_known(under_pads_mm, counts_mm):
    slopes = 0.05 * np.ones(len(SURFACE))
    grasp = of_known(slopes, np.zeros(len(SURFACE)), causes=SURFACE)
    budget = replace(WIDE, surface_sd_mm=0.2)
    fruit = joint_modulus([replace(grasp, history=pressed(*under_pads_mm))], budget=budget, infer_pit=False)
    # six independent waves of variance sd² / 3, each with a slope of 5 % per mm
    assert fruit.parts_sd_MPa[REGISTRATION] / E_MPA == pytest.approx(0.05 * counts_mm * np.sqrt(2), rel=1e-6)


def test_a_lone_grasps_pit_counts_by_its_sensitivity_times_its_spread():
    fruit = joint_modulus([of_known([0.05, 0, 0, -0.3], np.zeros(4))], budget=WIDE, infer_pit=False)
    assert fruit.pit is None
    assert fruit.E_MPa == pytest.approx(E_MPA, rel=1e-9)
    assert fruit.parts_sd_MPa[PIT_PLACE] == pytest.approx(0.05 * 2.0 * E_MPA, rel=1e-6)
    assert fruit.parts_sd_MPa[PIT_SIZE] == pytest.approx(0.3 * 0.5 * E_MPA, rel=1e-6)
    assert fruit.parts_sd_MPa[TACTILE] == pytest.approx(NOISE * E_MPA, rel=1e-6)


def test_a_pit_that_the_data_cannot_see_keeps_its_prior():
    unseen = [of_known(np.zeros((2, 4)), np.zeros(4)) for _ in range(2)]
    fruit = joint_modulus(unseen, budget=WIDE, infer_pit=True)
    np.testing.assert_allclose(fruit.pit.sd, [2.0, 2.0, 2.0, 0.5], rtol=1e-9)
    np.testing.assert_allclose(fruit.pit.prior_sd, fruit.pit.sd, rtol=1e-9)
    np.testing.assert_allclose([*fruit.pit.offset_mm, fruit.pit.ln_size], 0, atol=1e-9)
    np.testing.assert_allclose(fruit.pit.learnt, 0, atol=1e-9)
    assert fruit.parts_sd_MPa[PIT_SIZE] < 1e-9
    assert fruit.E_sd_MPa == pytest.approx(NOISE * E_MPA / 2, rel=1e-3)


def test_a_pit_without_spread_stays_and_costs_nothing():
    sure = replace(WIDE, pit_offset_sd_mm=0.0)
    slopes = np.array([0.1, 0.1, 0.1, 0.0])
    fruit = joint_modulus([of_known(slopes, np.zeros(4))] * 2, budget=sure, infer_pit=True)
    assert not fruit.pit.offset_mm.any()
    assert not fruit.pit.sd[:3].any()
    assert not fruit.pit.moved[:3].any()
    assert PIT_PLACE not in fruit.parts_sd_MPa


def test_grasps_that_feel_the_pits_size_unlike_each_other_find_it():
    place = np.array([0.0, 0, 0, np.log(0.8)])
    grasps = [of_known([0, 0, 0, slope], place, relative_sd=1e-3) for slope in (-0.2, -0.8)]
    fruit = joint_modulus(grasps, budget=WIDE, infer_pit=True)
    assert fruit.E_MPa == pytest.approx(E_MPA, rel=2e-3)
    assert fruit.pit.ln_size == pytest.approx(np.log(0.8), abs=0.01)
    assert fruit.pit.learnt[3] > 0.99
    assert fruit.pit.moved[3] == pytest.approx(np.log(0.8) / 0.5, rel=0.05)
    with_prior = joint_modulus(grasps, budget=WIDE, infer_pit=False)
    assert abs(with_prior.E_MPa / E_MPA - 1) > 0.05


def test_the_pits_posterior_covers_the_pit_as_often_as_it_says():
    rng = np.random.default_rng(1)
    budget = ErrorBudget(pit_offset_sd_mm=0.5, pit_size_sd=0.05)
    slopes = rng.normal(0, 0.15, (3, 2, 4))
    pit_scores, scores = [], []
    for _ in range(100):
        place = rng.normal(size=4) * [0.5, 0.5, 0.5, 0.05]
        grasps = [evidence(s, (1 + s @ place) / E_MPA * (1 + NOISE * rng.normal(size=2))) for s in slopes]
        fruit = joint_modulus(grasps, budget=budget, infer_pit=True)
        off = np.append(fruit.pit.offset_mm, fruit.pit.ln_size) - place
        pit_scores.append(off @ np.linalg.solve(fruit.pit.covariance, off))
        scores.append(np.log(fruit.E_MPa / E_MPA) / (fruit.E_sd_MPa / fruit.E_MPa))
    assert np.mean(pit_scores) == pytest.approx(4, rel=0.35)
    assert 0.75 < np.std(scores) < 1.3


def alone(modulus_MPa, relative_sd=NOISE):
    weight = (modulus_MPa / relative_sd) ** 2
    information = GraspInformation(
        causes=(), normal=np.array([[weight]]), right=np.array([weight / modulus_MPa])
    )
    return GraspEvidence(information=information, E_MPa=modulus_MPa, misfit_sd=1e-6, discretisation_sd=1e-6)


def test_grasps_that_agree_sharpen_as_a_mean_does():
    moduli = E_MPA * np.exp([0.004, -0.002, 0.001, -0.003])
    fruit = joint_modulus([alone(E_MPa) for E_MPa in moduli], budget=WIDE, infer_pit=True)
    assert fruit.E_MPa == pytest.approx(E_MPA, rel=2e-3)
    assert fruit.E_sd_MPa == pytest.approx(NOISE * E_MPA / 2, rel=0.01)
    assert fruit.grasps == 4
    assert fruit.warnings == ()
    assert fruit.pit is None


def test_grasps_that_scatter_beyond_their_errors_widen_the_error_bar_and_say_so():
    """With equal weights, DerSimonian and Laird's variance of the mean is the scatter's over the number."""
    ln = np.array([0.2, -0.15, 0.05, -0.1])
    fruit = joint_modulus([alone(E_MPA * np.exp(x)) for x in ln], budget=WIDE, infer_pit=True)
    assert np.log(fruit.E_MPa / E_MPA) == pytest.approx(ln.mean(), abs=0.02)
    assert fruit.E_sd_MPa / fruit.E_MPa == pytest.approx(ln.std(ddof=1) / 2, rel=0.15)
    assert fruit.parts_sd_MPa[SCATTER] > 0.9 * fruit.E_sd_MPa
    (warning,) = fruit.warnings
    assert "disagree beyond their errors (0.611, 0.430, 0.526, 0.452 MPa)" in warning


def test_the_prior_stays_where_it_was_when_the_pit_is_moved_in_the_mesh():
    """A linear response about the prior's pit and about another one: the same data, the same posterior."""
    rng = np.random.default_rng(2)
    place, at = np.array([0.08, -0.1, 0.05, 0.03]), np.array([0.1, -0.05, 0.1, 0.05])
    budget = ErrorBudget(pit_offset_sd_mm=0.1, pit_size_sd=0.1)
    slopes = rng.normal(0, 0.1, (3, 2, 4))
    here = joint_modulus([of_known(s, place) for s in slopes], budget=budget, infer_pit=True)
    there = joint_modulus(
        [of_known(s, place, at=at) for s in slopes], budget=budget, infer_pit=True, pit_at=at
    )
    assert there.E_MPa == pytest.approx(here.E_MPa, rel=1e-3)
    assert there.E_sd_MPa == pytest.approx(here.E_sd_MPa, rel=0.03)
    np.testing.assert_allclose(there.pit.offset_mm, here.pit.offset_mm, atol=2e-3)
    assert there.pit.ln_size == pytest.approx(here.pit.ln_size, abs=2e-3)
    np.testing.assert_allclose(there.pit.sd, here.pit.sd, rtol=0.03)


def test_poisson_ratio_is_common_to_all_grasps_and_no_number_of_them_tells_it():
    budget = replace(WIDE, poisson_ratio_sd=0.02)
    few, many = (
        joint_modulus(
            [of_known([-1.0], np.zeros(1), causes=(POISSON_RATIO,))] * n, budget=budget, infer_pit=True
        )
        for n in (2, 20)
    )
    for fruit in (few, many):
        assert fruit.parts_sd_MPa[POISSON_RATIO] == pytest.approx(0.02 * E_MPA, rel=1e-3)
    assert many.parts_sd_MPa[TACTILE] == pytest.approx(few.parts_sd_MPa[TACTILE] / np.sqrt(10), rel=1e-2)


SYMMETRIC = np.array([[0.1, 0, 0, 0], [-0.1, 0, 0, 0]])
"""A pit nearer to one pad is farther from the other."""


def test_pads_that_differ_by_what_noise_and_the_prior_allow_are_taken_at_their_word():
    place = np.array([0.5, 0.0, 0.0, 0.0])
    grasps = [of_known(SYMMETRIC, place) for _ in range(2)]
    fruit = joint_modulus(grasps, budget=ErrorBudget(pit_offset_sd_mm=0.5, pit_size_sd=0.0), infer_pit=True)
    known = 2 * 2 * 0.1**2 / NOISE**2  # information of both grasps' two pads about the pit's x, 1/mm2
    assert fruit.pit.offset_mm[0] == pytest.approx(0.5 * known / (known + 0.5**-2), rel=0.02)


def test_pads_pulled_apart_by_something_else_hardly_move_the_pit():
    """Two grasps show the pit on opposite sides: no place of it is both."""
    left, right = (of_known(SYMMETRIC, np.array([x, 0, 0, 0.0])) for x in (4.0, -3.0))
    budget = ErrorBudget(pit_offset_sd_mm=0.5, pit_size_sd=0.0)
    fruit = joint_modulus([left, right], budget=budget, infer_pit=True)
    # What both say together is x = 0.5 mm; chi-square is that of their difference of 7 mm.
    known = 2 * 0.1**2 / NOISE**2
    chi2 = (known * 3.5**2 * 2) / 3
    weak = 2 * known / chi2
    assert fruit.pit.offset_mm[0] == pytest.approx(0.5 * weak / (weak + 0.5**-2), rel=0.1)
    assert fruit.pit.sd[0] == pytest.approx((weak + 0.5**-2) ** -0.5, rel=0.05)
    (said,) = fruit.warnings
    assert f"the pads differ by {np.sqrt(chi2):.1f} times" in said
