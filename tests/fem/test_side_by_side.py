"""Work done by several threads: order, errors, what is computed once, and the same numbers as by one."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from coarse_fruit import fruit_mesh

from fem.mismatch.model.case_model import MemoTable
from fem.parallel_map import parallel_map
from fem.solid.flesh_pieces import FleshPieces
from fem.solid.strain_field import FleshStrain


def test_items_are_worked_on_at_once_and_come_back_in_order():
    met = threading.Barrier(2, timeout=10)

    def call(item):
        met.wait()  # breaks unless two are under way together
        time.sleep(0.02 * (item % 2 == 0))
        return item**2

    assert parallel_map(call, range(4), workers=2) == [0, 1, 4, 9]


def test_one_worker_stays_in_the_thread_that_asks():
    here = threading.get_ident()
    assert parallel_map(lambda _: threading.get_ident(), range(3), workers=1) == [here] * 3
    assert parallel_map(lambda _: threading.get_ident(), [0], workers=4) == [here]
    assert parallel_map(str, [], workers=4) == []


def test_the_first_items_exception_is_raised_and_what_has_not_begun_is_left():
    begun = []

    def call(item):
        begun.append(item)
        if item < 2:
            raise ValueError(item)
        time.sleep(0.05)

    with pytest.raises(ValueError, match=r"^0$"):
        parallel_map(call, range(50), workers=2)
    assert len(begun) < 10


def test_what_is_kept_is_computed_once_though_many_ask_and_may_ask_for_more_on_the_way():
    memory, computed = MemoTable(), []

    def compute(key):
        computed.append(key)
        time.sleep(0.02)
        return key + memory.memoised("common", lambda: computed.append("common") or "!")

    with ThreadPoolExecutor(4) as pool:
        answers = list(
            pool.map(lambda k: memory.memoised("ab"[k % 2], lambda: compute("ab"[k % 2])), range(16))
        )
    assert answers == ["a!", "b!"] * 8
    assert sorted(computed) == ["a", "b", "common"]


def test_what_fails_is_not_kept():
    memory = MemoTable()
    with pytest.raises(ZeroDivisionError):
        memory.memoised("a", lambda: 1 // 0)
    assert memory.memoised("a", lambda: 7) == 7


def test_pieces_of_flesh_add_up_to_the_same_forces_however_many_threads_work_on_them():
    points = FleshStrain.of(fruit_mesh())
    moved = np.random.default_rng(5).normal(size=(3, points.n_nodes, 3))

    def law(gradient):
        return gradient + np.swapaxes(gradient, 2, 3)

    serial, threaded = (FleshPieces.of(points, workers=n).forces(moved, law) for n in (1, 3))
    assert len(FleshPieces.of(points).pieces) > 3
    np.testing.assert_array_equal(serial, threaded)
