"""A surface fitted to outlines whose truth is a closed form: an ellipsoid's shadow is a conic."""

import numpy as np
import pytest
from mat_scene import Egg, ring
from scipy.ndimage import gaussian_filter1d

from recon.cameras.camera import Camera
from recon.silhouettes.hull import Silhouette, visual_hull
from recon.silhouettes.mask import Window
from recon.silhouettes.outline import Outline, silhouette_of_outline
from recon.silhouettes.tangent import FittedSurface, fitted_to_outlines
from recon.triangle_mesh import volume_mm3

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
