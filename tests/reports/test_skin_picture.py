"""Pictures of the skin: the fruit where it is, colours on the side that they belong to, contacts and pit."""

import cv2
import numpy as np
import pytest
from matplotlib.axes import Axes

import reports.skin_picture
from recon.silhouettes.hull import ball
from reports.figures import png_of
from reports.photo import thumbnail_jpeg
from reports.skin_picture import (
    GREY,
    MARGIN,
    MapStyle,
    coloured,
    map_picture,
    mesh_picture,
    surface_sd_map,
    view_axes,
)

RADIUS_MM, VIEW_PX = 30.0, 160
DIRECTIONS, FACES = ball(4)
SPHERE_MM = RADIUS_MM * DIRECTIONS


@pytest.fixture(autouse=True)
def lossless(monkeypatch):
    """What is drawn is asked here; WebP changes colours by a little."""
    monkeypatch.setattr(reports.skin_picture, "webp_of", png_of)


def opened(png):
    """RGB on a white page, 0 to 255."""
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED).astype(int)
    shown = image[..., 3:] / 255
    return np.round(shown * image[..., 2::-1] + (1 - shown) * 255).astype(int)


def picture(**more):
    return opened(mesh_picture(SPHERE_MM, FACES, view_px=VIEW_PX, **more))


def side(png, column, row, *, px=200):
    """The middle of one of six views, RGB."""
    middle = opened(png)[row * px + 70 : row * px + 130, column * px + 70 : column * px + 130]
    return middle.reshape(-1, 3) / 255


