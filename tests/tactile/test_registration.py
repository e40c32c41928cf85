"""Pads are found on the fruit's surface, and pads that are not there are refused."""

from dataclasses import replace

import numpy as np
import pytest
from injected_grasp import RADIUS_MM, ball, elsewhere, with_pads
from scipy.spatial import ConvexHull

from tactile.contact import find_contact
from tactile.registration import register
from tactile.tactile_failure import TactileFailure, TactileProblem


@pytest.fixture(scope="module")
def fruit():
    """Vertices and faces of a ball, faces outward."""
    vertices = ball(RADIUS_MM)
    faces = ConvexHull(vertices).simplices.astype(np.int64)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    inward = np.einsum("fx,fx->f", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces


def test_markers_sit_on_the_mesh_where_they_touched(contact, fruit):
    for pad, place in zip(contact.pads, register(contact, *fruit, source="x"), strict=True):
        touched = pad.onset >= 0
        assert np.linalg.norm(place.surface_mm[touched], axis=1) == pytest.approx(RADIUS_MM, abs=0.03)
        across = place.surface_mm[touched] - pad.position_mm[0, touched]
        across -= np.outer(across @ place.normal, place.normal)
        assert np.abs(across).max() < 0.03


def test_what_lies_beside_a_small_fruit_is_not_on_its_skin(contact, fruit):
    vertices, faces = fruit
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


def test_first_touches_lie_within_what_the_ball_gave_way(contact, fruit):
    # Half of a frame's step and half of the sagitta have gone into the ball before a marker is seen to touch.
    for place in register(contact, *fruit, source="x"):
        assert abs(place.shift_mm) < 0.4
        assert place.residual_mm < 0.2


def test_a_pose_error_along_the_normal_is_the_shift(injected, contact, fruit):
    before = register(contact, *fruit, source="x")

    def drawn_back(pad):
        pose = pad.pose.copy()
        pose[:, :3, 3] -= 0.8 * pose[:, :3, 2]
        return replace(pad, pose=pose)

    wrong = with_pads(injected.recording, drawn_back)
    after = register(find_contact(wrong, source="x"), *fruit, source="x")
    for a, b in zip(before, after, strict=True):
        assert b.shift_mm - a.shift_mm == pytest.approx(0.8, abs=1e-6)
        np.testing.assert_allclose(a.surface_mm, b.surface_mm, atol=1e-6)
        assert b.residual_mm == pytest.approx(a.residual_mm, abs=1e-6)


def test_places_move_with_the_fruit_frame(injected, contact, fruit):
    turned, motion = elsewhere(injected.recording)
    vertices = fruit[0] @ motion[:3, :3].T + motion[:3, 3]
    moved = register(find_contact(turned, source="x"), vertices, fruit[1], source="x")
    for a, b in zip(register(contact, *fruit, source="x"), moved, strict=True):
        np.testing.assert_allclose(a.surface_mm @ motion[:3, :3].T + motion[:3, 3], b.surface_mm, atol=1e-6)


@pytest.mark.parametrize(
    ("shift", "times"), [([0, 0, 60.0], 1.0), ([200.0, 0, 0], 1.0), ([0, -30.0, 0], 1.0), (0.0, 1e-3)]
)
def test_a_fruit_elsewhere_or_in_metres_is_refused(contact, fruit, shift, times):
    said = r"^g\.h5: pads/(left|right)/pose: found first touches .* the units \(mm\)"
    with pytest.raises(TactileFailure, match=said) as caught:
        register(contact, times * fruit[0] + np.array(shift), fruit[1], source="g.h5")
    assert caught.value.problem is TactileProblem.PADS_OFF_FRUIT
