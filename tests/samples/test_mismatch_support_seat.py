"""A third contact pushes where it is, along the skin's normal, and only when the skin comes to it."""

from functools import cache

import numpy as np
import pytest
from mismatch_ball import drawn_ball, force_on_fruit, grasped_ball, motion, rough

from samples.grasp_plan import PlannedGrasp
from samples.hexahedra import Fineness
from samples.mismatch.grip import InnerContact
from samples.mismatch.meshed_fruit import MeshedFruit
from samples.mismatch.other_bodies import inward_normal, with_third_contact
from samples.mismatch.true_recording import ElasticBody

WAY = motion([-0.05, 0.5, 1.0, 1.0], shear_mm=[0, 0, 0, 0.6])
FINER = Fineness(degrees=(0, 7, 14, 25, 35, 45), along=4, depths=(0, 0.3, 1))
DIRECTION = np.array([0.0, 0.3, -1.0]) / np.hypot(0.3, 1.0)
PLACE_MM = 25.0 * DIRECTION


@cache
def meshed() -> tuple[PlannedGrasp, MeshedFruit]:
    return rough(drawn_ball(), WAY, FINER)


@cache
def borne(*, N_per_mm: float, gap_mm: float = 0.0) -> np.ndarray:
    grasp, stands = meshed()
    normal = inward_normal(drawn_ball().fruit.skin, PLACE_MM)
    compliance, seat = with_third_contact(
        stands.flesh, stands.dofs, centre_mm=PLACE_MM, normal=normal, N_per_mm=N_per_mm, gap_mm=gap_mm
    )
    assert isinstance(seat, InnerContact)
    assert seat.N_per_mm.sum() == pytest.approx(N_per_mm)
    return force_on_fruit(grasped_ball(grasp, stands, ElasticBody(compliance), inner=seat))


def test_the_normal_of_a_ball_points_to_its_middle() -> None:
    assert inward_normal(drawn_ball().fruit.skin, PLACE_MM) == pytest.approx(-DIRECTION, abs=1e-4)


def test_the_pads_are_left_with_a_force_along_the_normal() -> None:
    free, on_palm = borne(N_per_mm=1e-9), borne(N_per_mm=15.0)
    assert np.abs(free).max() < 0.03
    pressed = on_palm[2] - free[2]
    assert np.linalg.norm(pressed) > 0.05
    assert pressed / np.linalg.norm(pressed) == pytest.approx(DIRECTION, abs=0.05)


def test_nothing_is_borne_before_the_gap_has_closed() -> None:
    free, far = borne(N_per_mm=1e-9), borne(N_per_mm=15.0, gap_mm=3.0)
    assert far == pytest.approx(free, abs=1e-5)
