"""Two pads on a condensed ball: closed-form limits, balance, friction."""

import numpy as np
import pytest
from mismatch_ball import drawn_ball, grasped_ball, linear_body, motion, rough, total_N
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from samples.gel_contact import Gel
from samples.mismatch.skin_compliance import skin_compliance


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
    drawn = drawn_ball(E_MPa=100.0, nu=0.3)
    grasp, stands = rough(drawn, motion([-0.1, 0.3, 0.6]))
    truth = grasped_ball(grasp, stands, linear_body(stands))
    expected = 0.22 * np.pi * 0.6**2 * (75.0 - 0.6) / 3
    assert total_N(truth)[2] == pytest.approx(expected, rel=0.02)


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
