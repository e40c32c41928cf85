"""The background plate of a ground that is a known function of the place, from pictures of it."""

import numpy as np
import pytest
from level_camera import camera_at, direction

from recon.cameras.camera import Camera
from recon.silhouettes.background_plate import (
    FEWEST_VIEWS,
    SIDE_CELLS,
    background_in_view,
    background_plate,
    ground_views,
)

HALF_MM = 60.0
WIDTH, HEIGHT = 320, 240


def towards_origin(place: np.ndarray) -> Camera:
    return camera_at(place, np.zeros(3), size_px=(WIDTH, HEIGHT), focal_px=450.0)


def cameras(count: int) -> list[Camera]:
    return [towards_origin(330.0 * direction(360 * k / count, 35.0 + 15 * (k % 3))) for k in range(count)]


def ground(x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
    """A smooth pattern, so that resampling changes it by less than a grey level or two."""
    waves = [np.sin(x_mm / 9.0), np.cos(y_mm / 11.0), np.sin((x_mm + y_mm) / 13.0)]
    return np.stack([120 + 50 * wave for wave in waves], axis=-1)


def on_ground(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel's ray meets z = 0, by intersecting it, mm."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    pixels = np.stack([columns, rows], axis=-1)
    local = np.concatenate(
        [(pixels - camera.middle_px) / camera.focal_px, np.ones((HEIGHT, WIDTH, 1))], axis=-1
    )
    rays = local @ camera.cam_from_world[:3, :3]
    far = -camera.place[2] / rays[..., 2]
    place = camera.place + far[..., None] * rays
    return place[..., 0], place[..., 1]


def pictures(seen_by: list[Camera], *, gains=None, hidden: float = 0.0) -> tuple[list, list]:
    """What they see, and which pixels a black disc of so many mm about the origin hides."""
    images, covers = [], []
    for k, camera in enumerate(seen_by):
        x, y = on_ground(camera)
        cover = np.hypot(x - 8 * np.cos(k), y - 8 * np.sin(k)) < hidden
        colours = ground(x, y) * (1.0 if gains is None else gains[k])
        colours[cover] = 5.0
        images.append(np.clip(colours + 0.5, 0, 255).astype(np.uint8))
        covers.append(cover)
    return images, covers


def truth() -> tuple[np.ndarray, np.ndarray]:
    """The ground at the background plate's cells, and how far they are from the origin, mm."""
    step = np.linspace(-HALF_MM, HALF_MM, SIDE_CELLS)
    x, y = np.meshgrid(step, step)
    return ground(x, y), np.hypot(x, y)


def test_the_plate_is_the_ground_wherever_it_is_known():
    seen_by = cameras(7)
    background = background_plate(ground_views(pictures(seen_by)[0], seen_by, half_width_mm=HALF_MM))
    colours, away = truth()
    assert background.known[away < 0.9 * HALF_MM].all()
    miss = np.abs(background.colours.astype(float) - colours)[background.known]
    assert np.median(miss) < 1.0
    assert np.quantile(miss, 0.99) < 3.0
    assert (background.dim <= background.colours).all()
    assert (background.colours <= background.bright).all()


def test_what_hides_the_ground_is_not_in_the_plate_once_it_is_covered():
    seen_by = cameras(7)
    images, covers = pictures(seen_by, hidden=25.0)
    views = ground_views(images, seen_by, half_width_mm=HALF_MM)
    colours, away = truth()
    background = background_plate(views, covers)
    assert not background.known[away < 15].any()  # hidden in every view
    shown = background.known & (away < 40)
    assert shown[away < 40].mean() > 0.4
    assert np.quantile(np.abs(background.colours.astype(float) - colours)[shown], 0.99) < 4.0
    blind = background_plate(views)
    assert (blind.colours[away < 15] < 40).all()


def test_photos_of_other_exposure_are_brought_to_one():
    seen_by = cameras(8)
    gains = np.array([0.8, 1.0, 1.2, 0.9, 1.1, 1.0, 0.85, 1.15])
    background = background_plate(
        ground_views(pictures(seen_by, gains=gains)[0], seen_by, half_width_mm=HALF_MM)
    )
    away = truth()[1] < 50
    spread = background.bright.astype(float) - background.dim
    assert np.quantile(spread[away], 0.95) < 6.0  # 40 % of 120 grey levels apart as they come
    colours = truth()[0][away]
    ratio = background.colours[away].astype(float) / colours
    assert ratio.std() < 0.03


def test_a_cell_that_fewer_than_three_photos_show_is_not_known():
    seen_by = cameras(FEWEST_VIEWS)
    images, covers = pictures(seen_by)
    views = ground_views(images, seen_by, half_width_mm=HALF_MM)
    inner = truth()[1] < 30
    assert background_plate(views, covers).known[inner].all()
    covers[0][:] = True
    assert not background_plate(views, covers).known.any()


@pytest.mark.parametrize("shrink", [1, 3])
def test_the_plate_looks_from_a_camera_as_its_photo_does(shrink):
    seen_by = cameras(7)
    images, _ = pictures(seen_by)
    background = background_plate(ground_views(images, seen_by, half_width_mm=HALF_MM))
    corner, size = (100, 60), (120 // shrink, 120 // shrink)
    (seen,), known = background_in_view(
        background, seen_by[2], [background.colours], corner_px=corner, size_px=size, shrink=shrink
    )
    middle = (shrink - 1) // 2
    photo = images[2][corner[1] + middle :: shrink, corner[0] + middle :: shrink][: size[1], : size[0]]
    assert known.mean() > 0.8
    assert np.quantile(np.abs(seen.astype(float) - photo)[known], 0.98) < 3.0
