"""The checker of tests/conftest.py: beartype on the rooms' array annotations, and on no others.

Types that are not arrays are mypy's matter; tests may hand in simpler objects in their place.
An axis named with an underscore (`list[Float[np.ndarray, "_f _n 3"]]`) may have another size in each array of
a container; one named without has the same size wherever the name stands in a signature.
"""

import inspect
from collections.abc import Callable
from typing import Any, TypeVar, get_args

from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray

F = TypeVar("F", bound=Callable[..., Any])


def check(function: F) -> F:
    """The function with its arguments and result held against their dtypes and shapes."""
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


def only_with_arrays(jaxtyped: Callable[..., Any]) -> Callable[..., Any]:
    """jaxtyping's decorator, which leaves functions alone whose annotations name no array.

    Nothing of them would be checked, but each call would be bound to its signature all the same.
    """

    def decorated(*context: Any, **options: Any) -> Any:
        if context:  # no decorator: jaxtyped("context") of a with statement
            return jaxtyped(*context, **options)
        wrap = jaxtyped(**options)

        def decorate(defined: Any) -> Any:
            # of a method of a class or a property its function, of a class how it is made
            function = getattr(defined, "__func__", None) or getattr(defined, "fget", None) or defined
            function = function.__init__ if inspect.isclass(function) else function
            hints = getattr(function, "__annotations__", {}).values()
            return (
                wrap(defined) if any(isinstance(hint, str) or has_array(hint) for hint in hints) else defined
            )

        return decorate

    return decorated
