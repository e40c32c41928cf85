"""Injected cases: contacts, friction, other bodies, graded meshes, and faulty machines by definition."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from mismatch_ball import (
    drawn_ball,
    force_on_fruit,
    grasp_along_x,
    grasped_ball,
    linear_body,
    motion,
    rough,
    total_N,
)
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from samples.gel_contact import Gel, traction
from samples.graded_bricks import BrickGrading
from samples.grasp_plan import PlannedGrasp
from samples.hexahedra import Fineness
from samples.mismatch.case_simulation import body_of
from samples.mismatch.drawn_fruit import DrawnFruit
from samples.mismatch.grip import InnerContact
from samples.mismatch.injected import (
    AMPLITUDES,
    EFFECTS,
    InjectedEffect,
    drawn_out_of_catalogue,
    drawn_parameters,
    gel_of,
)
from samples.mismatch.machine_effects import (
    recorded_late,
    with_bent_reading,
    with_drift,
    with_gain,
    with_gel_creep,
    with_gripper_compliance,
    with_hysteresis,
    with_instants,
    with_pose_error,
    with_thermal_drift,
)
from samples.mismatch.marker_sensor import DEFAULT_SENSOR
from samples.mismatch.meshed_fruit import MeshedFruit, meshed_fruit
from samples.mismatch.nonlinear_body import sound_body
from samples.mismatch.other_bodies import inward_normal, split_pit_stiffness, with_third_contact
from samples.mismatch.skin_compliance import skin_compliance
from samples.mismatch.true_recording import ElasticBody, PadTruth, TrueRecording

REACH_MM = 0.12
WAY = [-0.1, 0.3, 0.6, 0.3, 0.1, 0.02, -0.03, -0.06, -0.09, -0.11, -0.14, -0.3]


@cache
def pressed_and_let_go(*, E_MPa: float, reach_mm: float) -> TrueRecording:
    grasp, stands = rough(drawn_ball(E_MPa=E_MPa, nu=0.3), motion(WAY))
    return grasped_ball(grasp, stands, linear_body(stands), gel=Gel(reach_mm=reach_mm))


def test_a_rigid_ball_draws_the_gel_out_to_its_cap_within_the_reach() -> None:
    """Skin at height h + r^2 / 2R over the gel's face holds the gel where that is less than the reach."""
    truth = pressed_and_let_go(E_MPa=100.0, reach_mm=REACH_MM)
    for h in (0.03, 0.06, 0.09):
        height = h + (truth.rest_mm[:, :2] ** 2).sum(axis=1) / 2 / 25.0
        stretch = truth.pads[0].displacement_mm[WAY.index(-h), :, 2]
        inside, outside = height < REACH_MM - 0.01, height > REACH_MM + 0.01
        assert inside.sum() >= 4
        assert stretch[inside] == pytest.approx(height[inside], abs=0.005)
        assert stretch[outside] == pytest.approx(0.0, abs=1e-12)
    assert total_N(truth)[WAY.index(-0.14)] == pytest.approx(0.0, abs=1e-9)


def test_a_gel_that_sticks_is_pressed_as_one_that_does_not() -> None:
    sticks, slides = (pressed_and_let_go(E_MPa=0.5, reach_mm=reach) for reach in (REACH_MM, 0.0))
    assert total_N(sticks)[:3] == pytest.approx(total_N(slides)[:3], rel=1e-6)


def test_skin_is_drawn_out_no_farther_than_the_reach_and_only_after_it_has_touched() -> None:
    truth = pressed_and_let_go(E_MPa=0.5, reach_mm=REACH_MM)
    for pad in truth.pads:
        stretch = pad.displacement_mm[..., 2]
        assert stretch[: WAY.index(0.6) + 1].max() <= 0.0
        assert REACH_MM / 2 < stretch.max() < REACH_MM


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


def test_the_skin_gives_way_as_another_solver_says() -> None:
    _, stands = rough(drawn_ball(), motion([-0.1, 0.6]))
    compliant = skin_compliance(stands.flesh.stiffness, stands.dofs)
    unit = np.zeros((stands.flesh.unknowns, len(stands.dofs)))
    unit[stands.dofs, np.arange(len(stands.dofs))] = 1.0
    compliance = splu(csc_array(stands.flesh.stiffness)).solve(unit)[stands.dofs]
    elastic = float(np.abs(compliant.elastic).max())
    assert elastic < 0.05 * np.abs(compliance).max()
    assert compliant.dense() == pytest.approx(compliance, abs=1e-6 * elastic)
    force = np.random.default_rng(0).normal(size=40)
    part, rows = (slice(0, 15), slice(300, 325)), (slice(6, 30),)
    expected = 2 * compliance[6:30][:, np.r_[0:15, 300:325]] @ force
    assert compliant.scaled(2.0).times(force, part, rows) == pytest.approx(expected, rel=1e-5)


