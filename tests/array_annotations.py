"""The checker of tests/conftest.py: beartype on the rooms' array annotations, and on no others.

Types that are not arrays are mypy's matter; tests may hand in simpler objects in their place.
An axis named with an underscore (`list[Float[np.ndarray, "_f _n 3"]]`) may have another size in each array of
a container; one named without has the same size wherever the name stands in a signature.
"""

import dataclasses
import functools
import inspect
import threading
import types
from collections.abc import Callable
from typing import Any, TypeVar, Union, get_args, get_origin

import numpy as np
from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, config

F = TypeVar("F", bound=Callable[..., Any])
Wrap = Callable[[Any], Any]
UNKNOWN = object()
"""The form of what has to be checked each time, as a list, of which one item is looked at."""
PLAIN = frozenset({type(None), bool, int, float, str, np.bool_, np.int64, np.float64})


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

    Nothing of them would be checked, but each call would be bound to its signature all the same; likewise a
    result that is no array is not looked at, which else has the arguments checked a second time.
    """

    def decorated(*context: Any, **options: Any) -> Any:
        if context:  # no decorator: jaxtyped("context") of a with statement
            return jaxtyped(*context, **options)
        wrap = jaxtyped(**options)

        def decorate(defined: Any) -> Any:
            function = _function_of(defined)
            hints = getattr(function, "__annotations__", {})
            named = {name for name, hint in hints.items() if isinstance(hint, str) or has_array(hint)}
            if not named:
                return defined
            checked = _checked_once_per_form(defined, hints, wrap)
            if checked is not None:
                return checked
            if "return" in named or "return" not in hints:
                return wrap(defined)
            function.__annotations__ = {name: hint for name, hint in hints.items() if name != "return"}
            wrapped = wrap(defined)
            function.__annotations__ = _function_of(wrapped).__annotations__ = hints
            return wrapped

        return decorate

    return decorated


def _checked_once_per_form(defined: Any, hints: dict[str, Any], wrap: Wrap) -> Any:
    """The function or dataclass, what is handed to it checked where dtypes and shapes are new; None for what
    cannot be done so.

    A check depends on dtypes and shapes alone: arguments and results that are alike in these are sound or
    unsound together.
    """
    of_class = dataclasses.is_dataclass(defined)
    function = defined.__init__ if of_class else defined
    if getattr(function, "checked_once_per_form", False):
        return defined  # of a class, by its parent
    if not isinstance(function, types.FunctionType) or any(isinstance(hint, str) for hint in hints.values()):
        return None
    if function.__code__.co_flags & (inspect.CO_VARARGS | inspect.CO_VARKEYWORDS):
        return None
    if not _has_form(hints.get("return")):
        return None
    checked = _remembering(function, hints, wrap)
    if not of_class:
        return checked
    defined.__init__ = checked
    return defined


def _has_form(hint: Any) -> bool:
    """Whether a result's form says all that a check of this hint looks at.

    >>> from jaxtyping import Float
    >>> _has_form(tuple[Float[np.ndarray, "n 3"], int]), _has_form(list[Float[np.ndarray, "n 3"]])
    (True, False)
    """
    if not has_array(hint) or isinstance(hint, type):
        return True
    fixed = get_origin(hint) in (Union, types.UnionType, tuple) and Ellipsis not in get_args(hint)
    return fixed and all(_has_form(part) for part in get_args(hint))


def _nothing() -> None:
    """In place of a call that was made."""


class _Checks(threading.local):
    """The call that the checker makes between arguments and result."""

    call: Callable[[], Any] = _nothing


@dataclasses.dataclass(frozen=True)
class _Checker:
    """Of one function: `places` and `names` of its arguments that hold arrays; `sound`: forms of arguments,
    and of results given them, that passed.
    """

    code: types.CodeType
    run: Callable[..., Any]
    checks: _Checks
    places: list[int]
    names: list[str]
    gives_array: bool
    sound: dict[Any, set[Any]]


_CHECKERS: dict[tuple[int, str], _Checker] = {}
"""By code and hints: a function within a function is defined with each call, its checks once."""


def _checker(function: Any, hints: dict[str, Any], wrap: Wrap) -> _Checker:
    key = id(function.__code__), repr(hints)
    if key not in _CHECKERS:
        checks = _Checks()
        signature = inspect.signature(function)
        gives_array = has_array(hints.get("return"))

        @functools.wraps(function)
        def called(*args: Any, **named: Any) -> Any:
            call, checks.call = checks.call, _nothing
            return call()

        called.__annotations__ = {
            name: hint for name, hint in hints.items() if name != "return" or gives_array
        }
        called.__signature__ = signature.replace(  # type: ignore[attr-defined]
            **({} if gives_array else {"return_annotation": inspect.Signature.empty})
        )
        _CHECKERS[key] = _Checker(
            code=function.__code__,
            run=wrap(called),
            checks=checks,
            places=[k for k, name in enumerate(signature.parameters) if has_array(hints.get(name))],
            names=[name for name, hint in hints.items() if name != "return" and has_array(hint)],
            gives_array=gives_array,
            sound={},
        )
    return _CHECKERS[key]


def _remembering(function: Any, hints: dict[str, Any], wrap: Wrap) -> Any:
    """The checker is made at the first call: most functions are called in few of the tests' processes."""
    made: list[_Checker] = []

    @functools.wraps(function)
    def checked(*args: Any, **named: Any) -> Any:
        if config.jaxtyping_disable:
            return function(*args, **named)
        if not made:
            made.append(_checker(function, hints, wrap))
        known = made[0]
        count = len(args)
        form: Any = tuple([_form(args[k]) if k < count else None for k in known.places])
        if named:
            form = form, tuple([(name, _form(named[name])) for name in known.names if name in named])
        if UNKNOWN in form or (
            named and (UNKNOWN in form[0] or any(argument_form is UNKNOWN for _, argument_form in form[1]))
        ):
            known.checks.call = lambda: function(*args, **named)
            return known.run(*args, **named)
        results = known.sound.get(form)
        if results is None:
            known.checks.call = lambda: function(*args, **named)
            result = known.run(*args, **named)
            known.sound[form] = {_form_of_result(result)} if known.gives_array else set()
            return result
        result = function(*args, **named)
        if known.gives_array:
            of_result = _form_of_result(result)
            if of_result is UNKNOWN or of_result not in results:
                known.checks.call = lambda: result
                known.run(*args, **named)
                results.add(of_result)
        return result

    checked.checked_once_per_form = True  # type: ignore[attr-defined]
    return checked


def _form(value: Any) -> Any:
    kind = type(value)
    if kind is np.ndarray:
        return value.dtype, value.shape
    return kind if kind in PLAIN else UNKNOWN


def _form_of_result(value: Any) -> Any:
    if type(value) is not tuple:
        return _form(value)
    forms = tuple([_form(element) for element in value])
    return UNKNOWN if UNKNOWN in forms else forms


def _function_of(defined: Any) -> Any:
    """Of a method of a class or a property its function, of a class how it is made."""
    function = getattr(defined, "__func__", None) or getattr(defined, "fget", None) or defined
    return function.__init__ if inspect.isclass(function) else function
