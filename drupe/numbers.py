"""Checks the user's arrays; the error names array, shape and expected shape."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from fem.fem_failure import FemFailure
from pipeline.batch.outcome import FruitEnded
from pipeline.files.whole_file import NotWritten
from pipeline.problem import BatchRefused
from recon.recon_failure import ReconFailure
from tactile.tactile_failure import TactileFailure


class DrupeError(ValueError):
    """The input gives no result. The text states the value found, the expected one, and the remedy."""


KNOWN = (BatchRefused, FemFailure, FruitEnded, NotWritten, ReconFailure, TactileFailure)


@contextmanager
def refusals(root: Path | None = None) -> Iterator[None]:
    """Converts failures of drupe's packages in the block to DrupeError; removes `root` from their paths."""
    try:
        yield
    except KNOWN as failure:
        sentence = str(failure)
        raise DrupeError(sentence if root is None else sentence.replace(f"{root}/", "")) from failure
    except ExceptionGroup as failures:
        if failures.split(KNOWN)[1] is not None:  # a fault of the program
            raise
        raise DrupeError(" ".join(str(failure) for failure in failures.exceptions)) from failures


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
    drupe.numbers.DrupeError: centre_mm: found shape (2,), expected (3,)
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
