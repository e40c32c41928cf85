import numpy as np
import pytest
from periodic_slab import traction_response

from samples.gel_press import gel_block
from tactile.gel.slab import GelSlab, SpringBed, tent_compliance

SOFT = GelSlab(thickness_mm=4.0, E_MPa=0.2, nu=0.48)


def test_even_pressure_meets_the_oedometric_modulus_and_even_shear_the_shear_modulus() -> None:
    load = np.broadcast_to([0.01, 0.02, -0.05], (8, 8, 3))
    moved = traction_response(SOFT, load, spacing_mm=1.0)
    mu = 0.2 / (2 * 1.48)
    oedometric = 0.2 * 0.52 / (1.48 * 0.04)
    expected = [0.01 * 4 / mu, 0.02 * 4 / mu, -0.05 * 4 / oedometric]
    np.testing.assert_allclose(moved, np.broadcast_to(expected, moved.shape), rtol=1e-6)


@pytest.mark.parametrize("nu", [0.2, 0.35, 0.499])
def test_a_thick_slab_is_the_half_space_of_boussinesq_and_cerruti(nu: float) -> None:
    """The transforms of 1/r and of its gradients: with k h = 40 the back is out of reach."""
    E, k = 0.3, np.array([2.0, 5.0])
    found = GelSlab(thickness_mm=20.0, E_MPa=E, nu=nu).spectrum(k) * k[:, None]
    boussinesq, drawn = 2 * (1 - nu**2) / E, (1 + nu) * (1 - 2 * nu) / E
    across = 2 * (1 + nu) / E
    np.testing.assert_allclose(found, np.tile([boussinesq, drawn, boussinesq, across], (2, 1)), rtol=1e-7)


def test_loads_and_displacements_are_reciprocal() -> None:
    rng = np.random.default_rng(3)
    first, second = rng.normal(size=(2, 16, 12, 3))
    one = np.sum(first * traction_response(SOFT, second, spacing_mm=0.7))
    two = np.sum(second * traction_response(SOFT, first, spacing_mm=0.7))
    assert one == pytest.approx(two, rel=1e-10)


def test_pressing_an_almost_incompressible_slab_pushes_its_face_outward() -> None:
    """A half space would be drawn in: the bonded back makes the difference."""
    C = tent_compliance(SOFT, np.array([[4.0, 0.0]]), np.zeros((1, 2)), pitch_mm=1.0)
    assert -C[0, 0, 0, 2] > 0
    assert -C[0, 2, 0, 2] > 0


def test_tents_of_a_grid_add_up_to_an_even_traction() -> None:
    slab = GelSlab(thickness_mm=1.0, E_MPa=0.2, nu=0.48)
    line = np.arange(-10.0, 10.5, 0.5)
    nodes = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    C = tent_compliance(slab, np.array([[0.2, 0.1]]), nodes, pitch_mm=0.5)
    moved = C[0].sum(axis=1) @ [0.0, 0.0, 0.05 * 0.5**2]
    assert moved[2] == pytest.approx(0.05 * 1.48 * 0.04 / (0.2 * 0.52), rel=0.01)


def test_the_slab_agrees_with_finite_elements_of_a_block_with_free_sides() -> None:
    """A smooth bump of traction, 1.5 mm in radius, on 14 x 14 x 2 mm of gel: within 3 % of the peak."""
    sides = [-7, -4.2, -2.8, -2.1, -1.4, -0.7, 0, 0.7, 1.4, 2.1, 2.8, 4.2, 7]
    block = gel_block(
        thickness_mm=2.0, E_MPa=0.2, nu=0.48, reach_mm=1.9, x_mm=sides, y_mm=sides, depths=(0, 0.4, 1)
    )
    r = np.linalg.norm(block.face_mm, axis=1)
    bump = np.where(r < 1.9, (1 - np.minimum(r / 1.9, 1) ** 2) ** 2, 0.0) * 0.05
    spacing, n = 0.175, 192
    axis = spacing * np.fft.fftfreq(n, 1 / n)
    R = np.hypot(axis[:, None], axis)
    slab = GelSlab(thickness_mm=2.0, E_MPa=0.2, nu=0.48)
    near = np.flatnonzero(r < 3.1)
    at = np.rint(block.face_mm[near] / spacing).astype(int)
    for component in (0, 2):
        nodal = np.zeros((len(r), 3))
        nodal[:, component] = bump * block.weights_mm2
        by_elements = (block.compliance @ nodal[block.reach].ravel()).reshape(-1, 3)[near]
        load = np.zeros((n, n, 3))
        load[..., component] = np.where(R < 1.9, (1 - np.minimum(R / 1.9, 1) ** 2) ** 2, 0.0) * 0.05
        by_slab = traction_response(slab, load, spacing_mm=spacing)[at[:, 0], at[:, 1]]
        by_slab *= nodal[:, component].sum() / (load[..., component].sum() * spacing**2)
        peak = np.abs(by_elements).max()
        np.testing.assert_allclose(by_slab, by_elements, atol=0.03 * peak)


def test_springs_give_way_alone() -> None:
    bed = SpringBed(kn_MPa_per_mm=0.2, kt_MPa_per_mm=0.05)
    load = np.zeros((16, 16, 3))
    load[3, 4] = [0.01, 0.0, 0.04]
    moved = traction_response(bed, load, spacing_mm=0.5)
    np.testing.assert_allclose(moved[3, 4], [0.2, 0.0, 0.2], atol=1e-12)
    moved[3, 4] = 0.0
    np.testing.assert_allclose(moved, 0.0, atol=1e-12)


def test_one_tents_table_is_what_the_grid_of_wave_vectors_gives() -> None:
    """All nine components at points off every axis, through the complex transforms of the whole plane."""
    slab, pitch, fine = GelSlab(thickness_mm=1.5, E_MPa=0.3, nu=0.46), 0.8, 0.1
    axis = fine * np.arange(-200, 200)
    tent = np.maximum(1 - np.abs(axis) / pitch, 0) / pitch
    at = np.array([[0.3, 1.1], [-0.7, 0.4], [1.9, -0.2], [-1.2, -2.3]])
    C = tent_compliance(slab, at, np.zeros((1, 2)), pitch_mm=pitch)
    rows, columns = (np.rint(at / fine).astype(int) + 200).T
    for force in range(3):
        traction = np.zeros((400, 400, 3))
        traction[..., force] = tent[:, None] * tent
        moved = traction_response(slab, traction, spacing_mm=fine)
        np.testing.assert_allclose(C[:, :, 0, force], moved[rows, columns], atol=2e-4 * np.abs(C).max())
