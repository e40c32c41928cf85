"""Coverage against closed forms: a far camera faces half a ball, and two opposite ones leave a belt."""

import numpy as np
import pytest

from recon.silhouettes.hull import ball
from recon.surface.ray_mesh import seeing_views, seen_and_unseen

RADIUS = 10.0
FAR = 1e6


def test_a_far_camera_faces_half_a_ball_and_a_near_one_less():
    directions, faces = ball(5)
    vertices = RADIUS * directions
    far = seeing_views(vertices, faces, np.array([[0.0, 0.0, FAR]]))
    near = seeing_views(vertices, faces, np.array([[0.0, 0.0, 2 * RADIUS]]))
    height = vertices[:, 2] / RADIUS
    assert ((far == 1) == (height > 0))[np.abs(height) > 0.02].all()
    assert ((near == 1) == (height > 0.5))[np.abs(height - 0.5) > 0.02].all()


def test_what_two_cameras_see_together_is_a_lune_and_the_rest_is_the_hole():
    directions, faces = ball(5)
    vertices = RADIUS * directions
    across = np.array([[FAR, 0.0, 0.0], [0.0, FAR, 0.0]])
    share, hole = seen_and_unseen(vertices, faces, seeing_views(vertices, faces, across))
    assert share == pytest.approx(0.25, abs=0.008)  # a lune of 90 degrees; its rim is cut by triangles
    assert hole == pytest.approx(0.75 * 4 * np.pi * RADIUS**2, rel=0.012)
