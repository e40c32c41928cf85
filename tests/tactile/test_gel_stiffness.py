import numpy as np
import pytest

from tactile.gel.press_modulus import gel_gain
from tactile.tactile_failure import TactileFailure

PRESS = np.concatenate([np.zeros(5), np.linspace(0, 4, 20), np.full(5, 4.0), np.linspace(4, 0, 10)])


def test_the_gain_is_load_cell_over_gel_whatever_the_signs() -> None:
    assert gel_gain(-1.3 * PRESS, PRESS, source="p").value == pytest.approx(1.3)


def test_the_stated_deviation_is_that_of_repeated_presses() -> None:
    rng = np.random.default_rng(0)
    found = [gel_gain(1.3 * PRESS + rng.normal(scale=0.05, size=40), PRESS, source="p") for _ in range(400)]
    assert np.std([g.value for g in found]) == pytest.approx(np.mean([g.sd for g in found]), rel=0.15)


def test_too_short_a_press_is_refused() -> None:
    with pytest.raises(
        TactileFailure, match="flat: found 3 frames in which gel and load cell measure the press"
    ):
        gel_gain(np.array([0, 1.0, 1, 1, 0]), np.array([0, 1.0, 1, 1, 0]), source="flat")


def test_a_load_cell_that_felt_something_else_is_refused() -> None:
    with pytest.raises(
        TactileFailure, match="one line through zero; check that the whole contact is in view"
    ):
        gel_gain(np.roll(PRESS, 8), PRESS, source="flat")
