"""The checker of tests/conftest.py: beartype on the rooms' array annotations, and on no others.

Types that are not arrays are mypy's matter; tests may hand in simpler objects in their place.
An axis named with an underscore (`list[Float[np.ndarray, "_f _n 3"]]`) may have another size in each array of
a container; one named without has the same size wherever the name stands in a signature.
"""

import inspect
from collections import Counter
from collections.abc import Callable
from functools import cache, wraps
from typing import Any, TypeVar, get_args

from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray

F = TypeVar("F", bound=Callable[..., Any])
CALLS: Counter[Any] = Counter()
"""Calls of each function in the present test, by the identity of its code: classes may have equal code."""
CHECKED = 5
"""Calls of each function that are checked in a test. Set by hand: with 5, three files of tests take 85 s,
without checks 88 s, and 118 s with a check at every call."""


def check(function: F) -> F:
    """The function with its arguments and result checked against their dtypes and shapes."""
    hints = function.__annotations__
    function.__annotations__ = {name: hint if has_array(hint) else Any for name, hint in hints.items()}
    return beartype(conf=BeartypeConf(is_pep484_tower=True))(function)


def has_array(hint: object) -> bool:
    """Whether a hint is of an array, or of a container of arrays.

    >>> import numpy as np; from jaxtyping import Float
    >>> has_array(list[Float[np.ndarray, "n 3"]] | None), has_array(int)
    (True, False)
    """
    is_array = isinstance(hint, type) and issubclass(hint, AbstractArray)
    return is_array or any(has_array(part) for part in get_args(hint))


def first_calls_with_arrays(jaxtyped: Callable[..., Any]) -> Callable[..., Any]:
    """jaxtyping's decorator, for functions whose annotations name arrays, in their first calls of each test.

    A check costs 0.1 to 0.3 ms, as much as the innermost functions themselves; at every call the tests took
    half as long again. CALLS counts by code, since a function within a function is defined again and again.
    """

    def decorated(*context: Any, **options: Any) -> Any:
        if context:  # no decorator: jaxtyped("context") of a with statement
            return jaxtyped(*context, **options)
        wrap = jaxtyped(**options)

        def decorate(defined: Any) -> Any:
            if isinstance(defined, classmethod | staticmethod):
                return type(defined)(decorate(defined.__func__))
            if isinstance(defined, property):
                return defined.getter(decorate(defined.fget))
            of_class = inspect.isclass(defined)
            plain = defined.__init__ if of_class else defined
            hints = getattr(plain, "__annotations__", {}).values()
            code = id(getattr(plain, "__code__", None))
            if not any(isinstance(hint, str) or has_array(hint) for hint in hints) or CALLS[code] >= CHECKED:
                return defined
            if not of_class:
                return _checked_first(cache(lambda: wrap(defined)), plain)
            checked = wrap(defined)
            initialise = checked.__init__
            checked.__init__ = _checked_first(lambda: initialise, plain)
            return checked

        return decorate

    return decorated


def _checked_first(checked: Callable[[], Any], plain: Callable[..., Any]) -> Callable[..., Any]:
    """The checked function, made at its first call, in its first calls of a test; the plain one later."""
    code = id(plain.__code__)

    @wraps(plain)
    def call(*args: Any, **named: Any) -> Any:
        CALLS[code] += 1
        return (checked() if CALLS[code] <= CHECKED else plain)(*args, **named)

    return call
