"""What is injected into the flesh, against closed forms and limits in which it is nothing, or known."""

from dataclasses import replace

import numpy as np
import pytest
from mismatch_ball import ROUGH, drawn_ball, grasped_ball, motion, rough, total_N
from scipy.spatial.transform import Rotation

from samples.brick_flesh import BrickFlesh, flesh_of, rigid_tie
from samples.gel_contact import Gel
from samples.hexahedra import flesh_bricks
from samples.mismatch.altered_flesh import integration_points_mm, soft_spot, stiffer_along_stem, with_skin
from samples.mismatch.case_simulation import body_of
from samples.mismatch.flesh_laws import (
    Damaged,
    Draining,
    Lame,
    PlainFlesh,
    Relaxing,
    StiffeningFlesh,
    Yielding,
)
from samples.mismatch.grip import before_touch
from samples.mismatch.injected import InjectedEffect, plain_flesh
from samples.mismatch.nonlinear_body import NonlinearBody, whole_fruit
from samples.mismatch.true_recording import grip_of
from samples.sample_failure import NotInEquilibrium, SampleFailure

LAME = Lame(mu=0.2, lam=1.1)
PLAIN = PlainFlesh(lame=LAME)


def linear(H: np.ndarray) -> np.ndarray:
    """2 mu eps + lam tr(eps) I of one displacement gradient."""
    eps = (H + H.T) / 2
    return np.asarray(2 * LAME.mu * eps + LAME.lam * np.trace(eps) * np.eye(3))


@pytest.fixture(scope="module")
def flesh() -> BrickFlesh:
    bricks = flesh_bricks(drawn_ball().fruit, np.array([1.0, 0.0, 0.0]), ROUGH)
    return flesh_of(bricks, E_MPa=0.5, poisson_ratio=0.45)


def field(flesh: BrickFlesh, u_mm: np.ndarray) -> np.ndarray:
    """The unknowns that give the free nodes this displacement, the pit none."""
    return np.concatenate([u_mm[flesh.free_nodes].ravel(), np.zeros(6)])


def test_a_soft_spot_is_soft_inside_and_halfway_at_its_edge(flesh: BrickFlesh) -> None:
    centre = np.array([19.0, 0.0, 0.0])
    away = np.linalg.norm(integration_points_mm(flesh.bricks) - centre, axis=-1)
    ratio = soft_spot(flesh.bricks, centre_mm=centre, radius_mm=6.0, ratio=0.3)
    assert ratio[away < 3.0] == pytest.approx(0.3, abs=2e-3)
    assert ratio[away > 9.0] == pytest.approx(1.0, abs=2e-3)
    assert ratio[np.abs(away - 6.0).argmin() // 27, np.abs(away - 6.0).argmin() % 27] == pytest.approx(
        0.65, abs=0.1
    )


def test_a_swelling_skin_stores_what_a_spherical_membrane_stores(flesh: BrickFlesh) -> None:
    # even strain w / R both ways: energy 4 pi w^2 Et / (1 - nu)
    out = 0.1 * flesh.bricks.nodes_mm / np.linalg.norm(flesh.bricks.nodes_mm, axis=1, keepdims=True)
    q = field(flesh, out)
    energy = 0.5 * q @ with_skin(flesh, Et_N_per_mm=2.0, poisson_ratio=0.3) @ q
    assert energy == pytest.approx(4 * np.pi * 0.1**2 * 2.0 / 0.7, rel=0.01)


def test_stretch_along_the_stem_stores_more_by_the_share_said(flesh: BrickFlesh) -> None:
    e = 0.01
    u = np.zeros_like(flesh.bricks.nodes_mm)
    u[:, 2] = e * flesh.bricks.nodes_mm[:, 2]
    tie = rigid_tie(flesh.bricks, flesh.free_nodes, flesh.pit_centre_mm)
    q = field(flesh, u)
    strain = np.zeros_like(flesh.volumes)
    local = (tie @ q).reshape(-1, 3)[flesh.bricks.cells]
    strain = np.einsum("mgn,mn->mg", flesh.slopes[..., 2], local[..., 2])
    expected = 0.5 * 0.8 * flesh.mu_MPa * (flesh.volumes * strain**2).sum()
    assert 0.5 * q @ stiffer_along_stem(flesh, axial=0.8) @ q == pytest.approx(expected, rel=1e-9)


