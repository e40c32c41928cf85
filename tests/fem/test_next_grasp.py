"""What to record next, by what effects state of themselves."""

from fem.mismatch.procedure import ACROSS, SPEEDS, TURNED, TWICE, next_grasp
from fem.mismatch.result import NONE, UNKNOWN


def test_nothing_more_is_asked_for_where_nothing_is_left_to_tell():
    assert next_grasp(NONE, grasps=1) is None
    assert next_grasp("viscoelastic", grasps=3) is None


def test_a_single_recording_asks_for_another():
    assert ACROSS in next_grasp("viscoelastic", grasps=1)


def test_what_belongs_to_a_jaw_and_what_to_the_fruit_is_separated_by_turning_it():
    assert next_grasp(("soft_spot", "sensor_gain"), grasps=4) == TURNED
    assert next_grasp(("anisotropy", "pose_error"), grasps=4) == TURNED
    for twins in (("clock_lag", "viscoelastic"), ("gripper_compliance", "pit_size")):
        assert next_grasp(twins, grasps=4) == TURNED
    assert next_grasp(("sensor_gain+skin", "skin"), grasps=4) == TURNED
    assert next_grasp(("anisotropy", "poisson_ratio"), grasps=4) == ACROSS


def test_what_lasts_in_the_flesh_shows_in_a_second_grasp():
    assert next_grasp(("damage", "stiffening"), grasps=4) == TWICE
    assert next_grasp(("plastic_set", "viscoelastic"), grasps=4) == TWICE


def test_effects_that_depend_on_time_ask_for_speeds():
    assert next_grasp(("viscoelastic", "drainage"), grasps=4) == SPEEDS


def test_the_unknown_asks_for_speeds_and_a_turned_fruit():
    asked = next_grasp(UNKNOWN, grasps=4)
    assert SPEEDS in asked
    assert TURNED in asked
