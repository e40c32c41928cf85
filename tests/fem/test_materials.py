"""Every law against its own energy, against Hooke's law, and against closed forms of simple states."""

import numpy as np
import pytest
from decoupled_neo_hookean import DecoupledNeoHookean
from hookes_law import Linear
from refusals import refused
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from fem.elements.assembly import unit_lame_constants
from fem.fem_failure import FemProblem
from fem.materials.fung_neo_hookean import (
    first_piola_stress,
    fung_at_small_strain,
    fung_neo_hookean,
    shrunk_as_a_whole,
)
from fem.materials.mullins_damage import mullins_damage
from fem.materials.neo_hookean import NeoHookean
from fem.materials.relaxing_arm import RelaxingArm
from fem.materials.strain_path import linear_stress, strain_energy
from fem.materials.von_mises_set import HARDENING, plastic_strain, von_mises_set

NU = 0.45


def energy(law, F):
    """W at E = 1 MPa, written down anew: Hooke, Bonet and Wood, or shape and volume apart."""
    mu, lame = 0.5 / (1 + NU), NU / ((1 + NU) * (1 - 2 * NU))
    squares, J = (F**2).sum(axis=(1, 2)), np.linalg.det(F)
    if isinstance(law, Linear):
        return np.einsum("qij,qij->q", law.stress(F), F - np.eye(3)) / 2
    if isinstance(law, NeoHookean):
        return mu / 2 * (squares - 3 - 2 * np.log(J)) + lame / 2 * np.log(J) ** 2
    return mu / 2 * (J ** (-2 / 3) * squares - 3) + (lame + 2 / 3 * mu) / 2 * (J - 1) ** 2


FINITE = [NeoHookean(poisson_ratio=NU), DecoupledNeoHookean(poisson_ratio=NU)]
EVERY = [Linear(poisson_ratio=NU), *FINITE]


def name(law):
    return type(law).__name__


def strained(count: int, size: float, seed: int = 0) -> np.ndarray:
    return np.eye(3) + size * np.random.default_rng(seed).uniform(-1, 1, (count, 3, 3))


def slope_of(function, F: np.ndarray, h: float) -> np.ndarray:
    """Central differences to every component of F, last two axes."""
    columns = []
    for k in range(9):
        step = h * np.eye(9)[k].reshape(3, 3)
        columns.append((function(F + step) - function(F - step)) / (2 * h))
    return np.stack(columns, axis=-1).reshape(*columns[0].shape, 3, 3)


@pytest.mark.parametrize("law", EVERY, ids=name)
@pytest.mark.parametrize("derivative", ["stress", "tangent"])
def test_stress_and_tangent_are_derivatives_of_energy_and_stress(law, derivative):
    F = strained(20, 0.25)
    exact = getattr(law, derivative)(F)
    of = law.stress if derivative == "tangent" else lambda at: energy(law, at)
    off = [np.abs(slope_of(of, F, h) - exact).max() for h in (4e-3, 2e-3, 1e-3)]
    if off[0] < 1e-10:  # a polynomial of second degree: differences are exact
        return
    assert np.array(off[:-1]) / off[1:] == pytest.approx(4.0, rel=0.05)  # error like h^2
    assert off[-1] < 2e-4 * np.abs(exact).max()


@pytest.mark.parametrize("law", FINITE, ids=name)
def test_a_turned_body_turns_its_stress_and_flesh_has_no_grain(law):
    Q = Rotation.random(12, rng=np.random.default_rng(1)).as_matrix()
    F = strained(12, 0.3)
    assert np.abs(law.stress(Q @ F) - Q @ law.stress(F)).max() < 1e-12
    assert np.abs(law.stress(F @ Q) - law.stress(F) @ Q).max() < 1e-12


