"""Independent pieces of work in threads: numpy, BLAS and sparse products let others run meanwhile."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from threading import Event, local
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")
_THIS_THREAD = local()


def parallel_map(call: Callable[[A], B], items: Iterable[A], *, workers: int) -> list[B]:
    """`call` of every item, in their order, up to `workers` at once; the first one's exception is raised.

    After an exception, or when the caller is interrupted, work that still runs ends the next time it calls
    this function itself.

    Work that is itself one of several does its own pieces one after the other. What `call` changes outside of
    itself it must guard. BLAS should be held to one thread meanwhile (threadpoolctl): two that each use all
    cores hinder each other.
    """
    waiting = list(items)
    given_up: Event | None = getattr(_THIS_THREAD, "given_up", None)
    if min(workers, len(waiting)) < 2 or given_up is not None:
        return [_unless(given_up, call, item) for item in waiting]
    given_up = Event()
    pool = ThreadPoolExecutor(min(workers, len(waiting)), initializer=_begin, initargs=(given_up,))
    try:
        return list(pool.map(call, waiting))
    except BaseException:
        given_up.set()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


class GivenUp(BaseException):
    """Work in a thread whose answer nobody waits for any more."""


def _unless(given_up: Event | None, call: Callable[[A], B], item: A) -> B:
    if given_up is not None and given_up.is_set():
        raise GivenUp
    return call(item)


def _begin(given_up: Event) -> None:
    """This thread does one of several pieces: its own pieces come one after the other, until given up."""
    _THIS_THREAD.given_up = given_up
