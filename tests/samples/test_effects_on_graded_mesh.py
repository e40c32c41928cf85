"""Every effect that can be injected runs on bricks that are halved towards the skin."""

import numpy as np
import pytest
from mismatch_ball import drawn_ball, grasp_along_x, grasped_ball, linear_body, motion, total_N

from samples.graded_bricks import BrickGrading
from samples.grasp_plan import PlannedGrasp
from samples.mismatch.case_simulation import body_of
from samples.mismatch.drawn_fruit import DrawnFruit
from samples.mismatch.injected import (
    AMPLITUDES,
    EFFECTS,
    InjectedEffect,
    drawn_out_of_catalogue,
    drawn_parameters,
    gel_of,
)
from samples.mismatch.meshed_fruit import MeshedFruit, meshed_fruit
from samples.mismatch.nonlinear_body import sound_body

SMALL = BrickGrading(cells=3, layers=2, levels=2)
IN_SHORT = frozenset({"skin", "stiffening", "loose_pit", "third_contact", "gel_creep", "sensor_gain"})
"""One of each kind of body and of recording."""
WAY = motion([-0.05, 0.3, 0.6], shear_mm=[0.0, 0.0, 0.3])


@pytest.fixture(scope="module")
def ball() -> tuple[DrawnFruit, PlannedGrasp, MeshedFruit]:
    """A ball, a grasp of it, and its mesh graded towards the skin."""
    drawn = drawn_ball()
    grasp = grasp_along_x(drawn, WAY)
    return drawn, grasp, meshed_fruit(drawn.fruit, grasp, fineness=SMALL)


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    [
        pytest.param(effect, marks=() if effect in IN_SHORT else pytest.mark.proof)
        for effect in [*EFFECTS, "palm"]
    ],
)
def test_an_effect_runs_on_a_graded_mesh(
    effect: str, ball: tuple[DrawnFruit, PlannedGrasp, MeshedFruit]
) -> None:
    drawn, grasp, stands = ball
    rng = np.random.default_rng(3)
    places = {"soft_spot": [21.0, 0.0, 0.0], "third_contact": [0.0, 0.0, -25.0]}
    if effect in EFFECTS:
        parameters = drawn_parameters(effect, 0.4 * AMPLITUDES[effect][1], rng)
        if effect in places:
            parameters["centre_mm"] = places[effect]
        injected = (InjectedEffect(effect=effect, parameters=parameters),)
    else:
        injected = (drawn_out_of_catalogue(effect, rng),)
    body, inner = body_of(stands, injected, skin=drawn.fruit.skin)
    truth = grasped_ball(grasp, stands, body, gel=gel_of(injected), inner=inner)
    assert 0.1 < total_N(truth)[1] < total_N(truth)[2] < 10.0


@pytest.mark.slow
def test_finite_strain_stiffens_a_pressed_ball_a_little(
    ball: tuple[DrawnFruit, PlannedGrasp, MeshedFruit],
) -> None:
    _, grasp, stands = ball
    linear = linear_body(stands)
    small, large = (total_N(grasped_ball(grasp, stands, body)) for body in (linear, sound_body(stands)))
    assert large[1:] == pytest.approx(small[1:], rel=0.05)
    assert np.abs(large[2] / small[2] - 1) > 1e-3
