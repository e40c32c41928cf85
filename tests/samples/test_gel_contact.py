import numpy as np
import pytest

from samples.gel_contact import Gel, traction

GEL = Gel(kn_MPa_per_mm=0.2, kt_MPa_per_mm=0.05, friction=0.5)


def test_shear_sticks_then_slips_on_the_cone() -> None:
    position = np.array([[0.5, 0.0, -1.0], [4.0, 0.0, -1.0], [0.0, 3.0, 0.2]])
    force, _ = traction(GEL, position, np.zeros((3, 2)))
    assert force == pytest.approx(np.array([[-0.025, 0, 0.2], [-0.1, 0, 0.2], [0, 0, 0]]))


def test_traction_slope_matches_differences() -> None:
    rng = np.random.default_rng(1)
    position, anchor = rng.normal(size=(50, 3)), rng.normal(size=(50, 2))
    _, slope = traction(GEL, position, anchor)
    for axis in range(3):
        push = np.zeros(3)
        push[axis] = 1e-6
        difference = (
            traction(GEL, position + push, anchor)[0] - traction(GEL, position - push, anchor)[0]
        ) / 2e-6
        assert slope[:, :, axis] == pytest.approx(difference, abs=1e-6)
