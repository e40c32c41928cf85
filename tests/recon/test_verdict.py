"""What came out is not always to be believed: guessed shapes are refused, odd ones doubted."""

import re
from dataclasses import replace

import manifold3d
import numpy as np
import pytest
from level_camera import camera_at, direction
from refusals import refused

from recon.cameras.photos import Photo
from recon.cameras.printed_mat import standard_mat
from recon.checks.quality import ReconQuality, require_seen, shape_doubts
from recon.checks.view_check import view_doubts
from recon.pit.priors import load_prior
from recon.recon_failure import ReconProblem
from recon.silhouettes.hull import ball
from samples.fruit import fruit_of_seed, scanned_mesh

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


SEEN = ReconQuality(views_given=24, views_used=20, widest_gap_deg=30.0)


@pytest.mark.parametrize(
    ("quality", "words"),
    [
        (replace(SEEN, views_used=5), "only 5 of 24 photos are usable"),
        (replace(SEEN, widest_gap_deg=150.0), "a gap of 150 degrees around"),
    ],
)
def test_a_guessed_shape_is_refused(quality, words):
    with refused(ReconProblem.TOO_FEW_VIEWS, f"Too few views: .*{words}"):
        require_seen(quality)


def test_no_sample_fruit_is_doubted():
    for seed in range(6):
        assert (
            shape_doubts(*scanned_mesh(fruit_of_seed("N", seed=seed, E_MPa=0.5), cells=24, error_mm=0.1))
            == ()
        )


@pytest.mark.parametrize("apart_mm", [40.0, 52.0])
def test_two_fruits_that_touch_are_doubted(apart_mm):
    directions, faces = ball(4)
    first, second = (
        manifold3d.Manifold(manifold3d.Mesh64(28 * directions + [x, 0, 28], faces.astype(np.uint64)))
        for x in (0.0, apart_mm)
    )
    both = (first + second).to_mesh64()
    doubts = shape_doubts(np.asarray(both.vert_properties)[:, :3], np.asarray(both.tri_verts, int))
    assert doubts
    assert all("The photos may show two fruits" in d for d in doubts)


def test_a_bar_and_a_cross_are_phantoms_and_no_fruit():
    bar = manifold3d.Manifold.cube([60.0, 15.0, 15.0], True)
    cross = bar + bar.rotate([0.0, 0.0, 90.0])
    for body, words in (
        (bar, "a ratio of 4.00 of length to width, expected at most 1.45"),
        (cross, "convex hull"),
    ):
        mesh = body.to_mesh64()
        surface = np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts, int)
        assert any(words in outlier_share for outlier_share in shape_doubts(*surface))
        assert shape_doubts(*surface, body=load_prior("phantom").body) == ()
