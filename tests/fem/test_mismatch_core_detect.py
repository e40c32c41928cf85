"""p-values against draws of the bank's own distribution; what to record next."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, kstest

from fem.mismatch.catalogue import SEPARATORS, SPECS
from fem.mismatch.effect_spec import NextGrasp
from fem.mismatch.next_grasp import next_grasp
from fem.mismatch.result import NONE, UNKNOWN
from fem.mismatch.selection import detection
from fem.mismatch.selection.null_reference import STATISTICS, null_reference

COUNT = len(STATISTICS)


def drawn(rng: np.random.Generator, fruits: int, records: int = 6) -> np.ndarray:
    """Statistics that hang together and are alike on one fruit; gains may be negative, shares may not."""
    common = np.repeat(rng.normal(size=(fruits, 1)), records, axis=0)
    own = common + 0.5 * rng.normal(size=(fruits * records, COUNT))
    return np.column_stack([np.sinh(own[:, :2]), np.exp(0.05 * own[:, 2] - 3.0)])


def p_of(row: np.ndarray, bank: np.ndarray, records: int = 6) -> float:
    whose = np.repeat(np.arange(len(bank) // records), records)
    return detection.p_values_against(dict(zip(STATISTICS, row.tolist(), strict=True)), bank, whose)[0]


@pytest.fixture
def bank():
    return drawn(np.random.default_rng(0), 20)


def test_p_values_of_null_cases_of_fresh_fruits_are_even():
    """Recordings of one fruit are alike: as many independent ones would make every other fruit a mismatch."""
    rng = np.random.default_rng(1)
    p = np.array([p_of(drawn(rng, 1, 1)[0], drawn(rng, 17)) for _ in range(600)])
    for level in (0.05, 0.1, 0.3, 0.6):
        assert abs((p <= level).mean() - level) < 3 * np.sqrt(level * (1 - level) / len(p))


def test_the_shipped_bank_holds_against_its_own_fruits_left_out():
    rows, whose = null_reference().statistics, null_reference().fruits
    p = []
    for row, fruit in zip(rows, whose, strict=True):
        statistics = dict(zip(STATISTICS, row.tolist(), strict=True))
        p.append(detection.p_values_against(statistics, rows[whose != fruit], whose[whose != fruit])[0])
    assert len(rows) >= 100
    assert kstest(p, "uniform").statistic < 0.15
    assert 0.03 <= np.mean(np.array(p) < 0.05) <= 0.07
    # nor are they all of a few fruits, or of more than independent recordings would be of (binomial, 95 %)
    counts = np.unique(whose, return_counts=True)[1]
    any_below = float(np.mean(1 - 0.95**counts))
    low, high = binom.interval(0.95, len(counts), any_below)
    assert low <= len({fruit for fruit, own in zip(whose.tolist(), p, strict=True) if own < 0.05}) <= high


def test_many_looks_do_not_add_up_to_a_false_alarm(bank):
    """The greatest of each statistic alone is rare; that one of them is greatest is not."""
    middle = np.median(bank, axis=0)
    for k in range(COUNT):
        row = middle.copy()
        row[k] = np.quantile(bank[:, k], 0.97)
        assert p_of(row, bank) > 0.03


def test_statistics_far_beyond_the_bank_have_p_values_that_go_on_falling(bank):
    p = [p_of(bank.max(axis=0) * more, bank) for more in (1.5, 10.0, 100.0, 1000.0)]
    assert p[0] < 0.05
    assert (np.diff(p) < 0).all()
    assert p[-1] < 1e-6


def test_a_middling_recording_is_a_null_case_and_each_statistic_says_its_own(bank):
    middle = np.median(bank, axis=0)
    whose = np.repeat(np.arange(20), 6)
    p, own = detection.p_values_against(dict(zip(STATISTICS, middle.tolist(), strict=True)), bank, whose)
    assert p > 0.3
    assert set(own) == set(STATISTICS)
    assert all(0.3 < value < 0.7 for value in own.values())


def test_nothing_more_is_asked_for_where_nothing_is_left_to_tell():
    assert next_grasp(NONE, grasps=1) is None
    assert next_grasp("viscoelastic", grasps=3) is None


def test_what_effects_gain_on_sound_fruit_is_held_against_them(monkeypatch):
    table = {"stiffening": 5.0, "skin": 2.0}
    monkeypatch.setattr(detection, "null_reference", lambda: replace(null_reference(), quantiles=table))
    assert detection.null_gain("stiffening", 2.0) == 10.0
    assert detection.null_gain_in_full(["skin"], 2.0) == 4.0
    assert detection.null_gain_in_full(["skin", "stiffening"], 2.0) == 10.0
    assert detection.null_gain_in_full(["slip"], 2.0) == 0.0
    gains = [("stiffening", 15.0), ("skin", 5.0), ("slip", 1.0)]
    assert detection.best_beyond_quantile(gains, 2.0) == 2.5


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