@pytest.mark.parametrize("azimuth_deg", [0.0, 35.0, 215.0])
def test_view_axes_are_right_handed_and_up_is_up(azimuth_deg):
    axes = view_axes(azimuth_deg, 24.0)
    assert np.allclose(axes @ axes.T, np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[1, 2] > 0
    assert np.allclose(view_axes(0.0, 0.0)[0], [0, 1, 0])


def test_the_fruit_is_drawn_to_scale():
    """A disk of the ball's radius in each half; arrows and bar are dark."""
    whole = opened(mesh_picture(SPHERE_MM, FACES))
    flesh = (whole[..., 0] - whole[..., 2]) > 30
    mm_per_px = 2 * MARGIN * RADIUS_MM / whole.shape[0]
    assert flesh.sum() * mm_per_px**2 == pytest.approx(2 * np.pi * RADIUS_MM**2, rel=0.02)


def test_letters_and_scale_are_beside_the_fruit_and_legible_on_a_phone():
    px, phone_px = 440, 394  # of a view; of the whole picture on a screen 420 px wide
    dark = opened(mesh_picture(SPHERE_MM, FACES, view_px=px)).max(axis=2) < 90
    rows, columns = np.indices(dark.shape)
    assert not dark[np.hypot(rows - px / 2, columns % px - px / 2) < px / 2 / MARGIN].any()
    assert not dark[: px // 2].any()  # no words that a page in another language could not translate
    bar = px + np.flatnonzero(dark[px // 2 :, -px // 3 :].any(axis=1))
    digits = np.flatnonzero(dark[px // 2 : bar[-1] - px - 4 + px // 2, -px // 3 :].any(axis=1))
    assert np.ptp(digits) * phone_px / (2 * px) >= 7


@pytest.mark.parametrize("kind", ["mesh", "map"])
def test_a_picture_has_no_ground_and_its_ink_is_outlined(kind):
    """So that it is legible on a light and on a dark page."""
    png = drawn(np.ones(len(SPHERE_MM))) if kind == "map" else mesh_picture(SPHERE_MM, FACES)
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    colours, opaque = image[..., :3], image[..., 3]
    assert not opaque[:: len(opaque) - 1, :: len(opaque[0]) - 1].any()  # the corners
    ink = (opaque > 200) & (colours.max(axis=2) < 90)
    outline = ((opaque > 200) & (colours.min(axis=2) > 200)).astype(np.uint8)
    assert ink.sum() > 50
    assert cv2.dilate(outline, np.ones((9, 9)))[ink].mean() > 0.99


def test_the_pit_darkens_only_the_middle():
    bare, pitted = picture(), picture(pit_vertices=DIRECTIONS * 10.0)
    assert (bare - pitted)[70:90, 70:90].mean() > 30
    change = np.abs(bare - pitted).sum(axis=2)
    assert change[40, 60:100].max() == 0
    assert change[75, 120:VIEW_PX].max() == 0


def test_contacts_are_dots_on_the_side_that_was_touched():
    towards = np.array([np.cos(np.deg2rad(35)), np.sin(np.deg2rad(35)), 0.0])
    across = np.array([-towards[1], towards[0], 0.0])
    u, v = (axis.ravel()[:, None] for axis in np.meshgrid(np.linspace(-6, 6, 13), np.linspace(-6, 6, 13)))
    grid = 29.0 * towards + u * across + v * np.array([0, 0, 1.0])
    bare, touched = picture(), picture(contacts_mm={"left": grid, "right": np.empty((0, 3))})
    change = np.abs(bare - touched).sum(axis=2)
    assert (change[:, VIEW_PX:] > 60).sum() == 0
    rows, columns = np.nonzero(change[:, :VIEW_PX] > 60)
    mm_per_px = 2 * MARGIN * RADIUS_MM / VIEW_PX
    assert np.ptp(columns) * mm_per_px == pytest.approx(12.0, abs=2.0)
    assert np.ptp(rows) * mm_per_px == pytest.approx(12.0 * np.cos(np.deg2rad(24)), abs=2.5)


STYLE = MapStyle(signed=True)


def drawn(values, seen=None, **more):
    seen = np.ones(len(SPHERE_MM), bool) if seen is None else seen
    skin, limit = coloured(SPHERE_MM, FACES, values, style=STYLE, seen=seen)
    return map_picture(skin, limit=limit, style=STYLE, view_px=200, **more)


def test_low_is_red_high_is_blue_and_what_nobody_can_see_is_grey():
    png = drawn(8.0 * np.sign(DIRECTIONS[:, 0]), seen=DIRECTIONS[:, 2] > -0.8)
    red, blue, below = side(png, 2, 0).mean(axis=0), side(png, 0, 0).mean(axis=0), side(png, 2, 1)
    assert red[0] > red[2] + 0.2
    assert blue[2] > blue[0] + 0.2
    assert np.ptp(below - np.array(GREY), axis=1).max() < 0.06


def test_the_bar_reaches_the_largest_value_that_is_seen_and_a_least_one():
    values = np.where(DIRECTIONS[:, 0] > 0, 20.0, 5.0)
    for seen, expected in ((values > 0, 20.0), (values < 10, 5.0), (values < 0, 20.0)):
        assert coloured(SPHERE_MM, FACES, values, style=STYLE, seen=seen)[1] == expected
    assert coloured(SPHERE_MM, FACES, 0 * values, style=STYLE, seen=values > 0)[1] == STYLE.least


def test_a_spot_is_ringed_on_the_side_that_it_faces():
    plain, ringed = (drawn(np.zeros(len(SPHERE_MM)), **spot) for spot in ({}, SPOT))
    change = np.abs(opened(plain) - opened(ringed)).sum(axis=2)
    assert (change[:200, :200] > 100).any()
    assert (change[:200, 400:600] > 0).sum() == 0


SPOT = {"centre_mm": (RADIUS_MM, 0.0, 0.0), "radius_mm": 5.0}


def sd_map(sd_mm, seen=None):
    seen = np.ones(len(SPHERE_MM), bool) if seen is None else seen
    return surface_sd_map(SPHERE_MM, FACES, sd_mm, seen=seen)


def test_the_map_of_the_surface_has_no_words_but_its_unit(monkeypatch):
    written = []
    monkeypatch.setattr(Axes, "text", lambda self, x, y, words, **how: written.append(words))
    sd_map(np.full(len(SPHERE_MM), 0.2), seen=DIRECTIONS[:, 2] > 0)
    assert written == ["0 mm", "0.1 mm", "0.2 mm"]


def test_the_side_known_worse_is_darker_whatever_a_few_vertices_are():
    sd_mm = np.where(DIRECTIONS[:, 0] > 0, 0.05, 0.5)
    assert side(sd_map(sd_mm), 0, 0).mean() > side(sd_map(sd_mm), 2, 0).mean() + 0.2
    worst = sd_mm.copy()
    worst[DIRECTIONS[:, 2].argmin()] = 40.0
    assert side(sd_map(worst), 2, 0).mean(0) == pytest.approx(side(sd_map(sd_mm), 2, 0).mean(0), abs=0.02)


def test_thumbnail_keeps_the_shape_and_never_grows():
    photo = np.full((600, 900, 3), 120, np.uint8)
    for longest_px, expected in ((300, (200, 300, 3)), (2000, (600, 900, 3))):
        jpeg = thumbnail_jpeg(photo, longest_px=longest_px)
        assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape == expected
