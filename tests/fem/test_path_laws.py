"""The laws that effects bring, against closed forms, their own energies and each other."""

import numpy as np
import pytest
from coarse_fruit import NU

from fem.elements.assembly import unit_lame_constants
from fem.materials.fung_neo_hookean import (
    first_piola_stress,
    fung_at_small_strain,
    fung_neo_hookean,
    shrunk_as_a_whole,
)
from fem.materials.mullins_damage import mullins_damage
from fem.materials.relaxing_arm import RelaxingArm
from fem.materials.strain_path import linear_stress, strain_energy
from fem.materials.von_mises_set import HARDENING, plastic_strain, von_mises_set

MU, LAME = unit_lame_constants(NU)


def tensors(*frames: np.ndarray) -> np.ndarray:
    """One point in four copies, frame by frame; [i, j] = du_i/dX_j is handed over as [j, i]."""
    return np.broadcast_to(np.stack([f.T for f in frames], axis=-1), (1, 4, 3, 3, len(frames))).copy()


def stress_at(H: np.ndarray, b: float) -> np.ndarray:
    return first_piola_stress(tensors(H), b, poisson_ratio=NU)[0, 0, :, :, 0].T


def stored_energy(H: np.ndarray, b: float) -> float:
    F = np.eye(3) + H
    log_J = np.log(np.linalg.det(F))
    W = MU / 2 * ((F**2).sum() - 3 - 2 * log_J) + LAME / 2 * log_J**2
    return MU / b * np.expm1(b * W / MU)


def test_stiffening_stress_is_the_slope_of_its_stored_energy():
    H = np.random.default_rng(0).normal(size=(3, 3)) * 0.08
    h, b = 1e-5, 40.0
    slope = np.empty((3, 3))
    for i, j in np.ndindex(3, 3):
        way = np.zeros((3, 3))
        way[i, j] = h
        slope[i, j] = (stored_energy(H + way, b) - stored_energy(H - way, b)) / (2 * h)
    np.testing.assert_allclose(stress_at(H, b), slope, rtol=1e-5, atol=1e-7)


def test_turning_the_strained_flesh_turns_its_stress():
    H = np.random.default_rng(1).normal(size=(3, 3)) * 0.08
    turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    turned = turn @ (np.eye(3) + H) - np.eye(3)
    np.testing.assert_allclose(stress_at(turned, 30.0), turn @ stress_at(H, 30.0), atol=1e-10)


def test_shear_beyond_yield_sets_by_the_closed_form_and_unloading_keeps_the_set():
    Y, hardening = 0.1, HARDENING
    path = [0.0, 0.06, 0.12, 0.09, 0.06]
    frames = [np.array([[0, e, 0], [e, 0, 0], [0, 0, 0]]) for e in path]
    strain = plastic_strain(tensors(*frames), Y, poisson_ratio=NU)[0, 0, 0, 1]
    # tau = sqrt(3) 2 mu (e - e_p) = Y + H p with e_p = sqrt(3)/2 p
    p = (2 * np.sqrt(3) * MU * 0.12 - Y) / (3 * MU + hardening)
    assert 2 * np.sqrt(3) * MU * 0.06 < Y
    np.testing.assert_allclose(strain, np.sqrt(3) / 2 * p * np.array([0, 0, 1, 1, 1]), atol=1e-12)


def test_set_flesh_bears_the_yield_stress_and_its_hardening():
    H = np.random.default_rng(5).normal(size=(3, 3)) * 0.2
    gradient, Y = tensors(H), 0.05
    stress = (linear_stress(gradient, poisson_ratio=NU) + von_mises_set(Y, poisson_ratio=NU)(gradient))[
        0, 0, ..., 0
    ]
    shear = stress - np.trace(stress) / 3 * np.eye(3)
    plastic = plastic_strain(gradient, Y, poisson_ratio=NU)[0, 0, ..., 0]
    p = np.sqrt(2 / 3 * (plastic**2).sum())
    assert p > 0.05
    assert np.sqrt(1.5 * (shear**2).sum()) == pytest.approx(Y + HARDENING * p, rel=1e-12)


def test_damaged_flesh_bears_what_is_left_of_the_linear_stress():
    H = np.random.default_rng(6).normal(size=(3, 3)) * 0.1
    path = tensors(0.5 * H, H, 0.5 * H)
    linear = linear_stress(path, poisson_ratio=NU)
    W = strain_energy(path, poisson_ratio=NU)[0, 0]
    left = 1 + 0.4 * np.expm1(-np.array([W[0], W[1], W[1]]) / 0.002)
    borne = linear + mullins_damage(0.4, 0.002, poisson_ratio=NU)(path)
    np.testing.assert_allclose(borne, left * linear, rtol=1e-10)


def test_for_small_strains_stiffening_is_its_slope_in_b():
    """What is left beside it goes with the strain: a tenth of it, a tenth of that."""
    H = np.random.default_rng(7).normal(size=(3, 3))
    off = []
    for size in (1e-2, 1e-3):
        gradient = tensors(size * H)
        more = fung_neo_hookean(2.0, poisson_ratio=NU)(gradient) - fung_neo_hookean(0.0, poisson_ratio=NU)(
            gradient
        )
        slope = 2.0 * fung_at_small_strain(poisson_ratio=NU)(gradient)
        off.append(np.linalg.norm(more - slope) / np.linalg.norm(slope))
    assert off[1] < 0.02
    assert off[1] == pytest.approx(off[0] / 10, rel=0.3)


def test_an_evenly_strained_body_shrinks_to_where_its_force_is_the_linear_one():
    """In a body of one energy a exp(a^2 x) = 1, with x = b W/mu of the linear field."""
    x = np.array([0.1, 0.5, 2.0])
    energy = np.broadcast_to(x * MU / 30.0, (2, 4, 3))
    a, stiffness = shrunk_as_a_whole(energy, np.ones((2, 4)), 30.0, poisson_ratio=NU)
    np.testing.assert_allclose(a * np.exp(a**2 * x), 1.0, atol=3e-3)
    np.testing.assert_allclose(stiffness, np.exp(a**2 * x) * (1 + 2 * a**2 * x), rtol=1e-12)


def test_an_arm_is_the_same_told_by_what_relaxes_and_by_what_creeps():
    """The product of the two in the Laplace domain, s^2 E(s) J(s) = 1, for any s."""
    arm = RelaxingArm(g=0.3, tau_s=2.0)
    again = RelaxingArm.of_creep(arm.creep_share, arm.retardation_s)
    assert (again.g, again.tau_s) == pytest.approx((0.3, 2.0), rel=1e-14)
    for s in (0.01, 0.5, 20.0):
        relaxing = 1 - arm.g + arm.g * s / (s + 1 / arm.tau_s)
        creeping = 1 + arm.creep_share / (1 + s * arm.retardation_s)
        assert relaxing * creeping == pytest.approx(1.0, rel=1e-14)
