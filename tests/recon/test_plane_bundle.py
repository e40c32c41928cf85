"""Bundle adjustment on the ground plane: injected cameras come back, the focal length's error bar holds."""

from dataclasses import replace

import numpy as np
import pytest
from level_camera import looking_at_the_origin

from recon.cameras.camera import pinhole, place_of
from recon.cameras.plane_bundle import PlaneScene, Sightings, adjusted, projected
from recon.cameras.plane_start import start_cameras

SIZE = (720, 960)
FOCAL_PX = 1100.0
K = pinhole(FOCAL_PX, SIZE)


def apart(places):
    """Distances between all places."""
    return np.linalg.norm(places[:, None] - places, axis=2)


def similar(places, true):
    """Places at the scale of the true ones."""
    return places * apart(true).sum() / apart(places).sum()


def homographies_from_first(poses):
    ground = [K @ p[:3][:, [0, 1, 3]] for p in poses]
    homographies = [g @ np.linalg.inv(ground[0]) for g in ground]
    return {i: h / h[2, 2] for i, h in enumerate(homographies)}


@pytest.mark.parametrize("nearest", [300.0, 160.0])
@pytest.mark.parametrize("known_focal_px", [FOCAL_PX, None])
def test_exact_homographies_give_focal_length_and_poses_up_to_a_similarity(nearest, known_focal_px):
    """The ground straight below the first camera lies behind the nearest one: no exception."""
    distances = np.array([400.0, 380, 420, 350, 390, nearest])
    poses = [
        looking_at_the_origin(azimuth, elevation, d)
        for azimuth, elevation, d in zip(
            (0, 55, 130, 190, 260, 4), (31, 40, 28, 52, 35, 22), distances, strict=True
        )
    ]
    focal_px, cameras = start_cameras(homographies_from_first(poses), SIZE, known_focal_px)
    assert focal_px == pytest.approx(FOCAL_PX, rel=0.02)
    true, places = np.array([*map(place_of, poses)]), [place_of(cameras[i]) for i in range(len(poses))]
    scaled = similar(np.array(places), true)
    assert (scaled[:, 2] > 0).all()
    assert np.allclose(apart(scaled), apart(true), rtol=0.03, atol=8.0)
    assert np.allclose(scaled[:, 2], true[:, 2], rtol=0.03)


MIDDLE = np.array([(SIZE[1] - 1) / 2, (SIZE[0] - 1) / 2])
K1 = -0.03
VIEWS, POINTS = 8, 120


def injected(rng, *, noise_px, breathing=0.0):
    poses = np.stack(
        [looking_at_the_origin(45.0 * k, 25 + 5 * (k % 3), 3.0 + 0.1 * (k % 2)) for k in range(VIEWS)]
    )
    focals_px = FOCAL_PX * np.exp(breathing * rng.normal(size=VIEWS))
    scene = PlaneScene(poses, focals_px, K1, rng.uniform(-0.8, 0.8, (POINTS, 2)))
    view, point = (g.ravel() for g in np.meshgrid(np.arange(VIEWS), np.arange(POINTS)))
    places = projected(scene, view, scene.ground[point], MIDDLE) + noise_px * rng.normal(size=(len(view), 2))
    return scene, Sightings(view, point, places, np.tile(np.eye(2), (len(view), 1, 1)))


def disturbed(scene, rng):
    poses = scene.poses.copy()
    poses[:, :3, 3] += 0.03 * rng.normal(size=(VIEWS, 3))
    ground = scene.ground + 0.01 * rng.normal(size=scene.ground.shape)
    return replace(scene, poses=poses, focals_px=np.full(VIEWS, 1.03 * FOCAL_PX), k1=0.0, ground=ground)


def test_exact_sightings_give_the_injected_cameras_back():
    rng = np.random.default_rng(1)
    scene, seen = injected(rng, noise_px=0.0)
    adjustment = adjusted(disturbed(scene, rng), seen, SIZE, focal_prior=(np.log(FOCAL_PX), 0.6))
    assert np.median(adjustment.miss_px) < 0.05
    assert adjustment.scene.focals_px == pytest.approx(scene.focals_px, rel=2e-3)
    assert adjustment.scene.k1 == pytest.approx(K1, abs=3e-3)
    places, true = (np.array([*map(place_of, s.poses)]) for s in (adjustment.scene, scene))
    assert np.allclose(apart(similar(places, true)), apart(true), atol=0.005)


@pytest.mark.parametrize("noise_px", [0.1, 0.5])
def test_the_focal_lengths_error_bar_is_as_wide_as_its_errors(noise_px):
    errors = []
    for draw in range(16):
        rng = np.random.default_rng([draw, 7])
        scene, seen = injected(rng, noise_px=noise_px, breathing=0.002)
        adjustment = adjusted(
            disturbed(scene, rng), seen, SIZE, focal_prior=(np.log(FOCAL_PX) + 0.03 * rng.normal(), 0.03)
        )
        off = np.mean(np.log(adjustment.scene.focals_px)) - np.log(FOCAL_PX)
        errors.append(off / adjustment.focal_sd)
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 1.7
