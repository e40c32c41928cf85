"""Silhouettes, hulls and surfaces fitted to outlines, whose cones, shadows and limits are closed forms."""

import numpy as np
import pytest
from level_camera import camera_at
from mat_scene import Egg, ring
from scipy.ndimage import gaussian_filter1d

from recon.cameras.camera import Camera
from recon.picture_values import sampled
from recon.silhouettes.hull import Silhouette, ball, drawn, silhouette_of_mask, visual_hull
from recon.silhouettes.mask import Window
from recon.silhouettes.outline import Outline, silhouette_of_outline
from recon.silhouettes.segmentation import CELLS, Block, carve
from recon.silhouettes.tangent import FittedSurface, fitted_to_outlines
from recon.triangle_mesh import open_edges, volume_mm3

RADIUS_MM = 20.0
DISTANCE_MM = 250.0
CENTRE = np.array([3.0, -2.0, 20.0])
SIZE_PX, FOCAL_PX = 201, 900.0
RIM_PX = FOCAL_PX * RADIUS_MM / np.sqrt(DISTANCE_MM**2 - RADIUS_MM**2)
"""Radius of the ball's picture: the tangent of asin(R / d), times the focal length."""


def directions(count: int) -> np.ndarray:
    """Nearly even unit vectors (a golden spiral)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - 5**0.5) * np.arange(count)
    flat = np.sqrt(1 - z**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def camera_towards(direction: np.ndarray, *, off_axis: np.ndarray | None = None) -> Camera:
    """A camera DISTANCE_MM from the ball's centre that looks at it, or at a point `off_axis` (mm) of it."""
    target = CENTRE + (0.0 if off_axis is None else off_axis)
    size_px = (SIZE_PX, SIZE_PX)
    return camera_at(CENTRE + DISTANCE_MM * direction, target, size_px=size_px, focal_px=FOCAL_PX)


def whole_window() -> Window:
    """The whole picture, not shrunk."""
    return Window(np.zeros((SIZE_PX, SIZE_PX, 3), np.uint8), (0, 0), 1)


def from_rim_px() -> np.ndarray:
    """Signed distance of every pixel to the ball's rim, positive inside."""
    rows, columns = np.mgrid[:SIZE_PX, :SIZE_PX] - (SIZE_PX - 1) / 2
    return RIM_PX - np.hypot(rows, columns)


def exact_silhouette(camera: Camera) -> Silhouette:
    """The ball's silhouette in a camera that looks at its centre."""
    return Silhouette(from_rim_px().astype(np.float32), whole_window(), camera)


def inside_cone(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    """Sine of the angle between a pixel's ray and the ball's rim's, positive inside: asin(R / d) less the
    ray's angle to the centre. Its zero is the conic that the ball's picture is, on the axis or off it.
    """
    rays = np.column_stack([(pixels - camera.middle_px) / camera.focal_px, np.ones(len(pixels))])
    to_centre = camera.into(CENTRE[None])[0]
    cosine = rays @ to_centre / np.linalg.norm(rays, axis=1) / np.linalg.norm(to_centre)
    return np.sin(np.arcsin(RADIUS_MM / np.linalg.norm(to_centre)) - np.arccos(np.minimum(cosine, 1.0)))


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
    return np.where((roots > 0) & (d - roots * m > 0), roots, np.inf).min(axis=0)


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
    silhouette = exact_silhouette(camera_towards(np.array([0.0, 1.0, 0.0])))
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


EGG = Egg()


def conic(camera: Camera) -> np.ndarray:
    """Outline of the egg, px: the conic whose dual is P Q* P' (Hartley and Zisserman, 8.3)."""
    a, b, c = EGG.semi_mm
    T = np.eye(4)
    T[:3, 3] = EGG.centre
    P = camera.intrinsics @ camera.cam_from_world[:3]
    C = np.linalg.inv(P @ T @ np.diag([a * a, b * b, c * c, -1.0]) @ T.T @ P.T)
    middle = -np.linalg.solve(C[:2, :2], C[:2, 2])
    size = -(C[2, 2] + C[:2, 2] @ middle)
    w, V = np.linalg.eigh(C[:2, :2] / size)
    angle = np.linspace(0, 2 * np.pi, 1024, endpoint=False)
    return middle + np.stack([np.cos(angle), np.sin(angle)], axis=1) / np.sqrt(w) @ V.T


def outline_seen(camera: Camera, wave_px: np.ndarray, shadow_px: float = 0.0) -> Silhouette:
    """The egg's outline with waves on it, and bulging where a shadow below is taken for the fruit."""
    points = conic(camera)
    tangent = np.roll(points, -1, 0) - np.roll(points, 1, 0)
    normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals *= np.sign(np.sum(normals * (points - points.mean(0)), axis=1, keepdims=True))
    wave_px = wave_px + shadow_px * np.clip((normals[:, 1] - 0.75) / 0.15, 0.0, 1.0)
    picture = np.zeros((camera.height_px, camera.width_px, 3), np.uint8)
    outline = Outline(points + wave_px[:, None] * normals, normals, 1.0)
    return silhouette_of_outline(outline, Window(picture, (0, 0), 1), camera)


def hull_and_fitted(
    count: int, *, noise_px: float, shadow_px: float = 0.0
) -> tuple[np.ndarray, FittedSurface, np.ndarray]:
    rng = np.random.default_rng(3)
    silhouettes = []
    for camera in ring(count):
        wave = gaussian_filter1d(rng.normal(size=1024), 8, mode="wrap")
        silhouettes.append(outline_seen(camera, noise_px * wave / wave.std(), shadow_px))
    vertices, faces = visual_hull(
        silhouettes, centre_mm=EGG.centre, longest_mm=60.0, floor_mm=0.0, level=4, outlier_share=0.03
    )
    return vertices, fitted_to_outlines(vertices, faces, silhouettes), faces


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_between_few_views_the_settled_surface_is_five_times_nearer_than_the_hull():
    hull, surface, faces = hull_and_fitted(8, noise_px=0.0)
    assert rms(EGG.misses_mm(surface.vertices)) < rms(EGG.misses_mm(hull)) / 5
    assert volume_mm3(surface.vertices, faces) == pytest.approx(EGG.volume_mm3, rel=0.005)


def test_noise_in_the_outlines_does_not_shrink_it_as_it_shrinks_a_strict_hull():
    _, surface, faces = hull_and_fitted(24, noise_px=0.5)
    assert volume_mm3(surface.vertices, faces) == pytest.approx(EGG.volume_mm3, rel=0.004)
    assert rms(EGG.misses_mm(surface.vertices)) < 0.2


def test_it_stands_on_the_floor_and_says_where_no_outline_holds_it():
    _, surface, _ = hull_and_fitted(24, noise_px=0.0)
    assert surface.vertices[:, 2].min() == pytest.approx(0.0, abs=0.02)
    height = surface.vertices[:, 2]
    assert np.median(surface.support[height < 0.5]) < 0.1 * np.median(surface.support[height > 10])


def test_deep_shadows_taken_for_the_fruit_do_not_carry_its_bottom_out():
    hull, surface, faces = hull_and_fitted(24, noise_px=0.0, shadow_px=8.0)
    beyond = volume_mm3(hull, faces) / EGG.volume_mm3 - 1
    assert volume_mm3(surface.vertices, faces) / EGG.volume_mm3 - 1 < beyond / 3
