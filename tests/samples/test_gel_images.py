"""Pictures of a gel, its press, and sensors drawn wide."""

import cv2
import numpy as np
import pytest

from samples.gel_images import GelLight, GelLook, gel_image, seen_at, seen_material
from samples.gel_press import BallPose, GelBlock, gel_block, pressed
from samples.mismatch.drawn_fruit import CATEGORIES, drawn_fruit, seen_anew, seen_by_drawn_sensor
from samples.mismatch.marker_sensor import drawn_sensor
from samples.sample_failure import NotInEquilibrium
from tactile.readers.sensor_model import model_named
from tactile.sensors import GelCamera, marker_grid


def eye(lens: tuple[float, float, float, float, float] = (-0.12, 0.03, 0.001, -0.001, 0.0)) -> GelCamera:
    pose = np.eye(4)
    pose[:3, 3] = 0.2, -0.1, -22.0
    return GelCamera(
        image_px=(320, 240),
        focal_px=(390.0, 392.0),
        centre_px=(161.0, 118.0),
        distortion=lens,
        gel_from_camera=pose,
    )


def dent(at: np.ndarray) -> np.ndarray:
    depth = np.exp(-(at**2).sum(axis=1) / 8)
    return np.stack([0.1 * depth * at[:, 0], 0.2 * depth, -0.6 * depth], axis=1)


