"""Which frames a modulus rests on: all, an even choice, or the heaviest one against the scanned surface."""

from dataclasses import replace

import numpy as np
import pytest
from injected_recording import E_MPA, PHASES, RADII_MM, found_in, grasp, with_pads

from fem.estimation.frame_thinning import MOST_FRAMES, spacing, thinned
from fem.estimation.modulus_warnings import ModulusSign
from fem.grasp_history import GraspHistory


def one_frame(history: GraspHistory, frame: int) -> GraspHistory:
    only = slice(frame, frame + 1)
    pressed = with_pads(
        history,
        position_mm=lambda pad: pad.position_mm[only],
        gel_displacement_mm=lambda pad: pad.gel_displacement_mm[only],
        force_N=lambda pad: pad.force_N[only],
        episode=lambda pad: pad.episode[only],
    )
    return replace(pressed, time_s=history.time_s[only], phase=history.phase[only])


def test_one_loaded_frame_falls_back_on_the_surface():
    exact = grasp(surface_mm=0.0, noise=0.1)
    estimate = found_in(one_frame(exact, 4))
    assert estimate.form == "absolute"
    assert estimate.E_MPa == pytest.approx(E_MPA, rel=0.02)
    assert estimate.warnings[0].sign is ModulusSign.ONE_FRAME
    assert "only one frame" in estimate.warnings[0].sentence


def test_a_noisy_recording_falls_back_on_the_surface_and_says_why():
    estimate = found_in(with_pads(grasp(surface_mm=0.0, noise=0.1), displacement_sd_mm=1.0))
    assert estimate.form == "absolute"
    (warning,) = estimate.warnings
    assert "noise makes the comparison of 9 loaded frames" in warning.sentence
    assert "only one frame is loaded" not in warning.sentence


def stretched(history: GraspHistory, frames: int) -> GraspHistory:
    """The same press recorded with more frames, linear between those that there are."""
    at = np.linspace(0, len(RADII_MM) - 1, frames)
    before, share = np.minimum(at.astype(int), len(RADII_MM) - 2), at % 1
    share[-1] = 1.0

    def between(values):
        return values[before] + share[:, None, None] * (values[before + 1] - values[before])

    long = with_pads(
        history,
        position_mm=lambda pad: between(pad.position_mm),
        gel_displacement_mm=lambda pad: between(pad.gel_displacement_mm),
        force_N=lambda pad: between(pad.force_N),
        episode=lambda pad: np.minimum(pad.episode[before], pad.episode[before + 1]),
        lag1=0.9,
    )
    return replace(long, time_s=np.arange(frames) / 30, phase=tuple(PHASES[b] for b in before))


def test_a_long_recording_is_thinned_evenly():
    frames = 450
    estimate = found_in(stretched(grasp(noise=0.5), frames))
    used = np.flatnonzero(estimate.loaded)
    assert len(used) == MOST_FRAMES
    assert (used[0], used[-1]) == (0, frames - 1)
    assert set(np.diff(used)) == {3, 4}
    assert {frame.frame for frame in estimate.frames} == set(used)
    assert estimate.residual_mm.shape[0] == MOST_FRAMES
    assert estimate.E_MPa == pytest.approx(E_MPA, rel=0.01)


def test_few_frames_are_all_used():
    loaded = np.arange(300) % 3 == 0
    np.testing.assert_array_equal(thinned(loaded), loaded)
    assert spacing(loaded) == 3.0
    assert spacing(np.arange(5) == 2) == 1.0


@pytest.mark.parametrize("surface_mm", [-0.1, 0.1])
def test_the_absolute_forms_error_bar_knows_of_the_surface(surface_mm):
    scanned = grasp(surface_mm=surface_mm)
    estimate = found_in(one_frame(scanned, 4))
    assert abs(estimate.E_MPa / E_MPA - 1) > 0.03
    assert abs(estimate.E_MPa - E_MPA) < 2.5 * estimate.E_sd_MPa
