"""Silhouettes and visual hulls of a ball, whose cones, shadows and limits are closed forms."""

import numpy as np
import pytest
from known_ball import (
    CENTRE,
    DISTANCE_MM,
    FOCAL_PX,
    RADIUS_MM,
    RIM_PX,
    SIZE_PX,
    camera_towards,
    directions,
    exact_silhouette,
    from_rim_px,
    inside_cone,
    whole_window,
)

from recon.picture_values import sampled
from recon.silhouettes.hull import Silhouette, ball, drawn, silhouette_of_mask, visual_hull
from recon.silhouettes.segmentation import CELLS, Block, carve
from recon.triangle_mesh import open_edges, volume_mm3

LOW, HIGH = CENTRE - 30.0, CENTRE + 30.0
CELL_MM = 60.0 / CELLS
BALL_MM3 = 4 / 3 * np.pi * RADIUS_MM**3


def masks_of(count: int) -> list[np.ndarray]:
    return [from_rim_px() > 0] * count


def carved(masks, towards, *, known=None, **how) -> Block:
    return carve(
        masks,
        [np.ones_like(m) for m in masks] if known is None else known,
        [whole_window()] * len(masks),
        [camera_towards(toward) for toward in towards],
        low_mm=LOW,
        high_mm=HIGH,
        **how,
    )


def block_mm3(block: Block) -> float:
    return float(block.filled.sum() * block.cell_mm**3)


def test_the_block_holds_the_ball_and_its_volume_falls_to_the_balls_with_more_views():
    centres = LOW + (np.indices((CELLS, CELLS, CELLS)).reshape(3, -1).T + 0.5) * CELL_MM
    inside = np.linalg.norm(centres - CENTRE, axis=1) < RADIUS_MM - 0.2  # a pixel is 0.28 mm there
    volumes = []
    for count in (4, 10, 40):
        block = carved(masks_of(count), directions(count), agreement=1.0)
        assert block.filled.ravel()[inside].all()
        volumes.append(block_mm3(block) / BALL_MM3)
    assert volumes == sorted(volumes, reverse=True)
    assert volumes[0] > 1.05
    assert volumes[-1] == pytest.approx(1.0, abs=0.03)  # half a pixel, 0.14 mm, of the radius thrice


def test_two_empty_masks_of_twentyfour_are_outvoted_and_eight_are_not():
    empty = np.zeros_like(from_rim_px(), dtype=bool)
    few = carved([empty] * 2 + masks_of(22), directions(24))
    many = carved([empty] * 8 + masks_of(16), directions(24))
    assert block_mm3(few) > 0.98 * BALL_MM3
    assert not many.filled.any()


def test_views_that_know_nothing_neither_add_nor_remove_cells():
    full, empty = np.ones((SIZE_PX, SIZE_PX), bool), np.zeros((SIZE_PX, SIZE_PX), bool)
    towards = directions(24)
    alone = carved(masks_of(16), towards[8:], agreement=1.0)
    for blank in (full, empty):
        known = [empty] * 8 + [full] * 16
        some = carved([blank] * 8 + masks_of(16), towards, known=known, agreement=1.0)
        assert (some.filled == alone.filled).all()
        assert not carved([blank] * 24, towards, known=[empty] * 24).filled.any()


LONGEST_MM = 60.0


def hull(silhouettes, *, level=3, **how):
    return visual_hull(silhouettes, centre_mm=CENTRE, longest_mm=LONGEST_MM, level=level, **how)