def test_a_rigid_ball_presses_the_gel_as_its_cap_says() -> None:
    # a rigid cap of depth d pushes aside gel of volume pi d^2 (3 R - d) / 3
    truth = pressed_and_let_go(E_MPa=100.0, reach_mm=REACH_MM)
    expected = 0.22 * np.pi * 0.6**2 * (75.0 - 0.6) / 3
    assert total_N(truth)[WAY.index(0.6)] == pytest.approx(expected, rel=0.02)


def test_the_pads_push_alike_and_only_where_they_touch() -> None:
    grasp, stands = rough(drawn_ball(), motion([-0.2, 0.3, 0.7, 0.3, -0.2]))
    truth = grasped_ball(grasp, stands, linear_body(stands))
    left, right = total_N(truth, 0), total_N(truth, 1)
    assert left == pytest.approx(right, abs=0.02)
    assert left[[0, 4]] == pytest.approx(0.0, abs=1e-12)
    assert left[3] == pytest.approx(left[1], rel=0.01)
    for pad in truth.pads:
        assert pad.force_N[2] == pytest.approx(
            -pad.displacement_mm[2] * np.array([0.055, 0.055, 0.22]), abs=1e-12
        )


def test_friction_stays_within_its_cone() -> None:
    way = motion([-0.1, 0.4, 0.8, 0.8, 0.8], shear_mm=[0, 0, 0, 0.5, 1.0])
    grasp, stands = rough(drawn_ball(), way)
    body = linear_body(stands)
    slippery = grasped_ball(grasp, stands, body, gel=Gel(friction=0.05))
    sticky = grasped_ball(grasp, stands, body)
    for pad, other in zip(slippery.pads, sticky.pads, strict=True):
        shear = np.linalg.norm(pad.force_N[..., :2], axis=-1)
        assert np.all(shear <= 0.0501 * pad.force_N[..., 2] + 1e-9)
        touches = other.force_N[..., 2] > 1e-3
        free = np.linalg.norm(other.force_N[..., :2], axis=-1)[touches] / other.force_N[..., 2][touches]
        assert free.max() > 0.1


SEAT_WAY = motion([-0.05, 0.5, 1.0, 1.0], shear_mm=[0, 0, 0, 0.6])
FINER = Fineness(degrees=(0, 7, 14, 25, 35, 45), along=4, depths=(0, 0.3, 1))
DIRECTION = np.array([0.0, 0.3, -1.0]) / np.hypot(0.3, 1.0)
PLACE_MM = 25.0 * DIRECTION


@cache
def meshed() -> tuple[PlannedGrasp, MeshedFruit]:
    return rough(drawn_ball(), SEAT_WAY, FINER)


@cache
def borne(*, N_per_mm: float, gap_mm: float = 0.0) -> np.ndarray:
    grasp, stands = meshed()
    normal = inward_normal(drawn_ball().fruit.skin, PLACE_MM)
    compliance, seat = with_third_contact(
        stands.flesh, stands.dofs, centre_mm=PLACE_MM, normal=normal, N_per_mm=N_per_mm, gap_mm=gap_mm
    )
    assert isinstance(seat, InnerContact)
    assert seat.N_per_mm.sum() == pytest.approx(N_per_mm)
    return force_on_fruit(grasped_ball(grasp, stands, ElasticBody(compliance), inner=seat))


def test_the_normal_of_a_ball_points_to_its_middle() -> None:
    assert inward_normal(drawn_ball().fruit.skin, PLACE_MM) == pytest.approx(-DIRECTION, abs=1e-4)


def test_the_pads_are_left_with_a_force_along_the_normal() -> None:
    free, on_palm = borne(N_per_mm=1e-9), borne(N_per_mm=15.0)
    assert np.abs(free).max() < 0.03
    pressed = on_palm[2] - free[2]
    assert np.linalg.norm(pressed) > 0.05
    assert pressed / np.linalg.norm(pressed) == pytest.approx(DIRECTION, abs=0.05)


