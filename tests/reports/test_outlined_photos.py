"""The outline is drawn where it is, in the whole photo and on the sheet."""

import cv2
import numpy as np
import pytest

from reports.outlined_photos import (
    COLUMNS,
    MARGIN,
    NAME_PX,
    TILE_PX,
    OutlinedPhoto,
    outline_sheet_jpeg,
    outlined_photo_jpeg,
)


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
