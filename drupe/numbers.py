"""Checks the user's arrays; the error names array, shape and expected shape."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from drupe.refusal import DrupeError

PerPad: TypeAlias = Sequence[ArrayLike] | np.ndarray
"""An array per pad: left, right; or the only one."""
Length: TypeAlias = int | None
"""Required length of an axis; None: any from 1 on."""


def per_pad(name: str, arrays: PerPad) -> list[ArrayLike]:
    """The entries of `arrays`, one per pad. Raises DrupeError for a mapping, a text or a scalar."""
    if isinstance(arrays, Mapping | str) or not np.iterable(arrays):
        raise DrupeError(f"{name}: found {type(arrays).__name__}, expected a sequence with an array per pad")
    return list(arrays)


def numbers(name: str, values: ArrayLike, shape: tuple[Length, ...], *, whole: bool = False) -> np.ndarray:
    """`values` as an array of `shape`, float64 or, with `whole`, int64. Raises DrupeError for another shape
    or type, for masked or non-finite values and, with `whole`, for fractions.

    >>> numbers("centre_mm", [0, 0, 30], (3,))
    array([ 0.,  0., 30.])
    >>> numbers("centre_mm", [0, 0], (3,))
    Traceback (most recent call last):
    drupe.refusal.DrupeError: centre_mm: found shape (2,), expected (3,)
    """
    wanted = (
        "(" + ", ".join("1 or more" if n is None else str(n) for n in shape) + ("," * (len(shape) == 1)) + ")"
    )
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise DrupeError(f"{name}: found no array ({error}), expected shape {wanted}") from None
    if array.dtype.kind not in "biuf":
        raise DrupeError(f"{name}: found values of type {array.dtype}, expected numbers of shape {wanted}")
    fits = len(array.shape) == len(shape) and all(
        have > 0 if want is None else have == want for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        raise DrupeError(f"{name}: found shape {array.shape}, expected {wanted}")
    if np.ma.is_masked(values):  # np.asarray drops the mask
        raise DrupeError(f"{name}: found masked values, expected a number in each place")
    if bad := int((~np.isfinite(array)).sum()):
        where = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        raise DrupeError(f"{name}: found {bad} values NaN or infinite, the first at {where}, expected none")
    if whole and (array.dtype.kind == "f" and (array != np.round(array)).any()):
        raise DrupeError(f"{name}: found fractions, expected whole numbers")
    return array.astype(np.int64 if whole else np.float64)
