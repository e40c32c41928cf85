import cv2
import numpy as np

from samples.gel_images import GelLight, GelLook, gel_image, seen_at, seen_material
from tactile.sensors import GelCamera, marker_grid


def eye(lens: tuple[float, float, float, float, float] = (-0.12, 0.03, 0.001, -0.001, 0.0)) -> GelCamera:
    pose = np.eye(4)
    pose[:3, 3] = 0.2, -0.1, -22.0
    return GelCamera(
        image_px=(320, 240),
        focal_px=(390.0, 392.0),
        centre_px=(161.0, 118.0),
        distortion=lens,
        gel_from_camera=pose,
    )


def dent(at: np.ndarray) -> np.ndarray:
    depth = np.exp(-(at**2).sum(axis=1) / 8)
    return np.stack([0.1 * depth * at[:, 0], 0.2 * depth, -0.6 * depth], axis=1)


def test_projection_is_opencvs() -> None:
    points = np.random.default_rng(0).uniform([-6, -4, -1], [6, 4, 0.5], (40, 3))
    camera = eye()
    moved = points - camera.gel_from_camera[:3, 3]
    expected = cv2.projectPoints(moved, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    np.testing.assert_allclose(seen_at(camera, points), expected[0][:, 0], atol=1e-9)


def test_the_material_a_pixel_shows_projects_back_onto_it() -> None:
    pixels = np.random.default_rng(1).uniform([0, 0], [319, 239], (200, 2))
    material = seen_material(eye(), pixels, dent)
    place = np.column_stack([material, np.zeros(200)]) + dent(material)
    np.testing.assert_allclose(seen_at(eye(), place), pixels, atol=2e-3)


def test_dots_are_drawn_where_their_markers_project() -> None:
    look = GelLook(rest_mm=marker_grid(5, 7, pitch_mm=(1.7, 1.7), first_mm=None), dot_mm=0.5, noise=0.0)
    image = gel_image(eye(), (), look, dent, np.random.default_rng(2)).astype(float).mean(axis=2)
    gel = 255 * 0.6
    for place in look.rest_mm + dent(look.rest_mm[:, :2]):
        at = seen_at(eye(), place[None])[0]
        x, y = np.rint(at).astype(int)
        rows, columns = np.mgrid[y - 8 : y + 9, x - 8 : x + 9]
        weight = np.maximum(gel * 0.7 - image[y - 8 : y + 9, x - 8 : x + 9], 0)
        centre = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
        np.testing.assert_allclose(centre, at, atol=0.15)


def test_a_tilted_face_is_lit_by_lamberts_cosine() -> None:
    slope = 0.2
    light = GelLight(direction=np.array([0.6, 0.0, -0.8]), colour=np.array([1.0, 0.5, 0.25]))
    look = GelLook(
        rest_mm=np.full((1, 3), 50.0), gel=(0.5, 0.5, 0.5), ambient=0.1, vignette=0.0, noise=0.0, blur_px=0.1
    )
    tilted = gel_image(
        eye(), (light,), look, lambda at: np.outer(at[:, 0], [0, 0, slope]), np.random.default_rng(3)
    )
    inward = np.array([slope, 0, -1]) / np.hypot(slope, 1)
    expected = 255 * 0.5 * (0.1 + (inward @ light.direction) * light.colour)
    np.testing.assert_allclose(tilted[120, 160], expected, atol=0.6)
