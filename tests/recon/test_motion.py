"""Cameras without a mat: the first photo says where x is, or nothing does."""

import signal
import subprocess
import sys

import cv2
import numpy as np
import pytest
from mat_scene import Egg, photographed, ring
from refusals import refused

from recon.cameras import motion
from recon.cameras.ground_plane import upright
from recon.cameras.motion import cameras_from_features, cameras_from_motion
from recon.cameras.photos import Photo
from recon.cameras.plane_motion import placed
from recon.cameras.printed_mat import standard_mat
from recon.learned.fruit_model import SHIPPED, FruitModel
from recon.recon_failure import ReconProblem


@pytest.fixture(scope="module")
def photos():
    return photographed(ring(9), egg=Egg(), mat=standard_mat())


@pytest.mark.slow
def test_x_points_to_where_the_first_photo_was_taken(photos):
    poses = cameras_from_motion(photos, height_mm=48.0)
    x, y, z = poses.cameras[0].place
    assert x > 0
    assert z > 0
    assert abs(np.degrees(np.arctan2(y, x))) < 3


@pytest.mark.proof
def test_a_first_photo_that_cannot_be_placed_is_refused(photos):
    noise = np.random.default_rng(2).integers(0, 255, photos[0].image.shape, dtype=np.uint8)
    with refused(ReconProblem.NO_OVERLAP, r"first photo \(front\.png\) shares too few .* retake"):
        cameras_from_motion([Photo("front.png", noise), *photos], height_mm=48.0)


def test_without_pycolmap_photos_that_the_ground_does_not_join_name_it_and_what_to_do(monkeypatch):
    monkeypatch.setattr(motion, "pycolmap", None)
    blank = [Photo(f"{i}.png", np.full((120, 160, 3), 90, np.uint8)) for i in range(4)]
    with refused(ReconProblem.MISSING_LIBRARY, r"needs pycolmap.*on the mat \(drupe mat\).*fruit\.ply"):
        cameras_from_motion(blank, height_mm=48.0)


def test_photos_with_common_features_but_one_viewpoint_are_refused_for_their_camera_poses():
    pytest.importorskip("pycolmap")
    rng = np.random.default_rng(0)
    cloth = cv2.GaussianBlur(rng.uniform(0, 255, (480, 640, 3)), (0, 0), 3)
    cloth = cv2.normalize(cloth, None, 0, 255, cv2.NORM_MINMAX)
    noisy = [np.clip(cloth + rng.normal(0, 2, cloth.shape), 0, 255).astype(np.uint8) for _ in range(4)]
    with refused(ReconProblem.NO_OVERLAP, "Features of the photos give camera poses for only 0 of 4 photos"):
        cameras_from_features([Photo(f"{i}.png", image) for i, image in enumerate(noisy)], height_mm=48.0)


class Redness:
    """Log odds of red pixels, as a fruit model's session gives them."""

    def run(self, names, feeds):
        return [np.clip(2000 * (feeds["images"][:, :1] - 154 / 255), -6, 6)]


def test_fruit_of_the_colour_of_its_ground_is_placed_with_the_fruit_model():
    """Skin and ground differ by less than ground may differ from its plate."""
    egg, cameras = Egg(x_mm=12.0, y_mm=-9.0), ring(9, width=240, height=180)
    v, u = np.mgrid[:180, :240]
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    photos = []
    for camera in cameras:
        covered = egg.covers(camera, pixels).reshape(180, 240, 1)
        image = np.where(covered, np.array([90, 112, 158]), np.array([90, 120, 150])).astype(np.uint8)
        photos.append(Photo(camera.name, image))
    with refused(ReconProblem.NO_FRUIT, "drupe found no fruit"):
        placed(photos, cameras, 48.0)
    world, (_, high_mm) = placed(photos, cameras, 48.0, FruitModel(SHIPPED, Redness()))
    middle = world[:3, :3] @ egg.centre + world[:3, 3]
    assert (np.abs(middle[:2]) + egg.semi_mm[:2] < high_mm[:2]).all()
    assert middle[2] == pytest.approx(egg.centre[2], rel=0.1)


def test_a_first_photo_from_straight_above_is_refused():
    up, foot = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    with refused(ReconProblem.NO_OVERLAP, "looks straight down on the fruit"):
        upright(up, foot, np.array([10.0, 0.0, 200.0]))
    assert np.allclose(upright(up, foot, np.array([0.0, 50.0, 50.0]))[0, :3], [0, 1, 0])


ENDS_ITSELF = "import os, signal, recon.cameras.motion; os.kill(os.getpid(), signal.SIGTERM)"


def test_a_process_told_to_end_prints_no_stack() -> None:
    done = subprocess.run([sys.executable, "-c", ENDS_ITSELF], capture_output=True, text=True, timeout=120)
    assert done.returncode == -signal.SIGTERM
    assert "SIGTERM" not in done.stderr
    assert "stack trace" not in done.stderr
