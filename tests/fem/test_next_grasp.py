"""What to record next, by the catalogue's fixed separators."""

from fem.mismatch.catalogue import SEPARATORS, SPECS
from fem.mismatch.effect_spec import NextGrasp
from fem.mismatch.next_grasp import next_grasp
from fem.mismatch.result import NONE, UNKNOWN


def test_nothing_more_is_asked_for_where_nothing_is_left_to_tell():
    assert next_grasp(NONE, grasps=1) is None
    assert next_grasp("viscoelastic", grasps=3) is None


def test_a_single_recording_asks_for_another():
    assert NextGrasp.ACROSS in next_grasp("viscoelastic", grasps=1)


def test_known_twins_are_parted_by_what_parts_them():
    assert next_grasp(("stiffening", "damage"), grasps=4) == NextGrasp.CYCLES
    assert next_grasp(("damage", "stiffening"), grasps=4) == NextGrasp.CYCLES
    assert next_grasp(("pit_size", "gripper_compliance"), grasps=4) == NextGrasp.DEPTHS
    assert next_grasp(("viscoelastic", "clock_lag"), grasps=4) == NextGrasp.SPEEDS


def test_what_belongs_to_a_jaw_and_what_to_the_fruit_is_parted_by_turning_it():
    assert next_grasp(("soft_spot", "sensor_gain"), grasps=4) == NextGrasp.TURNED
    assert next_grasp(("anisotropy", "pose_error"), grasps=4) == NextGrasp.TURNED
    assert next_grasp(("anisotropy", "poisson_ratio"), grasps=4) == NextGrasp.ACROSS


def test_the_unknown_asks_for_speeds_and_a_turned_fruit():
    asked = next_grasp(UNKNOWN, grasps=4)
    assert NextGrasp.SPEEDS in asked
    assert NextGrasp.TURNED in asked


def test_pairs_that_are_parted_are_effects_of_the_catalogue():
    assert set().union(*SEPARATORS) <= SPECS.keys()
