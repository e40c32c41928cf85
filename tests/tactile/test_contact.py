"""Injected noise, touches, forces and pads are found again; a contact at the edge is said."""

import re
from dataclasses import replace

import numpy as np
import pytest
from injected_grasp import RADIUS_MM, ball, elsewhere, frames_of, gel_pad, held_by, injected_grasp, with_pads
from refusals import refused
from scipy.spatial import ConvexHull

from tactile.contact import Phase, contact_said, find_contact, neighbourhood, touching_over_time
from tactile.from_frames import MUCH_AT_EDGE, edge_share
from tactile.noise import Noise, noise_in_contact
from tactile.plain_jaw import has_plain_jaw, with_plain_jaw
from tactile.readers.recording import GelPad, IndenterPad, Recording
from tactile.registration import register
from tactile.tactile_failure import TactileFailure, TactileProblem


def test_onset_is_the_injected_one_or_the_next_frame(injected, contact):
    for pad in contact.pads:
        truth = injected.onset[pad.name]
        late = pad.onset - truth
        both = (truth >= 0) & (pad.onset >= 0)
        assert (late[both] >= 0).all()
        assert np.mean(late[both] <= 1) > 0.97
        assert not (pad.onset[truth < 0] >= 0).any()
        assert np.mean(pad.onset[truth >= 0] >= 0) > 0.95


def test_noise_is_the_injected_one(injected, contact):
    for pad in contact.pads:
        assert pad.displacement_noise.sd == pytest.approx(injected.sd_mm, rel=0.02)
        assert pad.force_noise.sd == pytest.approx(injected.sd_N, rel=0.02)
        assert pad.force_noise.lag1 == pytest.approx(injected.lag1, abs=0.03)


def test_the_offset_of_the_reference_frame_is_taken_out(injected, contact):
    for pad, raw in zip(contact.pads, injected.recording.pads, strict=True):
        assert np.abs(raw.force_N[: injected.no_contact_frames].mean(axis=0)).max() > injected.sd_N
        after = pad.force_N[: injected.no_contact_frames].mean(axis=0)
        assert np.abs(after).max() < 0.2 * injected.sd_N


def test_total_force_is_the_injected_one(injected, contact):
    for pad in contact.pads:
        truth = injected.clean_force_z_N[pad.name]
        assert pad.total_normal_N == pytest.approx(truth, abs=6 * injected.sd_N * np.sqrt(len(pad.rest_mm)))


def test_the_patch_holds_all_force_and_little_more(injected, contact):
    for pad in contact.pads:
        peak = int(np.argmax(pad.total_normal_N))
        inside = np.linalg.norm(pad.force_N[peak, pad.patch].sum(axis=0))
        assert inside == pytest.approx(injected.clean_force_z_N[pad.name].max(), rel=0.01)
        touched = pad.onset >= 0
        assert (pad.patch[touched]).all()
        reach = np.linalg.norm(pad.rest_mm[pad.patch], axis=1).max()
        assert reach <= np.linalg.norm(pad.rest_mm[touched], axis=1).max() + 3.6


def test_phases_follow_the_jaws(contact):
    order = "".join(phase[0] for phase in contact.phase).strip("a")
    assert order == "l" * order.count("l") + "h" * order.count("h") + "u" * order.count("u")
    assert contact.phase[0] is Phase.AIR
    assert contact.phase[-1] is Phase.AIR
    assert order.count("h") == 6


def test_two_cycles_are_two_contacts():
    contact = find_contact(injected_grasp(np.random.default_rng(3), cycles=2).recording, source="x")
    for pad in contact.pads:
        centre = int(np.argmin(np.linalg.norm(pad.rest_mm, axis=1)))
        assert set(pad.episode[:, centre]) == {-1, 0, 1}
    assert all(
        re.search(r"contact from .* in 2 contacts, up to \d+\.\d\d N$", line)
        for line in contact_said(contact)
    )


