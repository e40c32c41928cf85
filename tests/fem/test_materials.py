"""Every law against its own energy, against Hooke's law, and against closed forms of simple states."""

import numpy as np
import pytest
from decoupled_neo_hookean import DecoupledNeoHookean
from hookes_law import Linear
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from fem.fem_failure import FemFailure, FemProblem
from fem.materials.neo_hookean import NeoHookean

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
    inside_out = np.diag([1.0, 1.0, -0.2])[None]
    assert np.isnan(law.stress(inside_out)).any()


def test_a_poisson_ratio_beyond_one_half_is_refused():
    with pytest.raises(FemFailure) as refused:
        NeoHookean(poisson_ratio=0.5).stress(np.eye(3)[None])
    assert refused.value.problem is FemProblem.BAD_POISSON_RATIO
