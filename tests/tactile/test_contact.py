"""Injected noise, touches and forces are found again; a contact at the edge of the markers is said."""

import re
from dataclasses import replace

import numpy as np
import pytest
from injected_grasp import elsewhere, frames_of, injected_grasp, with_pads

from tactile.contact import Phase, contact_said, find_contact
from tactile.from_frames import MUCH_AT_EDGE, edge_share
from tactile.noise import noise_in_contact
from tactile.readers.recording import IndenterPad
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
        before = raw.force_N[: injected.no_contact_frames].mean(axis=0)
        assert np.abs(before).max() > injected.sd_N
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


@pytest.mark.parametrize("end_sd", [5.0, 8.0, 20.0, 60.0, -20.0])
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
    with pytest.raises(TactileFailure, match=rf"^a\.h5: .*{said}") as caught:
        find_contact(change(injected.recording), source="a.h5")
    assert caught.value.problem is TactileProblem.NEVER_TOUCHES


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
    with pytest.raises(TactileFailure, match=r"found a bare indenter.*give three diameters") as caught:
        find_contact(replace(injected.recording, loading="press", pads=(tip,)), source="x")
    assert caught.value.problem is TactileProblem.NO_MARKERS


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