def cone_exit_mm(rays: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """How far from the ball's centre rays leave the cone that touches the ball from DISTANCE_MM away.

    (d - r m)² = c² (r² - 2 r d m + d²) with m the cosine to the camera, c that of the cone's half angle.
    """
    m, d, c2 = rays @ towards, DISTANCE_MM, 1 - (RADIUS_MM / DISTANCE_MM) ** 2
    a, b, c = m**2 - c2, -2 * d * m * (1 - c2), d**2 * (1 - c2)
    roots = np.array([(-b + s * np.sqrt(np.maximum(b**2 - 4 * a * c, 0.0))) / (2 * a) for s in (-1, 1)])
    ahead = (roots > 0) & (d - roots * m > 0)
    return np.where(ahead, roots, np.inf).min(axis=0)


def test_the_hull_ends_where_rays_leave_the_nearest_cone():
    towards = directions(9)
    vertices, faces = hull([exact_silhouette(camera_towards(toward)) for toward in towards])
    rays, _ = ball(3)
    expected = np.min([cone_exit_mm(rays, toward) for toward in towards], axis=0)
    radius = np.linalg.norm(vertices - CENTRE, axis=1)
    near = expected < 0.9 * LONGEST_MM
    assert near.mean() > 0.95
    np.testing.assert_allclose(radius[near], expected[near], atol=0.03)
    assert open_edges(faces) == 0


def test_a_balls_hull_grows_by_half_the_squared_angle_to_the_nearest_rim():
    azimuth = np.arange(8) * np.pi / 4
    towards = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    vertices, _ = hull([exact_silhouette(camera_towards(toward)) for toward in towards], level=4)
    rays, _ = ball(4)
    rim = np.arccos(RADIUS_MM / DISTANCE_MM)
    delta = np.abs(np.arccos(np.clip(rays @ towards.T, -1, 1)) - rim).min(axis=1)
    far = delta > 0.15
    growth = np.linalg.norm(vertices - CENTRE, axis=1) / RADIUS_MM - 1
    np.testing.assert_allclose(growth[far], delta[far] ** 2 / 2, rtol=0.1)
    assert far.sum() > 100


def test_one_outline_too_small_eats_a_strict_hull_and_not_one_of_most_views():
    views = [exact_silhouette(camera_towards(direction)) for direction in directions(24)]
    views[5] = Silhouette(views[5].distance_px - 30.0, views[5].window, views[5].camera)
    strict, faces = hull(views)
    tolerant, _ = hull(views, outlier_share=0.1)
    assert volume_mm3(strict, faces) < 0.75 * BALL_MM3
    assert volume_mm3(tolerant, faces) > 0.99 * BALL_MM3


def test_the_distance_to_a_masks_edge_is_that_to_the_circle():
    truth = from_rim_px()
    camera = camera_towards(np.array([1.0, 0.0, 0.0]))
    silhouette = silhouette_of_mask(truth > 0, whole_window(), camera)
    assert np.abs(silhouette.distance_px - truth).max() < 0.6
    assert np.abs(np.mean(silhouette.distance_px - truth)) < 0.1


def test_depth_inside_the_cone_is_in_millimetres_at_the_points_own_depth():
    camera = camera_towards(np.array([0.0, 1.0, 0.0]))
    silhouette = exact_silhouette(camera)
    aside = np.array([1.0, 0.0, 0.0])
    rim_mm = DISTANCE_MM * RIM_PX / FOCAL_PX  # of the cone beside the centre
    points = CENTRE + np.array([0.0, 5.0, rim_mm - 3.0])[:, None] * aside
    np.testing.assert_allclose(silhouette.depth_mm(points), [rim_mm, rim_mm - 5.0, 3.0], atol=0.1)
    nearer = CENTRE + 50.0 * np.array([0.0, 1.0, 0.0])  # where the cone is narrower by a fifth
    np.testing.assert_allclose(silhouette.depth_mm(nearer[None]), 0.8 * rim_mm, atol=0.1)


@pytest.mark.parametrize("off_axis", [[0.0, 0.0, 0.0], [0.0, 5.0, 4.0]])
def test_the_shadow_of_a_ball_is_the_conic_that_its_tangent_cone_cuts(off_axis):
    camera = camera_towards(np.array([0.6, -0.64, 0.48]), off_axis=np.array(off_axis))
    directions_, faces = ball(5)
    shadow = drawn(CENTRE + RADIUS_MM * directions_, faces, whole_window(), camera)
    rows, columns = np.mgrid[:SIZE_PX, :SIZE_PX]
    angle = inside_cone(np.column_stack([columns.ravel(), rows.ravel()]).astype(float), camera)
    away_px = angle.reshape(SIZE_PX, SIZE_PX) * FOCAL_PX
    np.testing.assert_array_equal(shadow[np.abs(away_px) > 1.2], (away_px > 0)[np.abs(away_px) > 1.2])
    assert shadow.sum() == pytest.approx((away_px > 0).sum(), rel=0.025)  # the rim's own pixels are filled


@pytest.mark.parametrize("direction", directions(4).tolist())
def test_the_outline_runs_where_the_distance_is_nought(direction):
    silhouette = exact_silhouette(camera_towards(np.array(direction)))
    outline = silhouette.outline_px()
    away = sampled(
        silhouette.distance_px, silhouette.window.into_small(outline).astype(np.float32), outside=np.nan
    )
    assert len(outline) > 100
    assert np.abs(away).max() < 1.5 * silhouette.window.shrink
    np.testing.assert_allclose(
        silhouette.window.from_small(silhouette.window.into_small(outline)), outline, atol=1e-9
    )
