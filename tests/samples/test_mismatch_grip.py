"""Two pads on a condensed ball: closed-form limits, balance, friction."""

from functools import cache

import numpy as np
import pytest
from mismatch_ball import drawn_ball, grasped_ball, linear_body, motion, rough, total_N
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from samples.gel_contact import Gel, traction
from samples.mismatch.skin_compliance import skin_compliance
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


GEL = Gel(kn_MPa_per_mm=0.2, kt_MPa_per_mm=0.05, friction=0.5)


def test_shear_sticks_then_slips_on_the_cone() -> None:
    position = np.array([[0.5, 0.0, -1.0], [4.0, 0.0, -1.0], [0.0, 3.0, 0.2]])
    force, _ = traction(GEL, position, np.zeros((3, 2)))
    assert force == pytest.approx(np.array([[-0.025, 0, 0.2], [-0.1, 0, 0.2], [0, 0, 0]]))


def test_traction_slope_matches_differences() -> None:
    rng = np.random.default_rng(1)
    position, anchor = rng.normal(size=(50, 3)), rng.normal(size=(50, 2))
    _, slope = traction(GEL, position, anchor)
    for axis in range(3):
        push = np.zeros(3)
        push[axis] = 1e-6
        difference = (
            traction(GEL, position + push, anchor)[0] - traction(GEL, position - push, anchor)[0]
        ) / 2e-6
        assert slope[:, :, axis] == pytest.approx(difference, abs=1e-6)


def test_the_skin_gives_way_as_another_solver_says() -> None:
    _, stands = rough(drawn_ball(), motion([-0.1, 0.6]))
    compliant = skin_compliance(stands.flesh.stiffness, stands.dofs)
    unit = np.zeros((stands.flesh.unknowns, len(stands.dofs)))
    unit[stands.dofs, np.arange(len(stands.dofs))] = 1.0
    compliance = splu(csc_array(stands.flesh.stiffness)).solve(unit)[stands.dofs]
    elastic = float(np.abs(compliant.elastic).max())
    assert elastic < 0.05 * np.abs(compliance).max()
    assert compliant.dense() == pytest.approx(compliance, abs=1e-6 * elastic)
    force = np.random.default_rng(0).normal(size=40)
    part, rows = (slice(0, 15), slice(300, 325)), (slice(6, 30),)
    columns = np.r_[0:15, 300:325]
    expected = 2 * compliance[6:30][:, columns] @ force
    assert compliant.scaled(2.0).times(force, part, rows) == pytest.approx(expected, rel=1e-5)


def test_a_rigid_ball_presses_the_gel_as_its_cap_says() -> None:
    # a rigid cap of depth d pushes aside gel of volume pi d^2 (3 R - d) / 3
    truth = pressed_and_let_go(E_MPa=100.0, reach_mm=REACH_MM)
    expected = 0.22 * np.pi * 0.6**2 * (75.0 - 0.6) / 3
    assert total_N(truth)[WAY.index(0.6)] == pytest.approx(expected, rel=0.02)


def test_the_pads_push_alike_and_only_where_they_touch() -> None:
    grasp, stands = rough(drawn_ball(), motion([-0.2, 0.3, 0.7, 0.3, -0.2]))
    truth = grasped_ball(grasp, stands, linear_body(stands))
    left, right = total_N(truth, 0), total_N(truth, 1)
    assert left == pytest.approx(right, abs=0.02)
    assert left[[0, 4]] == pytest.approx(0.0, abs=1e-12)
    assert left[3] == pytest.approx(left[1], rel=0.01)
    for pad in truth.pads:
        assert pad.force_N[2] == pytest.approx(
            -pad.displacement_mm[2] * np.array([0.055, 0.055, 0.22]), abs=1e-12
        )


def test_friction_stays_within_its_cone() -> None:
    way = motion([-0.1, 0.4, 0.8, 0.8, 0.8], shear_mm=[0, 0, 0, 0.5, 1.0])
    grasp, stands = rough(drawn_ball(), way)
    body = linear_body(stands)
    slippery = grasped_ball(grasp, stands, body, gel=Gel(friction=0.05))
    sticky = grasped_ball(grasp, stands, body)
    for pad, other in zip(slippery.pads, sticky.pads, strict=True):
        shear = np.linalg.norm(pad.force_N[..., :2], axis=-1)
        assert np.all(shear <= 0.0501 * pad.force_N[..., 2] + 1e-9)
        touches = other.force_N[..., 2] > 1e-3
        free = np.linalg.norm(other.force_N[..., :2], axis=-1)[touches] / other.force_N[..., 2][touches]
        assert free.max() > 0.1
