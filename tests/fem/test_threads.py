"""Work in threads: what is given up ends soon, and values of different objects are computed at once."""

import time
from threading import Barrier, Event

import pytest

from fem.cached_value import cached_value
from fem.parallel_map import parallel_map


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