def test_held_force_relaxes_by_g_and_tau() -> None:
    # a gel much stiffer than flesh holds the skin still: force follows the modulus
    grasp, stands = rough(drawn_ball(E_MPa=0.125), motion([-0.001, 0.3]))
    law = Relaxing(plain=plain_flesh(stands.flesh), g=0.4, tau_s=0.8)
    body = NonlinearBody(whole_fruit(stands.flesh, stands.dofs), law)
    grip = grip_of(stands, gel=Gel(kn_MPa_per_mm=30.0, kt_MPa_per_mm=30.0, friction=5.0))
    instant = before_touch(grip, grasp.hold.origins(-0.001), body.begin())
    forces = []
    for pause_s in (1e-3, *[0.25] * 6):
        instant = body.advance(grip, instant, grasp.hold.origins(0.3), pause_s)
        forces.append(instant.force_N[grip.part(0)].reshape(-1, 3).sum(axis=0)[0])
    expected = 0.6 + 0.4 * np.exp(-0.25 * np.arange(7) / 0.8)
    assert np.array(forces) / forces[0] == pytest.approx(expected, abs=2e-3)


def test_the_stiffening_stress_is_the_slope_of_an_energy() -> None:
    # P = exp(b W/mu) dW/dF = d/dF of mu/b exp(b W/mu)
    b = 40.0

    def energy(F: np.ndarray) -> float:
        ln = np.log(np.linalg.det(F))
        W = LAME.mu / 2 * ((F * F).sum() - 3 - 2 * ln) + LAME.lam / 2 * ln**2
        return float(LAME.mu / b * np.exp(b * W / LAME.mu))

    H = 0.05 * np.random.default_rng(0).normal(size=(3, 3))
    stress = StiffeningFlesh(plain=PLAIN, b=b).stress(H[None], (), 1.0)[0][0]
    step = 1e-6
    slope = np.zeros((3, 3))
    for i in range(3):
        for k in range(3):
            d = np.zeros((3, 3))
            d[i, k] = step
            slope[i, k] = (energy(np.eye(3) + H + d) - energy(np.eye(3) + H - d)) / (2 * step)
    assert stress == pytest.approx(slope, rel=1e-5, abs=1e-8)


def test_every_law_is_hookes_for_small_strain() -> None:
    H = 1e-6 * np.random.default_rng(1).normal(size=(3, 3))
    for law in (
        PLAIN, StiffeningFlesh(plain=PLAIN, b=30.0), Damaged(plain=PLAIN, dmax=0.5, W0_MPa=1e-3),
        Yielding(plain=PLAIN, yield_MPa=0.03, hardening_MPa=0.1),
    ):  # fmt: skip
        assert law.stress(H[None], law.at_first((1,)), 1.0)[0][0] == pytest.approx(
            linear(H), rel=1e-4, abs=1e-11
        )


def test_stress_of_a_body_that_is_stretched_and_turned_turns_along() -> None:
    # P(R F) = R P(F) of every law, whatever it remembers
    rng = np.random.default_rng(2)
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    first, second = (np.eye(3) + 0.08 * rng.normal(size=(3, 3)) for _ in range(2))
    for law in (
        PlainFlesh(lame=LAME, ratio=np.array([0.7]), axial=0.8),
        StiffeningFlesh(plain=PLAIN, b=30.0),
        Relaxing(plain=PLAIN, g=0.4, tau_s=0.5),
        Draining(plain=PLAIN, volume_share=0.6, tau_s=0.5),
        Damaged(plain=PLAIN, dmax=0.5, W0_MPa=1e-3),
        Yielding(plain=PLAIN, yield_MPa=0.02, hardening_MPa=0.1),
    ):
        ends = []
        for Q in (np.eye(3), turn):
            _, state = law.stress((Q @ first - np.eye(3))[None], law.at_first((1,)), 0.2)
            ends.append(law.stress((Q @ second - np.eye(3))[None], state, 0.2)[0][0])
        assert ends[1] == pytest.approx(turn @ ends[0], abs=1e-12)