@pytest.mark.parametrize("law", EVERY, ids=name)
@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_small_strain_is_hookes_law_of_unit_modulus(law, poisson_ratio):
    law = type(law)(**{**vars(law), "poisson_ratio": poisson_ratio})
    hooke = Linear(poisson_ratio=poisson_ratio)
    here = np.eye(3)[None]
    assert np.abs(law.tangent(here) - hooke.tangent(here)).max() < 1e-13 / (1 - 2 * poisson_ratio)
    off = []
    for size in (2e-3, 1e-3):
        F = strained(5, size)
        off.append(np.abs(law.stress(F) - hooke.stress(F)).max() / np.abs(hooke.stress(F)).max())
    assert off[1] < 0.05 / (1 - 2 * poisson_ratio)
    if off[0] > 1e-12:
        assert off[0] / off[1] == pytest.approx(2.0, rel=0.1)  # second-order effects: half at half the strain


def pulled(law, stretch: float) -> float:
    """P_11 of a bar that is stretched and free at its sides."""

    def F(across: float) -> np.ndarray:
        return np.diag([stretch, across, across])[None]

    across = brentq(lambda a: law.stress(F(a))[0, 1, 1], 0.5 * stretch**-0.5, 1.5 * stretch**-0.5, xtol=1e-15)
    return float(law.stress(F(across))[0, 0, 0])


@pytest.mark.parametrize("stretch", [0.6, 0.9, 1.3, 1.7])
@pytest.mark.parametrize("law", FINITE, ids=name)
def test_a_pulled_bar_of_constant_volume_follows_the_closed_form(law, stretch):
    """P = mu (l - l^-2); Treloar, "The Physics of Rubber Elasticity", 1975."""
    per_mu = []
    for poisson_ratio in (0.4998, 0.4999):
        nearly = type(law)(**{**vars(law), "poisson_ratio": poisson_ratio})
        per_mu.append(pulled(nearly, stretch) * 2 * (1 + poisson_ratio))
    # what change of volume is left goes like 1 - 2 nu
    limit = 2 * per_mu[1] - per_mu[0]
    assert limit == pytest.approx(stretch - stretch**-2, rel=1e-3)


@pytest.mark.parametrize("law", FINITE, ids=name)
def test_simple_shear_follows_the_closed_form(law):
    """For F = I + g e1 e2', J = 1: s_12 = mu g, s_11 - s_22 = mu g^2, s_22 = s_33."""
    g = 0.4
    F = np.eye(3)[None].copy()
    F[0, 0, 1] = g
    cauchy = (law.stress(F) @ F.swapaxes(1, 2))[0]
    mu = 0.5 / (1 + NU)
    assert cauchy[0, 1] == pytest.approx(mu * g, rel=1e-12)
    assert cauchy[0, 0] - cauchy[1, 1] == pytest.approx(mu * g**2, rel=1e-12)
    assert cauchy[1, 1] == pytest.approx(cauchy[2, 2], rel=1e-12)
    trace = mu * g**2 if isinstance(law, NeoHookean) else 0.0
    assert np.trace(cauchy) == pytest.approx(trace, abs=1e-14)


@pytest.mark.parametrize("stretch", [0.7, 0.95, 1.2])
def test_stretch_in_all_directions_follows_the_closed_forms(stretch):
    """P = mu (l - 1/l) + 3 lambda ln(l) / l (Bonet and Wood 2008), P = K (l^3 - 1) l^2 decoupled."""
    mu, lam = 0.5 / (1 + NU), NU / ((1 + NU) * (1 - 2 * NU))
    of_flesh = mu * (stretch - 1 / stretch) + 3 * lam * np.log(stretch) / stretch
    decoupled = (lam + 2 * mu / 3) * (stretch**3 - 1) * stretch**2
    for law, expected in zip(FINITE, (of_flesh, decoupled), strict=True):
        P = law.stress(stretch * np.eye(3)[None])[0]
        assert pytest.approx(expected * np.eye(3), rel=1e-12, abs=1e-14) == P


@pytest.mark.parametrize("law", FINITE, ids=name)
def test_matter_cannot_be_turned_inside_out(law):
    assert np.isnan(law.stress(np.diag([1.0, 1.0, -0.2])[None])).any()


def test_a_poisson_ratio_beyond_one_half_is_refused():
    with refused(FemProblem.BAD_POISSON_RATIO):
        NeoHookean(poisson_ratio=0.5).stress(np.eye(3)[None])


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
    p = np.sqrt(2 / 3 * (plastic_strain(gradient, Y, poisson_ratio=NU)[0, 0, ..., 0] ** 2).sum())
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
