"""Sides and heights that photos of a mat leave out are told by the tags, whose corners are projected."""

import re

import numpy as np
import pytest
from level_camera import camera_at, direction
from refusals import refused

from recon.cameras.photos import Photo
from recon.cameras.printed_mat import standard_mat
from recon.checks.view_check import view_doubts
from recon.recon_failure import ReconProblem

MAT = standard_mat()


def photos(azimuths_deg, elevations_deg):
    """Photos with nothing but their tags, taken from 300 mm away."""
    blank = np.zeros((960, 1280, 3), np.uint8)
    tags = np.array(list(MAT.corners_mm))
    noise = np.random.default_rng(3)
    made = []
    for k, (azimuth, elevation) in enumerate(np.broadcast(azimuths_deg, elevations_deg)):
        how = {"size_px": (1280, 960), "focal_px": 1400.0, "name": f"{k:03d}.jpg"}
        camera = camera_at(300.0 * direction(azimuth, elevation), np.zeros(3), **how)
        corners = np.stack([camera.project(MAT.corners_mm[tag]) for tag in tags.tolist()])
        made.append(Photo(camera.name, blank, tags=(tags, corners + noise.normal(0, 0.2, corners.shape))))
    return made


def said(made, **options):
    return view_doubts(made, MAT, given=[photo.name for photo in made], height_mm=55.0, **options)


@pytest.mark.parametrize("count", [12, 24])
def test_photos_all_around_at_two_heights_leave_nothing_to_say(count):
    azimuth = np.arange(count) * 360 / count
    assert said(photos(azimuth, np.where(np.arange(count) % 2, 25.0, 55.0))) == ()


@pytest.mark.parametrize(("start", "end", "stand"), [(0, 90, "45"), (0, 108, "36, 72")])
def test_a_side_without_a_photo_is_named_with_where_to_stand(start, end, stand):
    azimuth = np.linspace(end, 360 + start, 20)
    (sentence,) = said(photos(azimuth[::-1], np.tile([25.0, 50.0], 10)))
    assert f"There is a gap of {end - start} degrees without photos around the fruit" in sentence
    assert re.search(rf"between 0 and {end} degrees, counted from 000\.jpg", sentence)
    assert f"take photos at {stand} degrees" in sentence


def test_photos_of_one_half_are_refused_as_grading_refuses_them():
    with refused(ReconProblem.TOO_FEW_VIEWS, r"leave a gap of 180 degrees"):
        said(photos(np.linspace(0, 180, 16), np.tile([25.0, 50.0], 8)))


def test_photos_from_above_alone_leave_the_lower_part_unseen():
    """From the elevation e, at a distance, a ball is seen down to the latitude e - 90 degrees, and all around
    as far as z = -cos(e): at 70 degrees (1 + cos 70) / 2 = 67 % of it.
    """
    (sentence,) = said(photos(np.arange(16) * 22.5, 70.0))
    share = int(re.search(r"Only (\d+) % of the surface", sentence)[1])
    assert abs(share - 67) <= 8
    assert "take photos from more heights" in sentence