def test_nothing_is_borne_before_the_gap_has_closed() -> None:
    free, far = borne(N_per_mm=1e-9), borne(N_per_mm=15.0, gap_mm=3.0)
    assert far == pytest.approx(free, abs=1e-5)


OUTSIDE_WAY = motion([-0.05, 0.5, 1.0, 1.0, 1.0], pause_s=0.5)


def test_a_split_pit_is_softer_than_a_whole_one() -> None:
    grasp, stands = rough(drawn_ball(core_mm=14.0), OUTSIDE_WAY)
    whole = skin_compliance(stands.flesh.stiffness, stands.dofs)
    split = skin_compliance(split_pit_stiffness(stands.flesh), stands.dofs)
    assert np.linalg.eigvalsh(split.dense() - whole.dense())[0] > -1e-6 * np.abs(whole.dense()).max()
    assert (
        total_N(grasped_ball(grasp, stands, ElasticBody(split)))[2]
        < total_N(grasped_ball(grasp, stands, ElasticBody(whole)))[2]
    )


def test_a_bond_lets_the_halves_part_by_its_share() -> None:
    _, stands = rough(drawn_ball(core_mm=14.0), OUTSIDE_WAY)
    whole = skin_compliance(stands.flesh.stiffness, stands.dofs).dense()
    free, bonded = (
        skin_compliance(split_pit_stiffness(stands.flesh, angle_deg=50.0, share=share), stands.dofs).dense()
        - whole
        for share in (1.0, 0.4)
    )
    assert np.abs(bonded - 0.4 * free).max() < 0.01 * np.abs(free).max()


def test_a_palm_takes_what_the_pads_do_not_balance() -> None:
    way = motion([-0.05, 0.5, 1.0, 1.0], shear_mm=[0, 0, 0, 1.0])
    grasp, stands = rough(drawn_ball(), way)
    palm = InjectedEffect(effect="palm", parameters={"N_per_mm": 8.0, "area_radius_mm": 6.0})
    on_palm = force_on_fruit(grasped_ball(grasp, stands, body_of(stands, (palm,))[0]))
    free = force_on_fruit(grasped_ball(grasp, stands, sound_body(stands)))
    assert np.abs(free[:, 2]).max() < 0.03
    assert np.abs(on_palm[:, 2]).max() > 2 * np.abs(free[:, 2]).max()


def test_a_softening_gel_is_pressed_deeper_while_it_is_held() -> None:
    grasp, stands = rough(drawn_ball(), OUTSIDE_WAY)
    softening = InjectedEffect(effect="gel_softening", parameters={"g": 0.3, "tau_s": 0.5})
    body, _ = body_of(stands, (softening,))
    depth = -grasped_ball(grasp, stands, body).pads[0].displacement_mm[..., 2].min(axis=1)
    assert depth[4] > depth[3] > depth[2]


SMALL = BrickGrading(cells=3, layers=2, levels=2)
IN_SHORT = frozenset({"skin", "stiffening", "loose_pit", "third_contact", "gel_creep", "sensor_gain"})
"""One of each kind of body and of recording."""
SHORT_WAY = motion([-0.05, 0.3, 0.6], shear_mm=[0.0, 0.0, 0.3])


@pytest.fixture(scope="module")
def ball() -> tuple[DrawnFruit, PlannedGrasp, MeshedFruit]:
    """A ball, a grasp of it, and its mesh graded towards the skin."""
    drawn = drawn_ball()
    grasp = grasp_along_x(drawn, SHORT_WAY)
    return drawn, grasp, meshed_fruit(drawn.fruit, grasp, fineness=SMALL)


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    [
        pytest.param(effect, marks=() if effect in IN_SHORT else pytest.mark.proof)
        for effect in [*EFFECTS, "palm"]
    ],
)
def test_an_effect_runs_on_a_graded_mesh(
    effect: str, ball: tuple[DrawnFruit, PlannedGrasp, MeshedFruit]
) -> None:
    drawn, grasp, stands = ball
    rng = np.random.default_rng(3)
    places = {"soft_spot": [21.0, 0.0, 0.0], "third_contact": [0.0, 0.0, -25.0]}
    if effect in EFFECTS:
        parameters = drawn_parameters(effect, 0.4 * AMPLITUDES[effect][1], rng)
        if effect in places:
            parameters["centre_mm"] = places[effect]
        injected = (InjectedEffect(effect=effect, parameters=parameters),)
    else:
        injected = (drawn_out_of_catalogue(effect, rng),)
    body, inner = body_of(stands, injected, skin=drawn.fruit.skin)
    truth = grasped_ball(grasp, stands, body, gel=gel_of(injected), inner=inner)
    assert 0.1 < total_N(truth)[1] < total_N(truth)[2] < 10.0


