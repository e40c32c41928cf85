"""The map of the surface's error: colours follow the error, its bar fits what was seen, the rest hatched."""

import io

import numpy as np
from matplotlib.image import imread

from recon.silhouettes.hull import ball
from reports.surface_maps import LEAST_MM, surface_sd_map

SIDE_PX = 200
SPHERE, FACES = ball(3)


def side(png, column, row):
    """The middle of one of the six views, RGB."""
    image = imread(io.BytesIO(png), format="png")[..., :3]
    middle = image[row * SIDE_PX + 70 : row * SIDE_PX + 130, column * SIDE_PX + 70 : column * SIDE_PX + 130]
    return middle.reshape(-1, 3)


def drawn(sd_mm, seen=None):
    seen = np.ones(len(SPHERE), bool) if seen is None else seen
    return surface_sd_map(25 * SPHERE, FACES, sd_mm, seen=seen)


def test_the_side_known_worse_is_painted_darker():
    png = drawn(np.where(SPHERE[:, 0] > 0, 0.05, 0.5))
    suture_side, opposite = side(png, 0, 0), side(png, 2, 0)
    assert suture_side.mean() > opposite.mean() + 0.2


def test_a_few_vertices_far_worse_do_not_take_the_colour_from_the_rest():
    sd_mm = np.where(SPHERE[:, 0] > 0, 0.05, 0.5)
    worst = sd_mm.copy()
    worst[SPHERE[:, 2].argmin()] = 40.0
    np.testing.assert_allclose(side(drawn(worst), 2, 0).mean(0), side(drawn(sd_mm), 2, 0).mean(0), atol=0.02)


def test_a_surface_known_far_better_than_the_bars_least_reach_stays_pale():
    good, bad = drawn(np.full(len(SPHERE), 0.02 * LEAST_MM)), drawn(np.full(len(SPHERE), LEAST_MM))
    assert side(good, 0, 0).mean() > side(bad, 0, 0).mean() + 0.2


def test_skin_that_no_two_photos_show_is_hatched_grey():
    png = drawn(np.full(len(SPHERE), 0.1), seen=SPHERE[:, 0] > 0)
    grey = np.ptp(side(png, 2, 0), axis=1) < 0.06
    assert grey.mean() > 0.95
    assert (np.ptp(side(png, 0, 0), axis=1) < 0.06).mean() < 0.05
