"""An edge further out on the same side of all photos goes with the camera; one on the fruit does not."""

import numpy as np
import pytest

from recon.checks.ground_check import RimEvidence
from recon.checks.surface_error import in_camera_shadow, left_right_px, shadow_sd_mm

VIEWS, SAMPLES, PIXEL_MM = 24, 96, 0.25
VIEW = np.repeat(np.arange(VIEWS), SAMPLES)
TURN = np.tile(np.linspace(-np.pi, np.pi, SAMPLES, endpoint=False), VIEWS)


def evidence(offset_px, known=True):
    noise = np.random.default_rng(1).normal(0, 0.3, len(VIEW))
    nothing = np.zeros(len(VIEW))
    return RimEvidence(
        view=VIEW, a=nothing.astype(int), b=nothing.astype(int), t=nothing,
        offset_mm=(offset_px + noise) * PIXEL_MM, sd_mm=nothing + 0.1, pixel_mm=nothing + PIXEL_MM,
        known=np.full(len(VIEW), known), turn=TURN,
    )  # fmt: skip


LOW_LEFT = (np.cos(TURN) < 0) & (np.sin(TURN) < -0.3)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_shadow_low_on_one_side_of_every_photo_is_measured(sign):
    side = LOW_LEFT if sign > 0 else (np.cos(TURN) > 0) & (np.sin(TURN) < -0.3)
    apart = left_right_px(evidence(np.where(side, 2.0, 0.0)))
    assert apart[:2] == pytest.approx([2.0 * sign, 2.0 * sign], abs=0.15)
    assert apart[2] == pytest.approx(0.0, abs=0.15)


def test_edges_on_the_shadows_side_and_below_tell_nothing_of_the_mesh():
    shaded = in_camera_shadow(evidence(np.where(LOW_LEFT, 2.0, 0.0)))
    low = (np.sin(TURN) < np.sin(np.radians(-20))) & (np.sin(TURN) > np.sin(np.radians(-74)))
    assert shaded[low & (np.cos(TURN) < 0)].all()
    assert not shaded[low & (np.cos(TURN) > 0)].any()
    assert shaded[np.sin(TURN) < np.sin(np.radians(-76))].all()
    assert not shaded[np.sin(TURN) > np.sin(np.radians(-14))].any()
    assert not in_camera_shadow(evidence(np.zeros(len(VIEW)))).any()


def test_only_the_bands_with_the_shadow_become_uncertain_and_what_lies_below_them():
    low = np.sin(TURN) < -0.3
    sd_mm = shadow_sd_mm(evidence(np.where(LOW_LEFT, 1.5, -0.5 * low)))
    assert sd_mm[np.sin(TURN) < np.sin(np.radians(-46))] == pytest.approx(2.0 * PIXEL_MM, rel=0.1)
    assert (sd_mm[np.sin(TURN) > np.sin(np.radians(-14))] == 0).all()
    assert (shadow_sd_mm(evidence(np.zeros(len(VIEW)))) == 0).all()
