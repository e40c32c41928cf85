"""Pads are found on the fruit's surface, and pads that are not there are refused."""

from dataclasses import replace

import numpy as np
import pytest
from injected_grasp import RADIUS_MM, elsewhere, injected_grasp
from scipy.spatial import ConvexHull

from tactile.contact import find_contact
from tactile.registration import register
from tactile.tactile_failure import TactileFailure, TactileProblem


def sphere(radius_mm: float, points: int = 6000):
    k = np.arange(points) + 0.5
    height, turn = 1 - 2 * k / points, np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - height**2)
    unit = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    faces = ConvexHull(unit).simplices.astype(np.int64)
    a, b, c = np.moveaxis(unit[faces], 1, 0)
    inward = np.einsum("fx,fx->f", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, ::-1]
    return radius_mm * unit, faces


@pytest.fixture(scope="module")
def contact(injected):
    return find_contact(injected.recording, source="injected.h5")


@pytest.fixture(scope="module")
def ball():
    return sphere(RADIUS_MM)


def test_markers_sit_on_the_mesh_where_they_touched(contact, ball):
    for pad, place in zip(contact.pads, register(contact, *ball, source="x"), strict=True):
        touched = pad.onset >= 0
        assert np.linalg.norm(place.surface_mm[touched], axis=1) == pytest.approx(RADIUS_MM, abs=0.03)
        across = place.surface_mm[touched] - pad.position_mm[0, touched]
        across -= np.outer(across @ place.normal, place.normal)
        assert np.abs(across).max() < 0.03


def test_what_lies_beside_a_small_fruit_is_not_on_its_skin(contact, ball):
    vertices, faces = ball
    normal = contact.pads[0].pose[0, :3, 2]
    off_axis = np.linalg.norm(vertices - np.outer(vertices @ normal, normal), axis=1)
    rim = 6.0
    cap = faces[(off_axis[faces] < rim).all(axis=1)]
    place = register(contact, vertices, cap, source="x")[0]
    position = contact.pads[0].position_mm[0]
    across = np.linalg.norm(position - np.outer(position @ normal, normal), axis=1)
    assert place.on_skin[across < rim - 1].all()
    assert not place.on_skin[across > rim].any()
    assert (across > rim).any()


def test_first_touches_lie_within_what_the_ball_gave_way(contact, ball):
    # Half of a frame's step and half of the sagitta have gone into the ball before a marker is seen to touch.
    for place in register(contact, *ball, source="x"):
        assert abs(place.shift_mm) < 0.4
        assert place.residual_mm < 0.2


def test_a_pose_error_along_the_normal_is_the_shift(injected, contact, ball):
    before = register(contact, *ball, source="x")
    pads = []
    for pad in injected.recording.pads:
        pose = pad.pose.copy()
        pose[:, :3, 3] -= 0.8 * pose[:, :3, 2]
        pads.append(replace(pad, pose=pose))
    after = register(
        find_contact(replace(injected.recording, pads=tuple(pads)), source="x"), *ball, source="x"
    )
    for a, b in zip(before, after, strict=True):
        assert b.shift_mm - a.shift_mm == pytest.approx(0.8, abs=1e-6)
        np.testing.assert_allclose(a.surface_mm, b.surface_mm, atol=1e-6)
        assert b.residual_mm == pytest.approx(a.residual_mm, abs=1e-6)


def test_places_move_with_the_fruit_frame(injected, contact, ball):
    turned, motion = elsewhere(injected.recording)
    vertices = ball[0] @ motion[:3, :3].T + motion[:3, 3]
    moved = register(find_contact(turned, source="x"), vertices, ball[1], source="x")
    for a, b in zip(register(contact, *ball, source="x"), moved, strict=True):
        np.testing.assert_allclose(a.surface_mm @ motion[:3, :3].T + motion[:3, 3], b.surface_mm, atol=1e-6)


@pytest.mark.parametrize("shift", [[0, 0, 60.0], [200.0, 0, 0], [0, -30.0, 0]])
def test_a_fruit_elsewhere_is_refused(contact, ball, shift):
    with pytest.raises(
        TactileFailure, match=r"^g\.h5: pads/(left|right)/pose: found first touches"
    ) as caught:
        register(contact, ball[0] + np.array(shift), ball[1], source="g.h5")
    assert caught.value.problem is TactileProblem.PADS_OFF_FRUIT


def test_a_mesh_in_metres_is_refused(contact, ball):
    with pytest.raises(TactileFailure, match="units"):
        register(contact, ball[0] / 1000, ball[1], source="g.h5")


def test_a_far_wall_of_the_mesh_is_not_taken_for_the_near_one(ball):
    contact = find_contact(injected_grasp(np.random.default_rng(5)).recording, source="x")
    for side, place in zip((-1, 1), register(contact, *ball, source="x"), strict=True):
        assert (side * place.surface_mm[:, 0] > 0).all()
