"""The tables of a store: versions, writers at once, and what queries in SQL see."""

from concurrent.futures import ThreadPoolExecutor
from datetime import date
from threading import Barrier

import pytest
from graded_results import graded, queried, results_of

from pipeline.history.lot_database import history_store
from pipeline.history.stored_batch import stored_batch
from pipeline.problem import BatchRefused

TABLES = ("result", "fruit", "grasp")


@pytest.mark.parametrize(
    ("sql", "said"),
    [
        (
            "UPDATE alembic_version SET version_num = 'of_2027'",
            'comes from another version of drupe (its tables are "of_2027"); update drupe',
        ),
        (
            "DROP TABLE alembic_version",
            "comes from a development version of drupe; create a new store from the results folders",
        ),
    ],
)
def test_a_store_of_another_drupe_is_refused(tmp_path, sql, said):
    with history_store(tmp_path / "s"):
        pass
    queried(tmp_path / "s", sql)
    with pytest.raises(BatchRefused) as refused, history_store(tmp_path / "s"):
        pass
    assert str(refused.value.problems[0]) == f"{tmp_path / 's'}: {said}; name another file with --store."


def test_writers_at_once_all_succeed(tmp_path):
    store, writers = tmp_path / "s", 6
    batches = [
        stored_batch(results_of(tmp_path / f"b{k}", [graded("A", 1.0 + k)], lot=f"{k}"))
        for k in range(writers)
    ]
    start = Barrier(writers)

    def write(batch):
        start.wait()
        with history_store(store) as stored:
            return stored.add(batch)

    with ThreadPoolExecutor(writers) as pool:
        assert list(pool.map(write, batches)) == [True] * writers
    with history_store(store) as stored:
        assert sorted(batch.lot for batch in stored.batches()) == sorted(batch.lot for batch in batches)


def test_a_corrected_lot_has_both_names_and_what_is_forgotten_leaves_no_row(tmp_path):
    store = tmp_path / "s"
    described = {
        "orchard": "north", "operator": "Ada", "gripper": {"name": "G1", "serial": "1"},
        "sensor": {"name": "gel", "calibration": "C1", "calibrated_on": "2026-08-01"},
    }  # fmt: skip
    inputs = {"fruits/A/grasps/g.h5": "1"}
    for lot, day in (("wrong", "2026-08-10"), ("right", "2026-08-11")):
        out = results_of(tmp_path / lot, [graded("A", 1.0)], lot=lot, day=day, inputs=inputs, **described)
        with history_store(store) as stored:
            stored.add(stored_batch(out))
    trail = queried(
        store,
        "SELECT lot, orchard, operator, gripper, gripper_serial, sensor, calibration, calibrated_on, "
        "revision FROM result ORDER BY revision",
    )
    same = ("north", "Ada", "G1", "1", "gel", "C1", "2026-08-01")
    assert trail == [("wrong", *same, 0), ("right", *same, 1)]
    with history_store(store) as stored:
        (batch,) = stored.batches()
        assert (batch.lot, batch.calibrated_on) == ("right", date(2026, 8, 1))
        stored.forget("right")
    for table in TABLES:
        assert queried(store, f"SELECT count(*) FROM {table}") == [(0,)]


def test_a_changed_lot_is_noticed(tmp_path):
    store = tmp_path / "s"
    with history_store(store) as stored:
        stored.add(stored_batch(results_of(tmp_path / "b", [graded("A", 1.0)], lot="7")))
    queried(store, "UPDATE result SET lot = '8'")
    with pytest.raises(BatchRefused) as refused, history_store(store):
        pass
    assert "is damaged (its SHA-256 differs)" in str(refused.value.problems[0])
