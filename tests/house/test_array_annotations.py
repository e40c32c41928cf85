"""Array shapes and dtypes that functions declare are checked in tests (tests/conftest.py)."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from array_annotations import CHECKED
from jaxtyping import TypeCheckError

from tactile.gel.force_inverse import ActiveSet
from tactile.gel.grid import GelGrid, motion_of, smooth_precision


class OfNoGrid:
    """A result of smooth_precision with a wrong shape."""

    smooth_share = np.ones((6, 1))


def active_set(**changed: Any) -> ActiveSet:
    sound = {"touching": np.zeros(2, dtype=bool), "unknowns": np.zeros(6), "push_sd": np.zeros(2)}
    return ActiveSet(**{**sound, "log_likelihood": 0.0, **changed})


@pytest.mark.parametrize(
    "called",
    [
        lambda: motion_of(np.zeros((3, 2))),
        lambda: motion_of(np.zeros((3, 3), dtype=int)),
        lambda: smooth_precision(OfNoGrid(), 1.0),
        lambda: active_set(touching=np.zeros(2)),
        lambda: active_set(push_sd=np.zeros(3)),
    ],
    ids=["shape", "dtype", "result", "dtype of a field", "sizes of two fields"],
)
def test_an_array_of_another_shape_or_dtype_is_caught(called: Callable[[], object]) -> None:
    with pytest.raises(TypeCheckError):
        called()


def test_sound_arrays_pass_and_annotations_stay() -> None:
    assert motion_of(np.zeros((3, 3))) == 0.1
    assert active_set().push_sd.shape == (2,)
    assert set(motion_of.__annotations__) == {"y", "return"}
    assert motion_of.__annotations__["return"] is float
    assert smooth_precision.__annotations__["grid"] is GelGrid


@pytest.mark.parametrize("time", [1, 2])
def test_each_test_checks_the_first_calls_and_no_more(time: int) -> None:
    for _ in range(CHECKED):
        with pytest.raises(TypeCheckError):
            motion_of(np.zeros((time, 2)))
    motion_of(np.zeros((time, 2)))
