"""A coin beside the fruit gives the scale, and the height checks it."""

from functools import cache

import cv2
import numpy as np
import pytest
from level_camera import camera_at, direction
from mat_scene import ring
from refusals import refused

from recon.cameras.coin import Coin, coin_scale
from recon.recon_failure import ReconProblem
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


EURO = Coin(name="1 euro", diameter_mm=23.25, thickness_mm=2.33)


@cache
def _around():
    """Twelve cameras, and what they see."""
    cameras = ring(12, width=960, height=720)
    return cameras, _pictures(cameras)


def _pictures(cameras, *, centre=(45.0, -20.0), coin=EURO):
    """The table with a pale coin of a ring and a centre, seen from each camera; the grain is noise."""
    grain = cv2.GaussianBlur(np.random.default_rng(3).normal(0, 12, (600, 600)), (0, 0), 2.0) * 4
    pictures = []
    for camera in cameras:
        v, u = np.mgrid[: camera.height_px, : camera.width_px]
        rays = np.stack([u - camera.middle_px[0], v - camera.middle_px[1], 0 * u + camera.focal_px], -1)
        rays = rays @ camera.cam_from_world[:3, :3]

        def on(height, camera=camera, rays=rays):
            return (camera.place + rays * ((height - camera.place[2]) / rays[..., 2])[..., None])[..., :2]

        ground, top = on(0.0), on(coin.thickness_mm)
        value = 90 + cv2.remap(
            grain.astype(np.float32),
            *np.moveaxis((ground + 150) * 2, 2, 0).astype(np.float32),
            cv2.INTER_LINEAR,
        )
        value[np.linalg.norm(ground - centre, axis=2) < coin.diameter_mm / 2] = 60
        away = np.linalg.norm(top - centre, axis=2)
        value[away < coin.diameter_mm / 2] = 190
        value[away < 0.7 * coin.diameter_mm / 2] = 225
        pictures.append(np.clip(np.repeat(value[..., None], 3, 2), 0, 255).astype(np.uint8))
    return pictures


@pytest.mark.parametrize(
    ("off", "spread"),
    [
        (0.94, 0.12),
        pytest.param(1.0, 0.12, marks=pytest.mark.proof),
        pytest.param(1.05, 0.12, marks=pytest.mark.proof),
        pytest.param(0.8, 0.22, marks=pytest.mark.proof),
        (1.2, 0.22),
    ],
)
def test_the_coin_gives_the_scale_whatever_it_was_thought_to_be(off, spread):
    cameras, pictures = _around()
    shrunk = [c.moved(np.diag([0.5, 0.5, 0.5, 1.0])) for c in cameras]
    coin = coin_scale(pictures, shrunk, EURO, unit_mm=2.0 * off, spread=spread)
    assert coin.factor == pytest.approx(2.0, rel=0.01)
    assert np.allclose(2 * np.array(coin.centre), [45, -20], atol=1.0)


def test_a_table_without_a_coin_is_refused():
    cameras = ring(12, width=960, height=720)
    nothing = _pictures(cameras, centre=(1e4, 1e4))
    with refused(ReconProblem.NO_SCALE, r'drupe found no coin of 23.25 mm \("1 euro"\)'):
        coin_scale(nothing, cameras, EURO, unit_mm=1.0, spread=0.12)


def scale_by(pictures, cameras, *, height_mm, height_sd_mm=0.2, coin=EURO, tall=40.0):
    """Scale of a box that is `tall` (mm) by a height and a coin."""
    box = np.array([[x, y, z] for x in (-20.0, 20) for y in (-20.0, 20) for z in (0.0, tall)])
    return scale_without_mat(
        box, pictures, cameras, height_mm=height_mm, height_sd_mm=height_sd_mm, surface_sd=0.1, coin=coin
    )


@pytest.mark.parametrize(
    ("height_mm", "height_sd_mm", "said"),
    [(40.0, 0.2, ""), (44.0, 0.2, "exceeds their errors"), (48.0, 4.0, "mm tall by the coin")],
    ids=["right", "wrong and said", "known to 8 % and 20 % too great"],
)
def test_the_coin_counts_and_a_height_that_contradicts_it_is_said(height_mm, height_sd_mm, said):
    cameras, pictures = _around()
    scale = scale_by(pictures, cameras, height_mm=height_mm, height_sd_mm=height_sd_mm)
    assert scale.factor == pytest.approx(1.0, rel=0.01)
    assert len(scale.warnings) == bool(said)
    assert said in "".join(scale.warnings)
