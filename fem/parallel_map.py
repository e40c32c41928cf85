"""Independent pieces of work in threads: numpy, BLAS and sparse products let others run meanwhile."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from threading import local
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")
_THIS_THREAD = local()


def parallel_map(call: Callable[[A], B], items: Iterable[A], *, workers: int) -> list[B]:
    """`call` of every item, in their order, up to `workers` at once; the first one's exception is raised.

    Work that is itself one of several does its own pieces one after the other. What `call` changes outside of
    itself it must guard. BLAS should be held to one thread meanwhile (threadpoolctl): two that each use all
    cores hinder each other.
    """
    waiting = list(items)
    if min(workers, len(waiting)) < 2 or getattr(_THIS_THREAD, "one_of_several", False):
        return [call(item) for item in waiting]
    pool = ThreadPoolExecutor(min(workers, len(waiting)), initializer=_begin)
    try:
        return list(pool.map(call, waiting))
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    _THIS_THREAD.one_of_several = True