def test_positions_and_forces_turn_with_the_fruit_frame(injected, contact):
    turned, motion = elsewhere(injected.recording)
    moved = find_contact(turned, source="x")
    for a, b in zip(contact.pads, moved.pads, strict=True):
        np.testing.assert_array_equal(a.episode, b.episode)
        np.testing.assert_allclose(a.position_mm @ motion[:3, :3].T + motion[:3, 3], b.position_mm, atol=1e-9)
        np.testing.assert_allclose(a.force_N @ motion[:3, :3].T, b.force_N, atol=1e-12)


def test_touching_frames_are_hardly_selected_by_the_noise_of_their_own_force():
    """A force that rises from 0 to 10 standard deviations. Where each frame is compared with four of them,
    touching frames below 5 have a mean noise of 0.8 standard deviations, and a quarter above 2 is missed.
    """
    across, along = np.mgrid[:15, :15].reshape(2, -1)
    _, mean = neighbourhood(np.column_stack([across, along, 0 * across]).astype(float))
    true_N = np.linspace(0.0, 10.0, 100)
    noise_N = np.random.default_rng(0).normal(size=(100, 225))
    offset = np.zeros((225, 3))
    touches = touching_over_time(true_N[:, None] + noise_N, Noise(offset=offset, sd=1.0, lag1=0.0), mean)
    assert abs(noise_N[touches & (true_N < 5)[:, None]].mean()) < 0.3
    assert (~touches[true_N > 2]).mean() < 0.12
    assert touches[:8].mean() < 1e-3


@pytest.mark.parametrize("end_sd", [5.0, 8.0, 20.0, 60.0, -20.0, -60.0])
def test_a_drift_that_all_markers_feel_is_no_contact_and_hides_none(injected, contact, end_sd):
    """Ending at so many standard deviations of one marker; four count as a touch."""
    share = injected.recording.time_s / injected.recording.time_s[-1]
    grown = end_sd * injected.sd_N * share[:, None, None] * np.array([0, 0, 1.0])
    recording = with_pads(injected.recording, lambda p: replace(p, force_N=p.force_N + grown), "left")
    drifted = find_contact(recording, source="x")
    touches, should = (grasp_contact.pads[0].episode >= 0 for grasp_contact in (drifted, contact))
    assert (touches & ~should).sum() < 0.05 * should.sum()
    assert (should & ~touches).sum() < 0.1 * should.sum()
    assert np.mean([a == b for a, b in zip(drifted.phase, contact.phase, strict=True)]) > 0.75


@pytest.mark.parametrize("kept", [slice(None), slice(0, 44)])
def test_a_broad_contact_is_no_drift(injected, kept):
    """A push of 20 standard deviations all over the pad; the recording ends in the air, or in contact."""
    recording = injected.recording
    pressed = injected.clean_force_z_N["left"] > 0
    broad = 20 * injected.sd_N * pressed[:, None, None] * np.array([0, 0, 1.0])
    recording = with_pads(recording, lambda p: replace(p, force_N=p.force_N + broad), "left")
    pad_contact = find_contact(frames_of(recording, kept), source="x").pads[0]
    assert ((pad_contact.episode >= 0)[pressed[kept]]).mean() > 0.99


def in_the_air(recording):
    """Frames in which the jaws have not closed yet."""
    return frames_of(recording, slice(0, 20))


def of_zeros(recording):
    zeros = np.zeros_like(recording.pads[0].force_N)
    return with_pads(recording, lambda p: replace(p, force_N=zeros, displacement_mm=zeros))


def missed(recording):
    """The right pad stays in the air."""
    air = np.tile(recording.pads[1].force_N[:5], (20, 1, 1))[: len(recording.time_s)]
    return with_pads(recording, lambda p: replace(p, force_N=air), "right")


def signed_otherwise(recording):
    return with_pads(recording, lambda p: replace(p, force_N=-p.force_N))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (in_the_air, "pads/left/force_N: .*never touches"),
        (of_zeros, "pads/left/force_N: .*never touches"),
        (missed, "pads/right/force_N: .*never touches"),
        (signed_otherwise, "write the force of the gel on the fruit"),
    ],
)
def test_a_pad_that_feels_no_push_never_touches(injected, change, said):
    with refused(TactileProblem.NEVER_TOUCHES, rf"^a\.h5: .*{said}"):
        find_contact(change(injected.recording), source="a.h5")


