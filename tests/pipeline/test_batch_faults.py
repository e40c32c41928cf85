"""What all fruit of a batch have in common is found as often as it should be, and said once."""

import math
import re

import numpy as np
import pytest
from graded_results import graded

from pipeline.batch.records import AmountRecord, ScreenRecord
from pipeline.ranking.batch_faults import FALSE_ALARM, FLOOR, batch_faults, combined

OWN_SD = {"gain": 0.003, "newton_per_s": 0.005}
EFFECT = {"gain": "sensor_gain", "newton_per_s": "sensor_drift"}


def fruit(name, **amounts):
    """A fruit whose screen found these amounts, keyed PAD__PARAMETER."""
    records = []
    for key, value in amounts.items():
        pad, _, parameter = key.partition("__")
        effect, sd = EFFECT[parameter], OWN_SD[parameter]
        records.append(AmountRecord(effect=effect, pad=pad, parameter=parameter, value=value, sd=sd))
    return graded(name, 0.5, changes={"screen": ScreenRecord(p_value=0.5, amounts=tuple(records))})


def batch_of(count, rng, *, gain=0.0, between=0.0):
    """Fruit whose left pad has a gain (as 1 - 1/gain), and the right one the opposite; drifts of nothing."""
    fruits = []
    for k in range(count):
        left = gain + between * rng.normal() + OWN_SD["gain"] * rng.normal()
        drift = OWN_SD["newton_per_s"] * rng.normal(size=2)
        drifts = {"left__newton_per_s": drift[0], "right__newton_per_s": drift[1]}
        fruits.append(fruit(f"N{k}", left__gain=left, right__gain=-left, **drifts))
    return fruits


@pytest.mark.parametrize("between", [0.0, 0.006, 0.018])
def test_sound_batches_raise_no_more_alarms_than_stated(between):
    """Fruit that differ by nothing, by FLOOR and by three times that."""
    rng = np.random.default_rng(1)
    batches = [batch_of(int(rng.integers(3, 13)), rng, between=between) for _ in range(1000)]
    alarms = sum(bool(batch_faults(batch)) for batch in batches)
    assert alarms <= 1000 * FALSE_ALARM + 3 * math.sqrt(1000 * FALSE_ALARM)


def test_p_is_that_of_students_t_where_fruit_differ_as_known_beforehand():
    """A mean at the floor, fruit about it by as much: p is below 0.05 in one of forty, on the one side."""
    rng = np.random.default_rng(2)
    floor, p = FLOOR["gain"], []
    for _ in range(2000):
        values = floor + floor * rng.normal(size=8) + 0.003 * rng.normal(size=8)
        p.append(combined(values, np.full(8, 0.003), floor=floor).p_value)
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.025, abs=0.015)


@pytest.mark.parametrize("count", [4, 10])
def test_a_gain_of_four_percent_is_found_in_nearly_every_batch(count):
    rng = np.random.default_rng(7)
    batches = [batch_of(count, rng, gain=1 - 1 / 1.04, between=FLOOR["gain"]) for _ in range(100)]
    assert sum(bool(batch_faults(batch)) for batch in batches) >= 90


def test_a_gain_of_four_percent_in_ten_fruit_is_said_once_with_its_size():
    faults = batch_faults(batch_of(10, np.random.default_rng(3), gain=1 - 1 / 1.04))
    (fault,) = faults
    assert (fault.effect, fault.parameter, fault.fruit, len(fault.shown_by)) == (
        "sensor_gain",
        "gain",
        10,
        10,
    )
    assert abs(fault.value) == pytest.approx(1 - 1 / 1.04, abs=4 * fault.sd)
    assert "the left pad reads" in fault.sentence.lower()
    assert "or the right pad reads" in fault.sentence.lower() or fault.pad == "right"
    said = re.search(r"left pad reads ([\d.]+) ± ([\d.]+) % too much force", fault.sentence)
    assert float(said[1]) == pytest.approx(4.0, abs=4 * float(said[2]))
    assert "visible in 10 of 10 individually" in fault.sentence


def test_a_gain_of_one_fruit_is_no_fault_of_the_batch():
    batch = batch_of(9, np.random.default_rng(4))
    batch.append(fruit("odd", left__gain=0.12, right__gain=-0.12))
    assert batch_faults(batch) == ()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_of_fewer_than_three_fruit_nothing_is_said(count):
    assert batch_faults(batch_of(count, np.random.default_rng(5), gain=0.2)) == ()


def test_fruit_without_a_screen_do_not_count():
    batch = batch_of(4, np.random.default_rng(6), gain=0.05)
    bare = batch[0].model_copy(update={"fruit_id": "bare", "screen": None})
    failed = batch[0].model_copy(update={"fruit_id": "f", "screen": ScreenRecord(failure="one recording")})
    assert {fault.fruit for fault in batch_faults([*batch, bare, failed])} == {4}
