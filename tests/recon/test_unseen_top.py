"""How much too tall a fruit comes out whose top no photo shows from the side."""

import numpy as np
import pytest
from level_camera import camera_at, direction

from recon.scale import TopExcess, fitted_excess, hull_excess, scale_without_mat


def looking_down(count, elevation_deg, *, tall_mm=60.0, distance_mm=330.0):
    """Cameras all around, each of which sees the top of the fruit at the elevation."""
    top, middle = np.array([0.0, 0.0, tall_mm]), np.array([0.0, 0.0, tall_mm / 2])
    return [
        camera_at(
            top + distance_mm * direction(360 * i / count, elevation_deg), middle,
            size_px=(960, 720), focal_px=1100.0,
        )
        for i in range(count)
    ]  # fmt: skip


@pytest.mark.parametrize("elevation_deg", [0.0, 15.0, 30.0, 45.0])
def test_the_hull_of_a_ball_is_too_tall_by_the_cosine(elevation_deg):
    closed_form = (1 / np.cos(np.radians(elevation_deg)) - 1) / 2
    assert hull_excess(np.ones(3), np.radians(elevation_deg)) == pytest.approx(closed_form)


def test_the_scale_of_a_ball_made_too_tall_is_put_right():
    """A ball of 60 mm as its fitted mesh from 45 degrees: its height is not that of the fruit."""
    cameras = looking_down(12, 45.0)
    ball = np.random.default_rng(2).normal(size=(4000, 3))
    ball = 30 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [0, 0, 30]
    made = ball * [1, 1, 1 + fitted_excess(cameras, np.full(3, 60.0))]
    made[0] = [0, 0, 0]

    def scale(top_measured):
        return scale_without_mat(
            made, [], cameras, height_mm=60.0, height_sd_mm=0.2, surface_sd=0.1, coin=None,
            top_measured=top_measured,
        )  # fmt: skip

    plain, corrected = scale(1.0), scale(0.0)
    assert plain.factor < 0.95
    assert abs(corrected.factor - 1) < 1.5 * corrected.sd
    assert abs(corrected.factor - 1) < 0.6 * abs(plain.factor - 1)
    assert "too tall" in corrected.warnings[0]


def test_a_top_measured_in_part_has_the_spread_of_either():
    rng = np.random.default_rng(4)
    drawn = np.where(rng.random(200_000) < 0.4, 0.0, rng.normal(0.04, 0.01, 200_000))
    excess = TopExcess(value=0.04, sd=0.01).remaining(0.4)
    assert (excess.value, excess.sd) == pytest.approx((drawn.mean(), drawn.std()), rel=0.01)
