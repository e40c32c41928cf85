"""Markers are found where the pictures have them, to a few hundredths of a pixel."""

import numpy as np
import pytest
from drawn_gel import PITCH_PX, RADIUS_PX, drawn, grid
from scipy.spatial import cKDTree

from tactile.markers.marker_detection import Blobs, contrast, find_look, grey, markers_of, spacing_of
from tactile.markers.tracking import reference_of
from tactile.tactile_failure import TactileFailure, TactileProblem


def found_in(picture: np.ndarray) -> Blobs:
    intensity = grey(picture)
    look = find_look(intensity)
    return markers_of(contrast(intensity, look), look)


@pytest.mark.parametrize("dark", [True, False])
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_every_marker_is_found_to_a_few_hundredths_of_a_pixel(dark: bool, noise: float) -> None:
    markers = found_in(drawn(grid(), dark=dark, noise=noise))
    away, which = cKDTree(markers.centre_px).query(grid())
    assert len(markers.peak) == len(grid())
    assert len(set(which.tolist())) == len(grid())
    assert np.sqrt((away**2).mean()) < 0.04
    assert away.max() < 0.1


@pytest.mark.parametrize("dark", [True, False])
def test_size_and_darkness_are_read_from_the_picture(dark: bool) -> None:
    look = find_look(grey(drawn(grid(), dark=dark, noise=2.0)))
    assert look.dark is dark
    assert 0.7 * RADIUS_PX < look.radius_px < 1.4 * RADIUS_PX


def test_uneven_light_moves_no_marker() -> None:
    level, tilted = found_in(drawn(grid(), tilt=0.0)), found_in(drawn(grid(), tilt=0.8, light=0.6))
    away = cKDTree(level.centre_px).query(tilted.centre_px)[0]
    assert len(level.peak) == len(tilted.peak) == len(grid())
    assert away.max() < 0.08


def test_a_large_shade_is_no_marker() -> None:
    picture = drawn(grid()).astype(float)
    rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]]
    picture *= 1 - 0.4 * np.exp(-((columns - 200) ** 2 + (rows - 120) ** 2) / 2 / 35**2)[..., None]
    assert len(found_in(picture.astype(np.uint8)).peak) == len(grid())


def test_a_speck_and_a_glint_are_no_markers() -> None:
    picture = drawn(grid())
    picture[72:74, 82:84] = 20
    picture[88:90, 127:129] = 255  # inside a marker
    assert len(found_in(picture).peak) == len(grid())


def test_spacing_is_the_grids() -> None:
    assert spacing_of(grid()) == pytest.approx(PITCH_PX)


def test_a_picture_without_markers_is_refused() -> None:
    noise = np.random.default_rng(1).normal(120, 2, (240, 320, 3)).clip(0, 255).astype(np.uint8)
    with pytest.raises(
        TactileFailure, match=r"reference\.png: found \d markers, expected at least 9"
    ) as caught:
        reference_of(noise, source="reference.png")
    assert caught.value.problem is TactileProblem.NO_MARKERS