def test_an_indenter_that_travels_further_loads(injected):
    press = replace(
        injected.recording,
        loading="press",
        support="base",
        aperture_mm=-injected.recording.aperture_mm,
        pads=(replace(injected.recording.pads[1], name="tip"),),
    )
    order = "".join(phase[0] for phase in find_contact(press, source="x").phase).strip("a")
    assert order.startswith("lll")
    assert order.endswith("uuu")


def test_a_bare_indenter_has_no_markers_and_the_ways_out_are_said(injected):
    pose = injected.recording.pads[0].pose
    tip = IndenterPad(name="tip", pose=pose, force_z_N=np.ones(len(pose)), indenter="ball", radius_mm=3.0)
    with refused(TactileProblem.NO_MARKERS, r"found a bare indenter.*give three diameters"):
        find_contact(replace(injected.recording, loading="press", pads=(tip,)), source="x")


def test_without_air_the_noise_comes_from_contact(injected):
    late = slice(injected.no_contact_frames + 2, len(injected.recording.time_s) - 12)
    contact = find_contact(frames_of(injected.recording, late), source="x")
    for pad in contact.pads:
        assert (pad.onset >= 0).sum() > 20
        assert 0.3 * injected.sd_N < pad.force_noise.sd < 3 * injected.sd_N


def test_a_deadband_before_contact_does_not_pass_for_silence(injected):
    def silent(pad):
        quiet = np.abs(pad.force_N[:, :, 2]) < 4 * injected.sd_N
        return replace(pad, force_N=np.where(quiet[:, :, None], 0.0, pad.force_N))

    contact = find_contact(with_pads(injected.recording, silent), source="x")
    for pad in contact.pads:
        assert pad.force_noise.sd > 0.3 * injected.sd_N
        assert (pad.onset >= injected.no_contact_frames).sum() > 20


def test_one_loaded_frame_alone_is_a_contact(injected):
    peak = slice(injected.no_contact_frames + 10, injected.no_contact_frames + 11)
    contact = find_contact(frames_of(injected.recording, peak), source="x")
    assert contact.phase == (Phase.HOLD,)
    assert all((pad.onset == 0).sum() > 20 for pad in contact.pads)


def test_noise_under_a_smooth_signal_comes_from_its_bends():
    rng = np.random.default_rng(0)
    signal = np.linspace(0, 5, 30)[:, None, None] * np.ones((1, 200, 3))
    noise = noise_in_contact(signal + rng.normal(size=signal.shape) * 0.02)
    assert noise.sd == pytest.approx(0.02, rel=0.1)


LINE = np.arange(-4.0, 5.0)
REST = np.stack([*(grid.ravel() for grid in np.meshgrid(LINE, LINE)), np.zeros(81)], axis=1)


def pushed(x_mm: float, y_mm: float) -> np.ndarray:
    """Hertz's pressure, 2.5 mm wide."""
    away = np.hypot(REST[:, 0] - x_mm, REST[:, 1] - y_mm) / 2.5
    return np.sqrt(np.maximum(1 - away**2, 0.0))


@pytest.mark.parametrize(
    ("place", "reaches"),
    [((0.0, 0.5), False), ((3.0, 0.0), True), ((-3.5, 1.0), True), ((0.0, -3.0), True), ((0.5, 3.5), True)],
)
def test_a_contact_at_any_edge_is_told_from_one_in_the_middle(place, reaches):
    assert (edge_share(REST, pushed(*place)) > MUCH_AT_EDGE) == reaches
    assert edge_share(REST, np.zeros(81)) == 0.0