@pytest.mark.slow
def test_finite_strain_stiffens_a_pressed_ball_a_little(
    ball: tuple[DrawnFruit, PlannedGrasp, MeshedFruit],
) -> None:
    _, grasp, stands = ball
    linear = linear_body(stands)
    small, large = (total_N(grasped_ball(grasp, stands, body)) for body in (linear, sound_body(stands)))
    assert large[1:] == pytest.approx(small[1:], rel=0.05)
    assert np.abs(large[2] / small[2] - 1) > 1e-3


@pytest.fixture
def truth() -> TrueRecording:
    """Two pads that close along x, forces rising with time."""
    time_s = np.linspace(0.0, 2.0, 9)
    rest = DEFAULT_SENSOR.rest_mm
    shape = np.exp(-(rest[:, 0] ** 2 + rest[:, 1] ** 2) / 20)
    pads = []
    for side in (1.0, -1.0):
        pose = np.broadcast_to(np.eye(4), (9, 4, 4)).copy()
        pose[:, :3, :3] = np.stack([[0, 1, 0], [0, 0, side], [side, 0, 0]], axis=1)
        pose[:, 0, 3] = side * (-30 + time_s)
        shift = np.zeros((9, 400, 3))
        shift[..., 2] = -time_s[:, None] * shape
        pads.append(
            PadTruth(pose=pose, displacement_mm=shift, force_N=-np.array([0.055, 0.055, 0.22]) * shift)
        )
    return TrueRecording(
        name="grasp-1", time_s=time_s, aperture_mm=60 - 2 * time_s, rest_mm=rest, gel=Gel(),
        pads=(pads[0], pads[1]),
    )  # fmt: skip


def taken(truth: TrueRecording, frames: np.ndarray, **changes: np.ndarray) -> TrueRecording:
    """The recording with these frames of its pads, in this order."""
    left, right = (
        PadTruth(pose=p.pose[frames], displacement_mm=p.displacement_mm[frames], force_N=p.force_N[frames])
        for p in truth.pads
    )
    return replace(truth, pads=(left, right), **changes)


def pad_total_N(pad: PadTruth) -> np.ndarray:
    return np.asarray(pad.force_N.sum(axis=1)[:, 2])


def test_gain_scales_one_pads_force_exactly(truth: TrueRecording) -> None:
    recording = with_gain(truth, pad="right", gain=1.2)
    assert recording.pads[1].force_N == pytest.approx(1.2 * truth.pads[1].force_N)
    assert recording.pads[0] is truth.pads[0]
    assert np.array_equal(recording.pads[1].displacement_mm, truth.pads[1].displacement_mm)


def test_drift_adds_newtons_per_second_to_one_pad(truth: TrueRecording) -> None:
    recording = with_drift(truth, pad="left", newton_per_s=0.3)
    assert pad_total_N(recording.pads[0]) - pad_total_N(truth.pads[0]) == pytest.approx(0.3 * truth.time_s)
    assert recording.pads[1] is truth.pads[1]


def test_a_gripper_that_gives_records_more_travel_than_there_was(truth: TrueRecording) -> None:
    recording = with_gripper_compliance(truth, mm_per_N=0.01)
    excess = 0.01 * pad_total_N(truth.pads[0])
    assert truth.aperture_mm - recording.aperture_mm == pytest.approx(2 * excess)
    for before, after in zip(truth.pads, recording.pads, strict=True):
        moved = after.pose[:, :3, 3] - before.pose[:, :3, 3]
        assert moved == pytest.approx(excess[:, None] * before.pose[:, :3, 2])
    apart = np.linalg.norm(recording.pads[1].pose[:, :3, 3] - recording.pads[0].pose[:, :3, 3], axis=1)
    assert apart == pytest.approx(recording.aperture_mm)


