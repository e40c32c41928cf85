"""Quasi-static contact on coarse bricks: closed-form limits, balance, friction, and what the sensor adds."""

from dataclasses import replace

import numpy as np
import pytest
from ball_fruit import ball

from samples.fruit import SampleFruit, fruit_of_seed
from samples.gel_contact import Gel
from samples.grasp_plan import Hold, LoadProtocol, hold_along, planned_grasps, two_cycles
from samples.hexahedra import COARSE, Fineness
from samples.sensor_noise import SensorNoise, measured
from samples.simulated_grasp import Grasp, simulate

SILENT = SensorNoise(
    displacement_mm=0, reference_mm=0, force_N=0, reference_N=0, displacement_scale=0, force_scale=0,
    displacement_step_mm=1e-9, force_step_N=1e-9,
)  # fmt: skip
UNDER_THE_PAD = Fineness(degrees=(0, 3, 6, 10, 17, 45), along=1, depths=(0, 0.15, 1))


def motion(*travel_mm: float) -> LoadProtocol:
    return LoadProtocol(time_s=np.arange(len(travel_mm)) * 0.1, travel_mm=np.array(travel_mm))


def grasped(fruit: SampleFruit, protocol: LoadProtocol, hold: Hold | None = None, **options: object) -> Grasp:
    hold = hold or hold_along(fruit, azimuth_deg=40.0, tilt_deg=2.0)
    return simulate(fruit, hold, protocol, **{"rng": np.random.default_rng(0), "fineness": COARSE, **options})


@pytest.fixture(scope="module")
def grasp() -> Grasp:
    fruit = fruit_of_seed("a", seed=1, E_MPa=0.5)
    return grasped(fruit, motion(-0.3, -0.3, 0.2, 0.5, 0.9, 0.9, 0.4, -0.2))


def pad_force(grasp: Grasp, side: int) -> np.ndarray:
    return np.stack([m.force_N[side].sum(axis=0) for m in grasp.steps])


def test_every_frame_is_in_equilibrium_and_the_pads_push_alike(grasp: Grasp) -> None:
    assert max(m.residual for m in grasp.steps) < 3e-5
    left, right = pad_force(grasp, 0), pad_force(grasp, 1)
    assert np.abs(left + right).max() < 2e-3
    assert np.linalg.norm(left[4]) > 2.0


def test_nothing_is_felt_in_the_air(grasp: Grasp) -> None:
    for side in (0, 1):
        assert not grasp.true_force_N[side][[0, 1, 7]].any()
        assert not grasp.true_displacement_mm[side][[0, 1, 7]].any()


def test_markers_are_pressed_in_and_push_the_fruit(grasp: Grasp) -> None:
    for side in (0, 1):
        shift, force = grasp.true_displacement_mm[side][4], grasp.true_force_N[side][4]
        assert shift[:, 2].min() < -0.2
        assert shift[:, 2].max() <= 0
        assert force[:, 2] == pytest.approx(-0.22 * shift[:, 2])
        assert force[:, :2] == pytest.approx(-0.055 * shift[:, :2])


def test_marker_forces_add_up_to_what_the_nodes_carry(grasp: Grasp) -> None:
    for side in (0, 1):
        turn = grasp.contact.faces[side].turn
        nodes = pad_force(grasp, side)[4] @ turn
        assert grasp.true_force_N[side][4].sum(axis=0)[2] == pytest.approx(nodes[2], rel=0.04)


def test_marker_positions_lie_on_the_deformed_skin(grasp: Grasp) -> None:
    pad = grasp.recording.pads[0]
    shift = grasp.true_displacement_mm[0][4]
    inside = shift[:, 2] < -0.05
    local = pad.rest_mm[inside] + shift[inside]
    anchors = grasp.steps[4].anchors[0]
    from scipy.interpolate import LinearNDInterpolator

    depth = LinearNDInterpolator(anchors.position_mm[:, :2], anchors.position_mm[:, 2])(local[:, :2])
    assert local[:, 2] == pytest.approx(depth, abs=0.08)


def test_friction_stays_within_its_cone() -> None:
    fruit = fruit_of_seed("a", seed=1, E_MPa=0.5)
    slippery = grasped(fruit, motion(-0.3, 0.3, 0.7), gel=Gel(friction=0.02), law="linear")
    sticky = grasped(fruit, motion(-0.3, 0.3, 0.7), law="linear")
    for side in (0, 1):
        shear = np.linalg.norm(slippery.true_force_N[side][2][:, :2], axis=1)
        assert np.all(shear <= 0.0201 * slippery.true_force_N[side][2][:, 2] + 1e-4)
        assert np.linalg.norm(sticky.true_force_N[side][2][:, :2], axis=1).max() > 2 * shear.max()


