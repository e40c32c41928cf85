"""The fruit's skin: colours from photos in their place, markers' residuals around them, outlines."""

import cv2
import numpy as np
import pytest
import trimesh

from recon.silhouettes.hull import ball
from reports.outlined_photos import (
    COLUMNS,
    MARGIN,
    NAME_PX,
    TILE_PX,
    OutlinedPhoto,
    outline_sheet_jpeg,
    outlined_photo_jpeg,
)
from reports.skin_layer import REACH, PatchResidual, on_skin, residual_layer
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
    assert np.abs(made[directions()[..., 0] < -0.7] - UNSEEN).max() < 4
    assert np.abs(made[..., 1] - 128).max() < 60  # the background's green is 255


def test_without_photos_there_is_none():
    assert texture([]) is None
    assert texture([SkinPhoto(photo(0, 20).image, photo(0, 20).pixels_from_mesh, MIDDLE_MM)]) is None


SPHERE_MM = 25.0 * ball(4)[0]
PITCH_MM = 1.5


def patch():
    """Markers on the sphere about +x, PITCH_MM apart."""
    y, z = (grid.ravel() for grid in np.meshgrid(*2 * [np.arange(-6, 6.1, PITCH_MM)]))
    return np.column_stack([np.sqrt(25.0**2 - y**2 - z**2), y, z])


def test_a_constant_stays_and_a_slope_keeps_its_slope():
    places = patch()
    values, near = on_skin(SPHERE_MM, places, np.full(len(places), 7.0))
    np.testing.assert_allclose(values, 7.0)
    distance = np.linalg.norm(SPHERE_MM[:, None] - places, axis=2).min(axis=1)
    assert (near == (distance < REACH * np.median(_to_neighbour(places)))).all()
    sloped, near = on_skin(SPHERE_MM, places, 10.0 * places[:, 1])
    inner = near & (np.abs(SPHERE_MM[:, 1:]) < 4.0).all(axis=1)
    assert np.polyfit(SPHERE_MM[inner, 1], sloped[inner], 1)[0] == pytest.approx(10.0, rel=0.1)


def _to_neighbour(places):
    return np.sort(np.linalg.norm(places[:, None] - places, axis=2), axis=1)[:, 1]


def layer_of(values):
    return residual_layer(SPHERE_MM, [PatchResidual(name="g, left", places_mm=patch(), residual_um=values)])


def test_blue_where_the_skin_went_farther_in_red_where_less():
    layer = layer_of(np.where(patch()[:, 1] > 0, 60.0, -60.0))
    (red, _, blue), y = layer.colours.T, SPHERE_MM[:, 1]
    assert (blue - red)[layer.shown & (y > 2)].min() > 0.2
    assert (red - blue)[layer.shown & (y < -2)].min() > 0.2


def test_a_lone_marker_makes_no_map():
    lone = PatchResidual(name="g", places_mm=patch()[:1], residual_um=np.zeros(1))
    assert residual_layer(SPHERE_MM, [lone]) is None


def test_over_the_whole_skin_grasps_that_overlap_are_averaged():
    places = patch()
    patches = [
        PatchResidual(name=name, places_mm=places, residual_um=np.full(len(places), value))
        for name, value in (("g, left", 60.0), ("h, left", 20.0))
    ]
    layer = residual_layer(SPHERE_MM, patches)
    assert layer.values[layer.shown] == pytest.approx(40.0)
    assert (layer.values[~layer.shown] == 0).all()
    assert layer.limit == pytest.approx(60.0)
    assert 0 < layer.shown.sum() < 0.5 * len(SPHERE_MM)
    assert residual_layer(SPHERE_MM, []) is None


def disc(centre, radius, *, name="a.jpg", size=(900, 700)):
    """A red disc on grey, and its circle."""
    turn = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    circle = np.array(centre) + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    image = np.full((size[1], size[0], 3), 150, np.uint8)
    cv2.fillPoly(image, [np.round(circle * 16).astype(np.int32)], (40, 40, 170), shift=4)
    return OutlinedPhoto(name, image, circle)


def lined(jpeg):
    """The picture, and (column, row) of the pixels of its line."""
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    blue, _, red = np.moveaxis(image.astype(int), 2, 0)
    return image, np.argwhere(blue > red + 60)[:, ::-1]


@pytest.mark.parametrize("longest_px", [300, 560, 900])
def test_the_line_lies_on_the_outline(longest_px):
    image, line = lined(outlined_photo_jpeg(disc((420.0, 310.0), 150.0), longest_px=longest_px))
    scale = longest_px / 900
    assert image.shape[1] == longest_px
    away = np.linalg.norm(line - ((np.array([420.0, 310.0]) + 0.5) * scale - 0.5), axis=1) - 150 * scale
    assert len(line) > 2 * 150 * scale
    assert np.abs(away).max() < 2.5
    assert abs(away.mean()) < 0.5


def test_a_photo_is_not_drawn_upon():
    photo = disc((420.0, 310.0), 150.0)
    before = photo.image.copy()
    outlined_photo_jpeg(photo, longest_px=2000)
    outline_sheet_jpeg([photo])
    assert (photo.image == before).all()


@pytest.mark.parametrize(
    "centre", [(420.0, 310.0), (60.0, 640.0)], ids=["inside", "cut off by the photo's edge"]
)
@pytest.mark.parametrize("radius", [40.0, 150.0], ids=["enlarged", "shrunk"])
def test_each_tile_shows_its_fruit_in_the_middle(centre, radius):
    photos = [disc((450.0, 350.0), 100.0)] * COLUMNS + [disc(centre, radius)]
    image, line = lined(outline_sheet_jpeg(photos))
    assert image.shape == (2 * (TILE_PX + NAME_PX), COLUMNS * TILE_PX, 3)
    last = line[(line[:, 1] > TILE_PX + NAME_PX) & (line[:, 0] < TILE_PX)] - [0, TILE_PX + NAME_PX]
    away = np.linalg.norm(last - (TILE_PX - 1) / 2, axis=1)
    assert np.abs(away - TILE_PX / 2 / (1 + 2 * MARGIN)).max() < 3.5
    # the fruit, not only the line, is there: red a little inside, none a little outside of the line
    tile = image[TILE_PX + NAME_PX :, :TILE_PX].astype(int)
    middle = TILE_PX // 2
    assert tile[middle, middle, 2] > tile[middle, middle, 0] + 80
    assert tile[8, middle, 2] < tile[8, middle, 0] + 30
