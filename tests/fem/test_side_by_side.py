"""Work done by several threads: order, errors, what is computed once, what is given up, and equal numbers."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Event

import numpy as np
import pytest
from coarse_fruit import fruit_mesh

from fem.cached_value import cached_value
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


def test_work_that_nobody_waits_for_ends_where_it_next_asks_for_pieces():
    """As when the caller is interrupted: the exception of the first item stands for it."""
    begun, pieces = Event(), []

    def piece(k: int) -> None:
        time.sleep(0.01)
        pieces.append(k)

    def item(k: int) -> None:
        if k == 0:
            assert begun.wait(timeout=30.0)
            raise KeyboardInterrupt
        begun.set()
        for _ in range(1000):
            parallel_map(piece, range(3), workers=2)

    with pytest.raises(KeyboardInterrupt):
        parallel_map(item, range(2), workers=2)
    assert len(pieces) < 1000


class Slow:
    together = Barrier(2, timeout=30.0)

    @cached_value
    def value(self) -> int:
        """Comes once two threads compute it, each of an object of its own."""
        self.together.wait()
        return id(self)


def test_threads_compute_values_of_their_own_objects_at_once():
    objects = [Slow(), Slow()]
    assert parallel_map(lambda holder: holder.value, objects, workers=2) == [id(holder) for holder in objects]
    assert [holder.value for holder in objects] == [id(holder) for holder in objects], (
        "kept: the barrier is not asked again"
    )
    assert Slow.value.__doc__ == "Comes once two threads compute it, each of an object of its own."
