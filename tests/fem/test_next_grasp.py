"""What to record next, by what effects state of themselves."""

import pytest

from fem.mismatch.procedure import ACROSS, SPEEDS, TURNED, TWICE, next_grasp
from fem.mismatch.result import NONE, UNKNOWN


@pytest.mark.parametrize(
    ("verdict", "asked"),
    [
        (NONE, None),
        ("viscoelastic", None),
        (("soft_spot", "sensor_gain"), TURNED),
        (("sensor_gain+skin", "skin"), TURNED),
        (("anisotropy", "poisson_ratio"), ACROSS),
        (("damage", "stiffening"), TWICE),
        (("plastic_set", "viscoelastic"), TWICE),
        (("viscoelastic", "drainage"), SPEEDS),
    ],
)
def test_the_first_difference_between_the_remaining_effects_decides(verdict, asked):
    assert next_grasp(verdict, grasps=4) == asked


def test_a_single_recording_asks_for_another():
    assert ACROSS in next_grasp("viscoelastic", grasps=1)


def test_the_unknown_asks_for_speeds_and_a_turned_fruit():
    asked = next_grasp(UNKNOWN, grasps=4)
    assert SPEEDS in asked
    assert TURNED in asked
