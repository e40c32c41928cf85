"""Poses from a mat: injected cameras come back, bad sets are refused with their reason."""

import numpy as np
import pytest
from mat_scene import Egg, photographed, ring
from refusals import refused

from recon.cameras.mat_poses import cameras_from_mat
from recon.cameras.photos import Photo
from recon.cameras.printed_mat import standard_mat
from recon.recon_failure import ReconFailure, ReconProblem


@pytest.fixture(scope="module")
def bent():
    cameras = ring(7, width=640, height=480, k1=-0.06)
    return cameras, photographed(cameras, egg=Egg(), mat=standard_mat())


@pytest.fixture(scope="module")
def poses(bent):
    return cameras_from_mat(bent[1], standard_mat())


def test_cameras_come_back_without_exif_within_their_error_bars(bent, poses):
    cameras, _ = bent
    assert len(poses.cameras) == len(cameras)
    assert poses.cameras[0].focal_px == pytest.approx(cameras[0].focal_px, rel=3e-3)
    assert poses.cameras[0].k1 == pytest.approx(-0.06, abs=0.02)
    for camera, true in zip(poses.cameras, cameras, strict=True):
        assert np.linalg.norm(camera.place - true.place) < 1.0
    assert poses.reprojection_px < 0.5
    assert abs(poses.cameras[0].focal_px - cameras[0].focal_px) < 4 * poses.focal_sd_px
    assert 1e-3 < poses.scale_sd < 2e-3


def test_a_misread_tag_moves_no_camera_and_is_left_out():
    """Exact corners but for one tag that the photo shows 60 px away."""
    mat = standard_mat()
    cameras = ring(7, width=640, height=480, k1=-0.06)
    photos = []
    for camera in cameras:
        seen = {tag: camera.project(corners) for tag, corners in mat.corners_mm.items()}
        inside = {t: px for t, px in seen.items() if (px > 0).all() and (px < [640, 480]).all()}
        photos.append(
            Photo(
                camera.name,
                np.zeros((480, 640, 3), np.uint8),
                tags=(np.array([*inside]), np.array([*inside.values()])),
            )
        )
    photos[2].tags[1][0] += 60.0
    poses = cameras_from_mat(photos, mat)
    assert poses.cameras[0].focal_px == pytest.approx(cameras[0].focal_px, rel=1e-4)
    assert poses.cameras[0].k1 == pytest.approx(-0.06, abs=1e-3)
    for recovered_camera, true in zip(poses.cameras, cameras, strict=True):
        assert np.linalg.norm(recovered_camera.place - true.place) < 0.05
    assert poses.reprojection_px < 0.02


def test_two_photos_with_tags_are_too_few_and_without_tags_the_mat_is_not_found(bent):
    _, photos = bent
    grey = [Photo(f"g{i}.png", np.full((480, 640, 3), 90, np.uint8)) for i in range(4)]
    with refused(ReconProblem.TOO_FEW_VIEWS, r"Only 2 of 6 photos show at least 4 tags"):
        cameras_from_mat([*photos[:2], *grey], standard_mat())
    with refused(ReconProblem.MAT_NOT_FOUND, r"No marker of the mat .* in any of 4 photos"):
        cameras_from_mat(grey, standard_mat())


def test_photos_of_another_size_are_left_out_with_a_warning(bent):
    _, photos = bent
    first_cut = Photo(photos[0].name, np.ascontiguousarray(photos[0].image[8:-8]))
    poses = cameras_from_mat([first_cut, *photos[1:5]], standard_mat())
    assert poses.used.tolist() == [1, 2, 3, 4]
    assert poses.warnings[0].startswith(
        "1 of 5 photos of the mat do not have the usual size of 640 x 480 pixels"
    )


def test_a_mat_of_another_layout_is_refused(bent):
    _, photos = bent
    shuffled = standard_mat()
    other = dict(zip(shuffled.corners_mm, reversed(list(shuffled.corners_mm.values())), strict=True))
    wrong = type(shuffled)(shuffled.dictionary, other, shuffled.width_mm, shuffled.height_mm)
    mirrored = [Photo(p.name, np.ascontiguousarray(p.image[:, ::-1])) for p in photos]
    with pytest.raises(ReconFailure):
        cameras_from_mat(mirrored, wrong)