def test_a_wrong_pose_is_the_true_one_times_shift_and_tilt(truth: TrueRecording) -> None:
    recording = with_pose_error(truth, pad="left", shift_mm=(1.0, -2.0), tilt_deg=3.0)
    error = np.linalg.inv(truth.pads[0].pose) @ recording.pads[0].pose
    assert error[:, :3, 3] == pytest.approx(np.broadcast_to([1.0, -2.0, 0.0], (9, 3)))
    assert error[:, :3, 0] == pytest.approx(np.broadcast_to([1.0, 0.0, 0.0], (9, 3)))
    assert np.degrees(np.arctan2(error[:, 2, 1], error[:, 1, 1])) == pytest.approx(3.0)
    assert recording.pads[1] is truth.pads[1]


def test_a_late_clock_shows_what_was_with_the_pose_that_is(truth: TrueRecording) -> None:
    recording = recorded_late(truth, truth.time_s, lag_s=0.5)
    assert np.array_equal(recording.pads[0].force_N[2:], truth.pads[0].force_N[:-2])
    assert np.array_equal(recording.pads[0].force_N[0], truth.pads[0].force_N[0])
    assert np.array_equal(recording.pads[0].pose, truth.pads[0].pose)
    assert np.array_equal(recording.time_s, truth.time_s)
    assert np.array_equal(recording.aperture_mm, truth.aperture_mm)
    some = recorded_late(truth, truth.time_s[[2, 4]] + 0.01, lag_s=0.0)
    assert np.array_equal(some.pads[1].force_N, truth.pads[1].force_N[[2, 4]])
    assert np.array_equal(some.time_s, truth.time_s[[2, 4]])


def test_more_instants_lie_on_the_same_way() -> None:
    grasp = grasp_along_x(drawn_ball(), motion([-0.1, 0.4, 0.4, -0.1]))
    more = with_instants(grasp, np.array([0.05, 0.17])).motion
    assert np.interp(more.time_s, grasp.motion.time_s, grasp.motion.travel_mm) == pytest.approx(
        more.travel_mm
    )
    assert {0.05, 0.17} <= set(more.time_s.tolist())
    assert more.recorded.all()


def test_hysteresis_spares_the_load_and_the_peak(truth: TrueRecording) -> None:
    back = taken(truth, np.r_[0:9, 8:-1:-1])
    force_N, was = pad_total_N(with_hysteresis(back, share=0.1).pads[0]), pad_total_N(back.pads[0])
    assert force_N[:9] == pytest.approx(was[:9])
    assert np.all(force_N[10:17] < was[10:17])
    assert force_N[13] == pytest.approx(0.9 * was[13], rel=0.02)


def test_thermal_drift_goes_with_the_root_of_time_on_both_pads(truth: TrueRecording) -> None:
    recording = with_thermal_drift(truth, strain_per_root_s=0.002, N_per_root_s=0.3)
    reach = np.abs(truth.rest_mm[:, 0]).max()
    for before, after in zip(truth.pads, recording.pads, strict=True):
        assert pad_total_N(after) - pad_total_N(before) == pytest.approx(0.3 * np.sqrt(truth.time_s))
        moved = (after.displacement_mm - before.displacement_mm)[-1]
        assert np.abs(moved).max() == pytest.approx(0.002 * reach * np.sqrt(2.0))


def test_a_bent_reading_is_off_by_its_share_at_the_largest_force_and_by_half_at_half(
    truth: TrueRecording,
) -> None:
    bent = with_bent_reading(truth, a=-0.3)
    size, read = (np.linalg.norm(recording.pads[0].force_N, axis=2) for recording in (truth, bent))
    assert read.max() == pytest.approx(0.7 * size.max())
    assert (read[4] / size[4])[size[4] == size[4].max()] == pytest.approx(0.85)


def test_a_gel_face_creeps_on_under_a_steady_load(truth: TrueRecording) -> None:
    held = np.r_[0:9, [8] * 40]
    still = taken(truth, held, time_s=np.arange(len(held)) * 0.25, aperture_mm=truth.aperture_mm[held])
    crept = with_gel_creep(still, creep=0.2, creep_tau_s=1.0)
    more = crept.pads[0].displacement_mm[:, 0, 2] / still.pads[0].displacement_mm[-1, 0, 2]
    assert more[8] < 1.15
    assert more[-1] == pytest.approx(1.2, abs=1e-3)
    assert np.array_equal(crept.pads[0].force_N, still.pads[0].force_N)
