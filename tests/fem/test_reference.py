import numpy as np
import pytest

from fem.solid.closed_forms import (
    contact_shape_factor,
    hertz_sphere_force_N,
    s368_parallel_plates_modulus_MPa,
)


@pytest.mark.parametrize(
    ("theta_deg", "tabulated"), [(90, 1.351), (80, 1.342), (70, 1.314), (60, 1.267), (50, 1.198)]
)
def test_shape_factor_is_the_standards_table(theta_deg, tabulated):
    cosine = np.cos(np.radians(theta_deg))
    shape = contact_shape_factor(radius_mm=10 / (1 + cosine), other_radius_mm=10 / (1 - cosine))
    assert shape == pytest.approx(tabulated, abs=1.5e-3)


def test_shape_factor_does_not_jump_near_a_sphere():
    round_one = contact_shape_factor(radius_mm=30.0, other_radius_mm=30.0)
    assert contact_shape_factor(radius_mm=30.0, other_radius_mm=30.03) == pytest.approx(round_one, abs=1e-5)


def test_s368_gives_back_the_modulus_of_a_hertzian_sphere():
    force = hertz_sphere_force_N(E_MPa=0.7, poisson_ratio=0.45, radius_mm=30.0, indentation_mm=1.2)
    ball = {"poisson_ratio": 0.45, "radius_mm": 30.0, "other_radius_mm": 30.0, "force_N": force}
    assert s368_parallel_plates_modulus_MPa(deformation_mm=2.4, **ball) == pytest.approx(0.7, rel=1e-12)
