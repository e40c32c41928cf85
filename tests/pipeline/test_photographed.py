"""What is said of photos that were not used, and what is shown of those that were."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.fruit.photographed import _lacking, _pictures, _skin, _unused_doubts
from recon.cameras.camera import Camera
from recon.cameras.photos import Photo
from recon.checks.quality import ReconQuality
from recon.fruit_mesh import Reconstruction
from recon.silhouettes.hull import ball
from reports.outlined_photos import NAME_PX, TILE_PX
from reports.photo import thumbnail_jpeg
from reports.skin_texture import HEIGHT_PX, UNSEEN, WIDTH_PX

NAMES = [f"{i}.jpg" for i in range(6)]


def looking_in(name, azimuth):
    away = np.array([np.cos(azimuth), np.sin(azimuth), 0.4])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    ahead = -away / np.linalg.norm(away)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
    pose[:3, 3] = -pose[:3, :3] @ (300 * away)
    return Camera(name=name, width_px=96, height_px=72, focal_px=120.0, k1=0.0, cam_from_world=pose)


@pytest.fixture
def made():
    """Four of six photos used; the fifth could not be placed, the sixth was not even tried."""
    vertices, faces = ball(2)
    return Reconstruction(
        vertices=20 * vertices, faces=faces, scale_sd=0.01, surface_sd_mm=0.1,
        quality=ReconQuality(k1=0.0), warnings=(), frame="shape",
        cameras=tuple(looking_in(name, np.pi / 2 * i) for i, name in enumerate(NAMES[:4])),
        unplaced=(NAMES[4],),
    )  # fmt: skip


def test_only_a_photo_that_could_not_be_joined_shares_too_little(made):
    said = _lacking(made, NAMES)
    assert "4.jpg overlaps too little" in said
    assert "5.jpg shares" not in said


def test_on_a_mat_no_photo_is_said_to_share_too_little(made):
    assert "overlaps too little" not in _lacking(replace(made, frame="mat"), NAMES)


@pytest.mark.parametrize(("frame", "asked"), [("mat", "the mat in view"), ("shape", "the ground around it")])
def test_a_photo_left_out_is_asked_for_again_with_what_there_is(made, frame, asked):
    photos = [Photo(name=n, image=np.full((72, 96, 3), 90, np.uint8), focal_px=None) for n in NAMES[:5]]
    (said,) = _unused_doubts(photos, replace(made, frame=frame))
    assert said.startswith("drupe left out 4.jpg:")
    assert asked in said
    assert ("mat" in said) == (frame == "mat")


def test_a_photo_is_shown_with_its_outline_where_there_is_one(made):
    photos = [Photo(name=n, image=np.full((72, 96, 3), 90, np.uint8), focal_px=None) for n in NAMES[:4]]
    images = [photo.image for photo in photos]
    square = np.array([[20.0, 20.0], [60.0, 20.0], [60.0, 50.0], [20.0, 50.0]])
    outlined = replace(made, outlines=(np.zeros((0, 2)), square, square, square))
    photo, sheet = _pictures(photos[0], images, outlined)
    decoded = cv2.imdecode(np.frombuffer(sheet, np.uint8), cv2.IMREAD_COLOR)
    assert decoded.shape == (TILE_PX + NAME_PX, 3 * TILE_PX, 3)
    assert photo != _pictures(photos[0], images, made)[0]
    assert _pictures(photos[0], images, made) == (thumbnail_jpeg(photos[0].image), b"")


def with_hollow(towards):
    """Distance of a fruit's skin from its middle in unit directions: a deep hollow at the stem, mm."""
    return 30.0 - 14.0 * np.exp(-((np.arccos(np.clip(towards[..., 2], -1, 1)) / 0.3) ** 2))


def depth_on_the_way(start, end):
    """How deep the straight way from points of the skin to `end` goes into the fruit, at most, mm."""
    way = np.linspace(0.02, 0.5, 300)[:, None]
    depth = np.full(len(start), -np.inf)
    for k, point in enumerate(start):
        places = point + way * (end - point)
        away = np.linalg.norm(places, axis=1)
        depth[k] = np.max(with_hollow(places / away[:, None]) - away)
    return depth


def test_skin_that_the_fruit_itself_hides_is_grey(made):
    """One low camera: it sees the near skin, and of the hollow the far wall; by steps along each line."""
    sphere, faces = ball(5)
    camera = looking_in("a.jpg", 0.0)
    hollow = replace(made, vertices=sphere * with_hollow(sphere)[:, None], faces=faces, cameras=(camera,))
    red = np.full((camera.height_px, camera.width_px, 3), (20, 20, 220), np.uint8)
    coded = np.frombuffer(_skin([red], [camera], hollow), np.uint8)
    texture = cv2.imdecode(coded, cv2.IMREAD_COLOR).astype(float)
    row, column = (part.ravel() for part in np.mgrid[1:HEIGHT_PX:3, 0:WIDTH_PX:4])
    polar, longitude = np.pi * (row + 0.5) / HEIGHT_PX, 2 * np.pi * (column + 0.5) / WIDTH_PX
    towards = np.column_stack(
        [np.sin(polar) * np.cos(longitude), np.sin(polar) * np.sin(longitude), np.cos(polar)]
    )
    depth = depth_on_the_way(with_hollow(towards)[:, None] * towards, camera.place)
    is_red = texture[row, column, 2] - texture[row, column, 0] > 100
    is_grey = np.abs(texture[row, column] - UNSEEN).max(axis=1) < 30
    in_hollow = polar < 0.45
    assert (depth[in_hollow] > 1.0).sum() > 100
    assert not is_red[in_hollow & (depth > 1.0)].any()
    assert is_grey[in_hollow & (depth > 2.0)].all()  # nearer, the JPEG mixes colours
    facing = towards @ camera.place / np.linalg.norm(camera.place)
    assert is_red[(facing > 0.6) & ~in_hollow & (depth < -0.3)].all()
    assert (is_red & in_hollow).sum() > 20