@pytest.fixture(scope="module")
def fruit():
    """Vertices and faces of a ball, faces outward."""
    vertices = ball(RADIUS_MM)
    faces = ConvexHull(vertices).simplices.astype(np.int64)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    inward = np.einsum("fx,fx->f", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces


def test_markers_sit_on_the_mesh_where_they_touched(contact, fruit):
    for pad, place in zip(contact.pads, register(contact, *fruit, source="x"), strict=True):
        touched = pad.onset >= 0
        assert np.linalg.norm(place.surface_mm[touched], axis=1) == pytest.approx(RADIUS_MM, abs=0.03)
        across = place.surface_mm[touched] - pad.position_mm[0, touched]
        across -= np.outer(across @ place.normal, place.normal)
        assert np.abs(across).max() < 0.03


def test_what_lies_beside_a_small_fruit_is_not_on_its_skin(contact, fruit):
    vertices, faces = fruit
    normal = contact.pads[0].pose[0, :3, 2]
    off_axis = np.linalg.norm(vertices - np.outer(vertices @ normal, normal), axis=1)
    rim = 6.0
    place = register(contact, vertices, faces[(off_axis[faces] < rim).all(axis=1)], source="x")[0]
    position = contact.pads[0].position_mm[0]
    across = np.linalg.norm(position - np.outer(position @ normal, normal), axis=1)
    assert place.on_skin[across < rim - 1].all()
    assert not place.on_skin[across > rim].any()
    assert (across > rim).any()


def test_first_touches_lie_within_what_the_ball_gave_way(contact, fruit):
    # Half of a frame's step and half of the sagitta have gone into the ball before a marker is seen to touch.
    for place in register(contact, *fruit, source="x"):
        assert abs(place.shift_mm) < 0.4
        assert place.residual_mm < 0.2


def test_a_pose_error_along_the_normal_is_the_shift(injected, contact, fruit):
    before = register(contact, *fruit, source="x")

    def drawn_back(pad):
        pose = pad.pose.copy()
        pose[:, :3, 3] -= 0.8 * pose[:, :3, 2]
        return replace(pad, pose=pose)

    wrong = with_pads(injected.recording, drawn_back)
    after = register(find_contact(wrong, source="x"), *fruit, source="x")
    for a, b in zip(before, after, strict=True):
        assert b.shift_mm - a.shift_mm == pytest.approx(0.8, abs=1e-6)
        np.testing.assert_allclose(a.surface_mm, b.surface_mm, atol=1e-6)
        assert b.residual_mm == pytest.approx(a.residual_mm, abs=1e-6)


def test_places_move_with_the_fruit_frame(injected, contact, fruit):
    turned, motion = elsewhere(injected.recording)
    vertices = fruit[0] @ motion[:3, :3].T + motion[:3, 3]
    moved = register(find_contact(turned, source="x"), vertices, fruit[1], source="x")
    for a, b in zip(register(contact, *fruit, source="x"), moved, strict=True):
        np.testing.assert_allclose(a.surface_mm @ motion[:3, :3].T + motion[:3, 3], b.surface_mm, atol=1e-6)


@pytest.mark.parametrize(
    ("shift", "times"), [([0, 0, 60.0], 1.0), ([200.0, 0, 0], 1.0), ([0, -30.0, 0], 1.0), (0.0, 1e-3)]
)
def test_a_fruit_elsewhere_or_in_metres_is_refused(contact, fruit, shift, times):
    said = r"^g\.h5: pads/(left|right)/pose: found first touches .* the units \(mm\)"
    with refused(TactileProblem.PADS_OFF_FRUIT, said):
        register(contact, times * fruit[0] + np.array(shift), fruit[1], source="g.h5")


JAW_FRUIT_MM = 30.0
FRAMES = 9
CLOSED_MM = 2.0
SKIN = ball(JAW_FRUIT_MM, 20_000)


def pose_at(side: float, closed_mm: float) -> np.ndarray:
    """A jaw on the x axis whose z points to the ball's centre, and whose origin is 3 mm beside the axis."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0, 0, -side], [1, 0, 0], [0, -side, 0]])
    pose[:3, 3] = [side * (JAW_FRUIT_MM - closed_mm / 2), 3.0, 0.0]
    return pose


def grasp(*, shear_N: float = 0.0) -> Recording:
    """Jaws close by CLOSED_MM after a frame in the air; a gel on the left gives 0.4 mm under 5 N at the
    end."""
    share = np.r_[0.0, np.linspace(0, 1, FRAMES - 1)]
    line = np.arange(-5.0, 6.0)
    rest = np.column_stack([*(axis.ravel() for axis in np.meshgrid(line, line)), np.zeros(121)])
    pressed = np.linalg.norm(rest, axis=1) < 3.1
    weight = pressed / pressed.sum()
    force = share[:, None, None] * weight[:, None] * np.array([shear_N, 0.0, 5.0])
    moved = share[:, None, None] * pressed[:, None] * np.array([0.0, 0.0, -0.4])
    left = gel_pad("left", rest, moved, force, pose=np.stack([pose_at(-1.0, CLOSED_MM * s) for s in share]))
    right = IndenterPad(
        name="right",
        pose=np.stack([pose_at(1.0, CLOSED_MM * s) for s in share]),
        force_z_N=5.0 * share,
        indenter="plate",
        radius_mm=None,
    )
    return held_by((left, right), np.arange(float(FRAMES)), 2 * JAW_FRUIT_MM - CLOSED_MM * share)


def jaw_of(recording: Recording) -> GelPad:
    return with_plain_jaw(recording, SKIN, source="g.h5").pads[1]


def test_the_jaw_pushes_back_what_the_gel_pushes() -> None:
    recording = grasp(shear_N=0.7)
    left, right = recording.pads[0], jaw_of(recording)
    on_fruit = [np.einsum("tij,tnj->ti", pad.pose[:, :3, :3], pad.force_N) for pad in (left, right)]
    assert np.abs(on_fruit[0] + on_fruit[1]).max() < 1e-12
    assert not right.displacement_mm.any()


def test_it_touches_where_the_fruit_comes_first_and_as_widely_as_hertz_has_it() -> None:
    right = jaw_of(grasp())
    weight = right.force_N[-1, :, 2]
    middle = weight @ right.rest_mm / weight.sum()
    # the jaw's origin is 3 mm along its own x beside the ball's middle
    assert middle[:2] == pytest.approx([-3.0, 0.0], abs=0.1)
    radius = np.linalg.norm(right.rest_mm[:, :2] - middle[:2], axis=1)
    contact = float(radius[weight > 0].max())
    gel_mm = np.sqrt(29 / np.pi)
    indentation_mm = CLOSED_MM - 0.4
    expected = next(
        a for a in np.arange(0.1, 20, 0.001) if a**2 >= JAW_FRUIT_MM * indentation_mm / (1 + a / gel_mm)
    )
    assert contact == pytest.approx(expected, rel=0.15)
    # Hertz's pressure has a mean square radius of 2/5 of the contact's
    assert np.sqrt(weight @ radius**2 / weight.sum()) == pytest.approx(np.sqrt(0.4) * expected, rel=0.03)


def test_where_the_flesh_is_known_the_contact_is_as_wide_as_hertz_has_it_of_the_force() -> None:
    """Johnson 1985, eq. 4.22: a^3 = 3 F R / (4 E*), in every frame."""
    plane_strain_MPa = 0.8
    right = with_plain_jaw(grasp(), SKIN, source="g.h5", plane_strain_MPa=plane_strain_MPa).pads[1]
    for frame in (FRAMES // 2, FRAMES - 1):
        weight = right.force_N[frame, :, 2]
        middle = weight @ right.rest_mm / weight.sum()
        radius = np.linalg.norm(right.rest_mm - middle, axis=1)
        hertz = np.cbrt(0.75 * weight.sum() * JAW_FRUIT_MM / plane_strain_MPa)
        assert np.sqrt(weight @ radius**2 / weight.sum()) == pytest.approx(np.sqrt(0.4) * hertz, rel=0.03)


def test_only_a_gel_and_a_plate_make_such_a_grasp() -> None:
    recording = grasp()
    assert has_plain_jaw(recording)
    two = replace(recording, pads=(recording.pads[0], replace(recording.pads[0], name="right")))
    assert not has_plain_jaw(two)
    assert with_plain_jaw(two, SKIN, source="g.h5") is two
    assert not has_plain_jaw(replace(recording, loading="press"))


def test_a_jaw_that_faces_away_is_refused() -> None:
    recording = grasp()
    right = recording.pads[1]
    away = right.pose.copy()
    away[:, :3, 1:3] *= -1
    turned = replace(recording, pads=(recording.pads[0], replace(right, pose=away)))
    with pytest.raises(
        TactileFailure, match=r"g\.h5: pads/right: found a plain jaw without round skin in front of it"
    ):
        with_plain_jaw(turned, SKIN, source="g.h5")
