"""A gel that sticks: it pulls at skin that it has touched, as far as its reach, and never before."""

from functools import cache

import pytest
from mismatch_ball import drawn_ball, grasped_ball, linear_body, motion, rough, total_N

from samples.gel_contact import Gel
from samples.mismatch.true_recording import TrueRecording

REACH_MM = 0.12
WAY = [-0.1, 0.3, 0.6, 0.3, 0.1, 0.02, -0.03, -0.06, -0.09, -0.11, -0.14, -0.3]


@cache
def pressed_and_let_go(*, E_MPa: float, reach_mm: float) -> TrueRecording:
    grasp, stands = rough(drawn_ball(E_MPa=E_MPa, nu=0.3), motion(WAY))
    body = linear_body(stands)
    return grasped_ball(grasp, stands, body, gel=Gel(reach_mm=reach_mm))


def test_a_rigid_ball_draws_the_gel_out_to_its_cap_within_the_reach() -> None:
    """Skin at height h + r^2 / 2R over the gel's face holds the gel where that is less than the reach."""
    truth = pressed_and_let_go(E_MPa=100.0, reach_mm=REACH_MM)
    for h in (0.03, 0.06, 0.09):
        height = h + (truth.rest_mm[:, :2] ** 2).sum(axis=1) / 2 / 25.0
        stretch = truth.pads[0].displacement_mm[WAY.index(-h), :, 2]
        inside, outside = height < REACH_MM - 0.01, height > REACH_MM + 0.01
        assert inside.sum() >= 4
        assert stretch[inside] == pytest.approx(height[inside], abs=0.005)
        assert stretch[outside] == pytest.approx(0.0, abs=1e-12)
    assert total_N(truth)[WAY.index(-0.14)] == pytest.approx(0.0, abs=1e-9)


def test_a_gel_that_sticks_is_pressed_as_one_that_does_not() -> None:
    sticks, slides = (pressed_and_let_go(E_MPa=0.5, reach_mm=reach) for reach in (REACH_MM, 0.0))
    assert total_N(sticks)[:3] == pytest.approx(total_N(slides)[:3], rel=1e-6)


def test_skin_is_drawn_out_no_farther_than_the_reach_and_only_after_it_has_touched() -> None:
    truth = pressed_and_let_go(E_MPa=0.5, reach_mm=REACH_MM)
    for pad in truth.pads:
        stretch = pad.displacement_mm[..., 2]
        assert stretch[: WAY.index(0.6) + 1].max() <= 0.0
        assert REACH_MM / 2 < stretch.max() < REACH_MM
