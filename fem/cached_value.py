"""`cached_value`: functools.cached_property without its lock.

Up to Python 3.11 that lock is one for all objects of a class, so that threads that each need the value of an
object of their own wait for each other. Here two threads that need the same object's value at once may both
compute it; the values are equal and one of them stays.
Source: Python 3.12, "What's new", functools: the undocumented lock of cached_property was removed.
"""

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

T = TypeVar("T")


class cached_value(Generic[T]):  # noqa: N801 - used as a decorator, like functools.cached_property
    """A method's value, computed when first asked for, then an entry of the object's own `__dict__`."""

    def __init__(self, compute: Callable[[Any], T]) -> None:
        self.compute = compute
        self.__doc__ = compute.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type) -> "cached_value[T]": ...

    @overload
    def __get__(self, instance: object, owner: type) -> T: ...

    def __get__(self, instance: object | None, owner: type) -> "T | cached_value[T]":
        if instance is None:
            return self
        attribute = self.compute(instance)
        instance.__dict__[self.name] = attribute
        return attribute