def test_a_bar_that_is_pulled_has_the_stress_of_its_closed_form() -> None:
    # free sides: mu (b^2 - 1) + lam ln(l b^2) = 0 for the side b, then P = mu (l - 1/l) + lam ln J / l
    stretch, side = 1.15, 1.0
    for _ in range(50):
        lnJ = np.log(stretch * side**2)
        side -= (LAME.mu * (side**2 - 1) + LAME.lam * lnJ) / (2 * LAME.mu * side + 2 * LAME.lam / side)
    stress = PLAIN.stress((np.diag([side, side, stretch]) - np.eye(3))[None], (), 1.0)[0][0]
    expected = LAME.mu * (stretch - 1 / stretch) + LAME.lam * np.log(stretch * side**2) / stretch
    assert stress == pytest.approx(np.diag([0.0, 0.0, expected]), abs=1e-12)


def test_sheared_flesh_yields_hardens_and_keeps_a_set() -> None:
    # small shear g: tau = mu g up to sy / sqrt 3, then d tau / dg = mu h / (3 mu + h) with h the hardening
    law = Yielding(plain=PLAIN, yield_MPa=3e-5, hardening_MPa=0.1)
    state = law.at_first((1,))
    first, end = 3e-5 / np.sqrt(3) / LAME.mu, 1.5e-4
    for g in np.linspace(0, end, 40):
        H = np.zeros((1, 3, 3))
        H[0, 0, 1] = g
        P, state = law.stress(H, state, 1.0)
    slope = LAME.mu * 0.1 / (3 * LAME.mu + 0.1)
    assert P[0, 0, 1] == pytest.approx(3e-5 / np.sqrt(3) + slope * (end - first), rel=1e-3)
    back, _ = law.stress(np.zeros((1, 3, 3)), state, 1.0)
    assert back[0, 0, 1] < 0


def test_damage_is_read_off_the_largest_energy() -> None:
    law = Damaged(plain=PLAIN, dmax=0.6, W0_MPa=1e-3)
    H = np.diag([0.08, 0.0, 0.0])[None]
    energy = PLAIN.energy(PLAIN.at(H))
    first, state = law.stress(H, law.at_first((1,)), 1.0)
    left = 1 - 0.6 * (1 - np.exp(-energy / 1e-3))
    assert first == pytest.approx(left * PLAIN.stress(H, (), 1.0)[0])
    later, _ = law.stress(H / 2, state, 1.0)
    assert later == pytest.approx(left * PLAIN.stress(H / 2, (), 1.0)[0])


def test_drained_flesh_loses_its_share_of_the_volume_stress() -> None:
    law = Draining(plain=PLAIN, volume_share=0.7, tau_s=0.5)
    H = 0.01 * np.eye(3)[None]
    _, state = law.stress(H, law.at_first((1,)), 1e-4)
    drained, _ = law.stress(H, state, 1.0)
    lost = 1.1 * 0.7 * 3 * np.log(1.01) * (1 - np.exp(-2.0)) / 1.01
    assert drained - PLAIN.stress(H, (), 1.0)[0] == pytest.approx(-lost * np.eye(3)[None], rel=1e-3, abs=1e-9)


def test_a_turned_fruit_bears_no_stress(flesh: BrickFlesh) -> None:
    # as the pit turns by 20 degrees; by small rotations it would grow by 6 % and strain the flesh
    whole = whole_fruit(flesh, np.arange(3))
    turn = np.array([0.2, -0.25, 0.15])
    arms = flesh.bricks.nodes_mm - flesh.pit_centre_mm
    q = field(flesh, Rotation.from_rotvec(turn).apply(arms) - arms)
    q[-3:] = turn
    internal = whole.excess(q, lambda H: PLAIN.stress(H, (), 1.0)[0]) + flesh.stiffness @ q
    assert np.abs(internal[:-6]).max() < 1e-9