def test_projection_is_opencvs() -> None:
    points = np.random.default_rng(0).uniform([-6, -4, -1], [6, 4, 0.5], (40, 3))
    camera = eye()
    moved = points - camera.gel_from_camera[:3, 3]
    expected = cv2.projectPoints(moved, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    np.testing.assert_allclose(seen_at(camera, points), expected[0][:, 0], atol=1e-9)


def test_the_material_a_pixel_shows_projects_back_onto_it() -> None:
    pixels = np.random.default_rng(1).uniform([0, 0], [319, 239], (200, 2))
    material = seen_material(eye(), pixels, dent)
    place = np.column_stack([material, np.zeros(200)]) + dent(material)
    np.testing.assert_allclose(seen_at(eye(), place), pixels, atol=2e-3)


def test_dots_are_drawn_where_their_markers_project() -> None:
    look = GelLook(rest_mm=marker_grid(5, 7, pitch_mm=(1.7, 1.7), first_mm=None), dot_mm=0.5, noise=0.0)
    image = gel_image(eye(), (), look, dent, np.random.default_rng(2)).astype(float).mean(axis=2)
    gel = 255 * 0.6
    for place in look.rest_mm + dent(look.rest_mm[:, :2]):
        at = seen_at(eye(), place[None])[0]
        x, y = np.rint(at).astype(int)
        rows, columns = np.mgrid[y - 8 : y + 9, x - 8 : x + 9]
        weight = np.maximum(gel * 0.7 - image[y - 8 : y + 9, x - 8 : x + 9], 0)
        centre = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
        np.testing.assert_allclose(centre, at, atol=0.15)


def test_a_tilted_face_is_lit_by_lamberts_cosine() -> None:
    slope = 0.2
    light = GelLight(direction=np.array([0.6, 0.0, -0.8]), colour=np.array([1.0, 0.5, 0.25]))
    look = GelLook(
        rest_mm=np.full((1, 3), 50.0), gel=(0.5, 0.5, 0.5), ambient=0.1, vignette=0.0, noise=0.0, blur_px=0.1
    )
    tilted = gel_image(
        eye(), (light,), look, lambda at: np.outer(at[:, 0], [0, 0, slope]), np.random.default_rng(3)
    )
    inward = np.array([slope, 0, -1]) / np.hypot(slope, 1)
    expected = 255 * 0.5 * (0.1 + (inward @ light.direction) * light.colour)
    np.testing.assert_allclose(tilted[120, 160], expected, atol=0.6)


SIDES = (-6, -3.5, -2.4, -1.6, -0.8, 0, 0.8, 1.6, 2.4, 3.5, 6)
RADIUS, FRICTION = 6.0, 0.4


@pytest.fixture(scope="module")
def block() -> GelBlock:
    return gel_block(
        thickness_mm=2.5, E_MPa=0.2, nu=0.4, reach_mm=2.3, x_mm=SIDES, y_mm=SIDES, depths=(0, 0.35, 1)
    )


def down(depth_mm: float) -> BallPose:
    return BallPose(centre_mm=(0.0, 0.0, RADIUS - depth_mm))


def test_loads_and_displacements_are_reciprocal(block: GelBlock) -> None:
    small = block.compliance[(3 * block.reach[:, None] + np.arange(3)).ravel()]
    np.testing.assert_allclose(small, small.T, atol=1e-9 * np.abs(small).max())


def test_a_ball_is_pushed_out_and_grips_within_coulombs_cone(block: GelBlock) -> None:
    aside = [BallPose(centre_mm=(0.1 * k, 0.0, RADIUS - 0.25)) for k in range(1, 6)]
    path = [down(-0.1), *[down(d) for d in (0.05, 0.1, 0.15, 0.2, 0.25)], *aside]
    moments = pressed(block, path, radius_mm=RADIUS, friction=FRICTION)
    assert not moments[0].force_N.any()
    totals = np.stack([m.force_N.sum(axis=0) for m in moments])
    assert (np.diff(totals[:6, 2]) > 0).all()
    np.testing.assert_allclose(totals[:6, :2], 0.0, atol=1e-6)  # straight down: no side force
    assert totals[-1, 0] == pytest.approx(-FRICTION * totals[-1, 2], rel=0.1)  # dragged until all of it slips
    last, centre = moments[-1], np.array([0.5, 0.0, RADIUS - 0.25])
    touching = last.force_N.any(axis=1)
    place = np.column_stack([block.face_mm, np.zeros(len(block.face_mm))]) + last.displacement_mm
    arm = (place - centre)[touching]
    inward = -arm / np.linalg.norm(arm, axis=1, keepdims=True)
    push = (last.force_N[touching] * inward).sum(axis=1)
    drag = np.linalg.norm(last.force_N[touching] - push[:, None] * inward, axis=1)
    assert (push > 0).all()
    assert (drag <= FRICTION * push * (1 + 1e-6)).all()
    # what touches lies on the ball but for the contact's own stiffness
    np.testing.assert_allclose(np.linalg.norm(arm, axis=1), RADIUS, atol=0.01)


def test_a_contact_past_the_reach_is_refused(block: GelBlock) -> None:
    with pytest.raises(NotInEquilibrium, match="grew past"):
        pressed(block, [down(-0.1), down(0.3), down(0.7), down(1.0)], radius_mm=RADIUS, friction=FRICTION)


def test_drawn_sensors_stay_in_their_ranges_and_cover_the_contact() -> None:
    rng = np.random.default_rng(0)
    drawn = [drawn_sensor(rng, contact_mm=8.0) for _ in range(200)]
    kn = np.array([s.gel.kn_MPa_per_mm for s in drawn])
    ratio = np.array([s.gel.kt_MPa_per_mm for s in drawn]) / kn
    assert 0.1 <= kn.min() < 0.12
    assert 0.42 < kn.max() <= 0.5
    assert ratio.min() >= 0.2
    assert ratio.max() <= 0.35
    assert all(14 <= s.markers <= 22 and 0.8 <= s.pitch_mm <= 1.3 for s in drawn)
    assert all(s.half_width_mm > 8.0 for s in drawn)
    assert len({s.markers for s in drawn}) > 4
    assert {model_named(s.name) for s in drawn} == {None}, "their gels are not that of a sensor model"


def test_another_record_keeps_the_gel_and_changes_noise_scan_and_prior() -> None:
    rng = np.random.default_rng(1)
    first = seen_by_drawn_sensor(drawn_fruit("a", category=CATEGORIES[0], rng=rng), rng)
    again = seen_anew(first, rng)
    assert again.sensor.gel == first.sensor.gel
    assert again.sensor.pitch_mm == first.sensor.pitch_mm
    assert again.sensor.displacement_mm != first.sensor.displacement_mm
    assert again.mesh_error_mm != first.mesh_error_mm
    assert again.prior != first.prior
    assert again.fruit == first.fruit
