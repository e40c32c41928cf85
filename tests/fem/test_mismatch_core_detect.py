"""p-values against draws of the bank's own distribution; what to record next."""

import numpy as np
import pytest

from fem.mismatch import detect
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.explanation import NONE, UNKNOWN
from fem.mismatch.suggest import ACROSS, CYCLES, DEPTHS, SEPARATORS, SPEEDS, TURNED, next_grasp

COUNT = len(detect.NAMES)


def drawn(rng: np.random.Generator, size: int) -> np.ndarray:
    """Statistics that hang together, some with a long tail."""
    common = rng.normal(size=(size, 1))
    own = common + rng.normal(size=(size, COUNT))
    own[:, 0] = np.exp(own[:, 0])
    return own


def p_of(row: np.ndarray) -> float:
    return detect.p_values(dict(zip(detect.NAMES, row.tolist(), strict=True)))[0]


@pytest.fixture
def bank(monkeypatch):
    rng = np.random.default_rng(0)
    rows = drawn(rng, 120)
    monkeypatch.setattr(detect, "NULLS", tuple(map(tuple, rows.tolist())))
    return rows


def test_p_values_of_sound_recordings_are_even(monkeypatch):
    rng = np.random.default_rng(1)
    p = []
    for _ in range(12):
        rows = drawn(rng, 60)
        monkeypatch.setattr(detect, "NULLS", tuple(map(tuple, rows.tolist())))
        p += [p_of(row) for row in drawn(rng, 25)]
    p = np.array(p)
    for level in (0.05, 0.1, 0.3, 0.6):
        spread = np.sqrt(level * (1 - level) / len(p))
        assert abs((p <= level).mean() - level) < 3 * spread + 1 / 60


def test_many_looks_do_not_add_up_to_a_false_alarm(bank):
    """The greatest of each statistic alone is rare; that one of them is greatest is not."""
    middle = np.median(bank, axis=0)
    for k in range(COUNT):
        row = middle.copy()
        row[k] = np.quantile(bank[:, k], 0.97)
        assert p_of(row) > 0.03


def test_statistics_far_beyond_the_bank_have_p_values_that_go_on_falling(bank):
    p = [p_of(bank.max(axis=0) + more) for more in (2.0, 20.0, 60.0, 200.0)]
    assert p[0] < 0.05
    assert (np.diff(p) < 0).all()
    assert p[-1] < 1e-6


def test_a_middling_recording_is_sound_and_each_statistic_says_its_own(bank):
    middle = np.median(bank, axis=0)
    p, own = detect.p_values(dict(zip(detect.NAMES, middle.tolist(), strict=True)))
    assert p > 0.3
    assert set(own) == set(detect.NAMES)
    assert all(0.3 < value < 0.7 for value in own.values())


def test_nothing_more_is_asked_for_where_nothing_is_left_to_tell():
    assert next_grasp(NONE, grasps=1) is None
    assert next_grasp("viscoelastic", grasps=3) is None


def test_a_single_recording_asks_for_another():
    assert ACROSS in next_grasp("viscoelastic", grasps=1)


def test_known_twins_are_parted_by_what_parts_them():
    assert next_grasp(("stiffening", "damage"), grasps=4) == CYCLES
    assert next_grasp(("damage", "stiffening"), grasps=4) == CYCLES
    assert next_grasp(("pit_size", "gripper_compliance"), grasps=4) == DEPTHS
    assert next_grasp(("viscoelastic", "clock_lag"), grasps=4) == SPEEDS


def test_what_belongs_to_a_jaw_and_what_to_the_fruit_is_parted_by_turning_it():
    assert next_grasp(("soft_spot", "sensor_gain"), grasps=4) == TURNED
    assert next_grasp(("anisotropy", "pose_error"), grasps=4) == TURNED
    assert next_grasp(("anisotropy", "poisson_ratio"), grasps=4) == ACROSS


def test_the_unknown_asks_for_speeds_and_a_turned_fruit():
    asked = next_grasp(UNKNOWN, grasps=4)
    assert SPEEDS in asked
    assert TURNED in asked


def test_pairs_that_are_parted_are_effects_of_the_catalogue():
    known = {effect.name for effect in EFFECTS}
    assert set().union(*SEPARATORS) <= known