@pytest.mark.slow
def test_a_rigid_ball_presses_the_gel_as_its_cap_says() -> None:
    # a rigid cap of depth d pushes aside gel of volume pi d^2 (3 R - d) / 3
    fruit = ball(30.0, 12.0, 1e4, 0.3)
    hold = hold_along(fruit, azimuth_deg=0.0, tilt_deg=0.0, uneven_mm=0.0)
    found = grasped(fruit, motion(-0.1, 1.0), hold, law="linear", fineness=UNDER_THE_PAD, noise=SILENT)
    force = np.abs(pad_force(found, 0)[1, 0])
    assert force == pytest.approx(0.22 * np.pi * 1.0**2 * (90.0 - 1.0) / 3, rel=0.01)
    assert found.true_force_N[0][1].sum(axis=0)[2] == pytest.approx(force, rel=0.01)


@pytest.mark.proof
def test_patch_under_a_hard_smooth_face_is_as_wide_as_hertz_says() -> None:
    # a^3 = 3 F R (1 - nu^2) / (4 E), whatever lies behind (Johnson 1985, eq. 4.22); there <r^2> = 2 a^2 / 5
    fruit = ball(30.0, 6.0, 0.5, 0.3)
    hold = hold_along(fruit, azimuth_deg=0.0, tilt_deg=0.0, uneven_mm=0.0)
    hard = Gel(kn_MPa_per_mm=10.0, kt_MPa_per_mm=1e-6, friction=0.0)
    found = grasped(fruit, motion(-0.1, 0.3), hold, law="linear", fineness=UNDER_THE_PAD, gel=hard)
    share = np.abs(found.steps[1].force_N[0][:, 0])
    away = np.linalg.norm(found.steps[1].anchors[0].position_mm[:, :2], axis=1)
    width = np.sqrt(2.5 * (share @ away**2) / share.sum())
    assert width == pytest.approx((3 * share.sum() * 30.0 * 0.91 / (4 * 0.5)) ** (1 / 3), rel=0.03)


def test_force_grows_with_the_modulus_and_falls_with_a_second_law() -> None:
    fruit = fruit_of_seed("a", seed=1, E_MPa=0.3)
    soft = grasped(fruit, motion(-0.3, 0.7))
    firm = grasped(replace(fruit, E_MPa=0.9), motion(-0.3, 0.7), law="linear")
    linear = grasped(fruit, motion(-0.3, 0.7), law="linear")
    a, b, c = (np.linalg.norm(pad_force(g, 0)[1]) for g in (soft, firm, linear))
    assert 1.3 < b / a < 3.0
    assert c == pytest.approx(a, rel=0.03)


def test_sensor_noise_is_what_it_says_and_is_rounded() -> None:
    rng = np.random.default_rng(2)
    still = np.zeros((400, 50, 3))
    noise = SensorNoise()
    felt, pushed = measured(still, still, noise, rng)
    own = felt - felt.mean(axis=0)
    assert own.std() == pytest.approx(noise.displacement_mm, rel=0.03)
    assert felt.mean(axis=0).std() == pytest.approx(noise.reference_mm, rel=0.2)
    assert (own[1:] * own[:-1]).mean() / own.var() == pytest.approx(noise.correlation, abs=0.03)
    assert np.array_equal(pushed, np.rint(pushed * 2**13) / 2**13)


def test_the_protocol_carries_its_noise_in_the_air_before_and_after() -> None:
    protocol = two_cycles(deepest_mm=1.5, speed_mm_per_s=1.0)
    assert np.all(protocol.travel_mm[:10] < 0)
    assert np.all(protocol.travel_mm[-5:] < 0)
    assert np.all(np.diff(protocol.time_s) > 0)
    assert protocol.travel_mm.max() == 1.5


def test_planned_grasps_cross_and_keep_off_the_groove() -> None:
    for seed in range(3):
        first, second = planned_grasps(fruit_of_seed("a", seed=seed, E_MPa=1.0), count=2)
        a, b = first.hold.turns[0][:, 2], second.hold.turns[0][:, 2]
        assert abs(a @ b) < 0.3
        assert min(abs(a[1]), abs(b[1])) > 0.35


def test_the_same_seed_gives_the_same_recording() -> None:
    fruit = fruit_of_seed("a", seed=1, E_MPa=0.5)
    one, two = (grasped(fruit, motion(-0.3, 0.2), law="linear").recording for _ in range(2))
    for a, b in zip(one.pads, two.pads, strict=True):
        assert np.array_equal(a.displacement_mm, b.displacement_mm)
