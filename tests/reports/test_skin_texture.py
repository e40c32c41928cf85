"""The skin from photos: a ball, whose photos are ray-traced in closed form, has its colours in place."""

import cv2
import numpy as np
import trimesh

from reports.skin_texture import HEIGHT_PX, UNSEEN, WIDTH_PX, SkinPhoto, skin_texture

RADIUS_MM, MIDDLE_MM = 30.0, np.array([5.0, -3.0, 31.0])
SIZE_PX, FOCAL_PX = 300, 420.0
BACKGROUND = (0.0, 255.0, 0.0)


def colours(towards):
    """BGR of the skin in unit directions: smooth, different on every side, no green background."""
    return 128 + 100 * towards[..., [2, 1, 0]] * (1.0, 0.4, 1.0)


def photo(azimuth_deg, elevation_deg):
    """A pinhole that looks at the ball's middle, each pixel's ray met with the sphere."""
    a, e = np.deg2rad([azimuth_deg, elevation_deg])
    back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    turn = np.stack([right, np.cross(-back, right), -back])
    place = MIDDLE_MM + 180.0 * back
    v, u = np.mgrid[:SIZE_PX, :SIZE_PX] - (SIZE_PX - 1) / 2
    ray = np.stack([u / FOCAL_PX, v / FOCAL_PX, np.ones_like(u)], axis=-1) @ turn
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    half = -ray @ (place - MIDDLE_MM)
    inside = half**2 - ((place - MIDDLE_MM) @ (place - MIDDLE_MM) - RADIUS_MM**2)
    hit = place + (half - np.sqrt(np.maximum(inside, 0)))[..., None] * ray
    image = np.where(inside[..., None] > 0, colours((hit - MIDDLE_MM) / RADIUS_MM), BACKGROUND)
    intrinsics = np.array([[FOCAL_PX, 0, (SIZE_PX - 1) / 2], [0, FOCAL_PX, (SIZE_PX - 1) / 2], [0, 0, 1.0]])
    pixels = intrinsics @ np.column_stack([turn, -turn @ place])
    return SkinPhoto(image.astype(np.uint8), pixels, place)


def nothing_hidden(start, end):
    return np.zeros(len(start), bool)


def texture(photos):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS_MM)
    made = skin_texture(np.array(ball.vertices) + MIDDLE_MM, np.array(ball.faces), photos, nothing_hidden)
    return None if not made else cv2.imdecode(np.frombuffer(made, np.uint8), cv2.IMREAD_COLOR).astype(float)


def directions():
    longitude = 2 * np.pi * (np.arange(WIDTH_PX) + 0.5) / WIDTH_PX
    polar = np.pi * (np.arange(HEIGHT_PX) + 0.5)[:, None] / HEIGHT_PX
    x, y = np.cos(longitude) * np.sin(polar), np.sin(longitude) * np.sin(polar)
    return np.stack([x, y, np.broadcast_to(np.cos(polar), x.shape)], axis=-1)


def test_every_direction_has_the_colour_of_the_skin_there():
    made = texture([photo(azimuth, elevation) for azimuth in range(0, 360, 45) for elevation in (15, 60)])
    towards = directions()
    seen = towards[..., 2] > -0.5
    error = np.abs(made - colours(towards))[seen]
    assert np.percentile(error, 99) < 6
    assert error.max() < 20


def test_skin_that_no_photo_shows_is_grey_and_no_background():
    made = texture([photo(0, 20), photo(40, 20)])
    behind = made[directions()[..., 0] < -0.7]
    assert np.abs(behind - UNSEEN).max() < 4
    assert np.abs(made[..., 1] - 128).max() < 60  # the background's green is 255


def test_without_photos_there_is_none():
    assert texture([]) is None
    assert texture([SkinPhoto(photo(0, 20).image, photo(0, 20).pixels_from_mesh, MIDDLE_MM)]) is None
