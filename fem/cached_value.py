"""`cached_value`: functools.cached_property without its lock.

Up to Python 3.11 that lock is one for all objects of a class, so that threads that each need the value of an
object of their own wait for each other. Here two threads that need the same object's value at once may both
compute it; the values are equal and one of them stays.
Source: Python 3.12, "What's new", functools: the undocumented lock of cached_property was removed.
"""

from collections.abc import Callable
from contextlib import nullcontext
from functools import cached_property
from typing import Any, TypeVar

T = TypeVar("T")


class cached_value(cached_property[T]):  # noqa: N801 - used as a decorator, like functools.cached_property
    """A method's value, computed when first asked for, then an entry of the object's own `__dict__`."""

    def __init__(self, compute: Callable[[Any], T]) -> None:
        super().__init__(compute)
        self.lock = nullcontext()