def test_a_step_of_flesh_ends_in_balance() -> None:
    # forces of Bonet and Wood's eq. 6.28, written apart from the law
    grasp, stands = rough(drawn_ball(E_MPa=0.3), motion([-0.05, 0.5, 1.0]))
    body, _ = body_of(stands, ())
    assert isinstance(body, NonlinearBody)
    whole = whole_fruit(stands.flesh, stands.dofs)
    grip = grip_of(stands, gel=stands.sensor.gel)
    instant = before_touch(grip, grasp.hold.origins(-0.05), body.begin())
    for travel in (0.5, 1.0):
        instant = body.advance(grip, instant, grasp.hold.origins(travel), 1.0)
    q = body.displacement_mm
    mu, lam = stands.flesh.mu_MPa, stands.flesh.lam_MPa

    def stress(H: np.ndarray) -> np.ndarray:
        F = H + np.eye(3)
        inverse_t = np.swapaxes(np.linalg.inv(F), -1, -2)
        return np.asarray(mu * (F - inverse_t) + lam * np.log(np.linalg.det(F))[..., None, None] * inverse_t)

    left = stands.flesh.stiffness @ q + whole.excess(q, stress) - whole.spread(instant.force_N)
    assert np.abs(instant.force_N).sum() > 1.0
    # mm that what is left would move a node by: a tenth of a frame's noise
    assert np.abs(whole.solve(left)).max() < 4e-4


@pytest.mark.parametrize(
    ("force_N", "parting", "lets_go"), [(0.1, 1, True), (0.1, -1, False), (5.0, 1, False)]
)
def test_pads_that_part_with_hardly_any_force_left_let_go(
    monkeypatch: pytest.MonkeyPatch, force_N: float, parting: int, lets_go: bool
) -> None:
    grasp, stands = rough(drawn_ball(E_MPa=0.3), motion([-0.05, 0.5]))
    body = NonlinearBody(whole_fruit(stands.flesh, stands.dofs), PLAIN)
    grip = grip_of(stands, gel=stands.sensor.gel)
    air = before_touch(grip, grasp.hold.origins(0.5), body.begin())
    before = replace(air, force_N=np.full_like(air.force_N, force_N / len(air.force_N)))

    def no_balance(*_: object, **__: object) -> None:
        raise NotInEquilibrium("none")

    monkeypatch.setattr(body, "_in_one", no_balance)
    origins = grasp.hold.origins(0.5 - 0.1 * parting)
    if not lets_go:
        with pytest.raises(NotInEquilibrium):
            body.advance(grip, before, origins, 1.0)
        return
    after = body.advance(grip, before, origins, 1.0)
    assert not after.force_N.any()
    np.testing.assert_array_equal(after.origins, origins)
    np.testing.assert_allclose(after.u, 0, atol=1e-9)


def test_a_loose_pit_gives_way_until_its_gap_has_closed() -> None:
    grasp, stands = rough(drawn_ball(E_MPa=0.3), motion([-0.05, 0.6, 1.2]))
    forces = []
    for gap in (0.05, 5.0):
        body, inner = body_of(stands, (InjectedEffect(effect="loose_pit", parameters={"gap_mm": gap}),))
        forces.append(total_N(grasped_ball(grasp, stands, body, inner=inner))[2])
    bonded = total_N(grasped_ball(grasp, stands, body_of(stands, ())[0]))[2]
    assert bonded > forces[0] > 1.05 * forces[1] > 0.3 * bonded


def test_two_laws_of_one_flesh_are_refused() -> None:
    _, stands = rough(drawn_ball(), motion([-0.05, 0.4]))
    damage = InjectedEffect(effect="damage", parameters={"dmax": 0.4, "W0_over_E": 1e-3})
    stiffening = InjectedEffect(effect="stiffening", parameters={"b": 20.0})
    with pytest.raises(SampleFailure, match="stiffening and damage cannot be injected together"):
        body_of(stands, (stiffening, damage))


def test_an_unknown_effect_is_refused() -> None:
    with pytest.raises(SampleFailure, match="no effect 'rust'"):
        InjectedEffect(effect="rust", parameters={})
