"""Published laws of silicone against the derivatives of their energies and closed forms of their moduli."""

import numpy as np
import pytest
from silicone_cylinders import published_stress
from silicone_published import initial_slope_kPa

LAWS = {
    "Neo Hookean": ((18.9,), lambda p, x, y: p[0] / 2 * x, 3 * 18.9),
    "Mooney Rivlin": (
        (23.0, -13.0, 4.4),
        lambda p, x, y: p[0] * x + p[1] * y + p[2] * x**2,
        6 * (23.0 - 13.0),
    ),
    "Yeoh": ((7.4, 0.02, 0.13), lambda p, x, y: p[0] * x + p[1] * x**2 + p[2] * x**3, 6 * 7.4),
    "Veronda Westmann": (
        (106.0, 0.23),
        lambda p, x, y: p[0] * (np.exp(p[1] * x) - 1) - p[0] * p[1] / 2 * y,
        3 * 106.0 * 0.23,
    ),
    "Humphrey": ((38.9, 0.17), lambda p, x, y: p[0] * (np.exp(p[1] * x) - 1), 6 * 38.9 * 0.17),
}
"""Parameters, energy, and initial modulus."""


STRETCH, STEP = np.array([0.4, 0.7, 0.95, 1.1]), 1e-5


def slope(energy_of):
    return (energy_of(STRETCH + STEP) - energy_of(STRETCH - STEP)) / (2 * STEP)


@pytest.mark.parametrize("name", LAWS)
def test_each_published_law_is_the_derivative_of_its_energy(name):
    p, energy, modulus = LAWS[name]
    stress = slope(lambda s: energy(p, s**2 + 2 / s - 3, 2 * s + s**-2 - 3))
    assert published_stress(name, np.array(p), STRETCH) == pytest.approx(stress, rel=1e-6)
    assert initial_slope_kPa(name, np.array(p)) == pytest.approx(modulus, rel=1e-6)


def test_ogdens_parameters_are_moduli_first():
    p = np.array([10.4, -0.05, 2.85, -5.2])
    terms = ((10.4, 2.85), (-0.05, -5.2))
    stress = slope(lambda s: sum(mu / a * (s**a + 2 * s ** (-a / 2) - 3) for mu, a in terms))
    assert published_stress("Ogden", p, STRETCH) == pytest.approx(stress, rel=1e-6)
    assert initial_slope_kPa("Ogden", p) == pytest.approx(1.5 * (10.4 * 2.85 + 0.05 * 5.2), rel=1e-6)
