import re

import numpy as np
import pytest

from fem.elements.shape_functions import t6_shape
from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.closest_point import closest_on_triangles
from fem.mesh.surface_points import locate, skin_quadrature
from fem.solid.rigid_core import rigid_modes


@pytest.fixture(scope="module")
def scattered(nectarine):
    rng = np.random.default_rng(3)
    face = rng.integers(len(nectarine.outer_faces), size=500)
    weights = t6_shape(rng.dirichlet(np.ones(3), 500)[:, 1:])
    return np.einsum("pn,pnx->px", weights, nectarine.nodes_mm[nectarine.outer_faces[face]])


def test_points_of_the_curved_skin_are_found_where_they_are(nectarine, scattered):
    skin = locate(nectarine, scattered)
    assert skin.distance_mm.max() < 1e-9
    assert np.abs(skin.point_mm - scattered).max() < 1e-9


def test_points_above_the_skin_fall_on_its_foot(nectarine, scattered):
    foot = locate(nectarine, scattered)
    skin = locate(nectarine, foot.point_mm + 0.7 * foot.normal)
    assert np.abs(skin.distance_mm - 0.7).max() < 1e-2
    assert np.linalg.norm(skin.point_mm - foot.point_mm, axis=1).max() < 0.06


def test_a_quadratic_field_is_read_off_exactly_where_faces_are_flat(nectarine, scattered):
    skin = locate(nectarine, scattered)
    linear = nectarine.nodes_mm @ np.array([[1.0, 0.2, 0.0], [0.5, -1, 0.3], [0, 2, 1]]) + 4
    read = skin.sample(linear[None])[0]
    assert (
        np.abs(read - (scattered @ np.array([[1.0, 0.2, 0.0], [0.5, -1, 0.3], [0, 2, 1]]) + 4)).max() < 1e-9
    )
    assert np.allclose(skin.interpolation.sum(axis=1), 1, atol=1e-13)


def test_forces_spread_to_nodes_keep_total_force_and_moment(nectarine, scattered):
    skin = locate(nectarine, scattered + np.random.default_rng(0).normal(0, 0.2, scattered.shape))
    force = np.random.default_rng(1).normal(0, 0.1, (3, len(scattered), 3))
    nodal = skin.point_load(force)
    origin = np.zeros(3)
    wanted = np.einsum("pxk,fpx->fk", rigid_modes(skin.point_mm, centre_mm=origin), force)
    given = np.einsum("nxk,fnx->fk", rigid_modes(nectarine.nodes_mm, centre_mm=origin), nodal)
    assert np.abs(given - wanted).max() < 1e-9


def test_even_pressure_on_the_whole_skin_is_balanced(nectarine):
    points, area_mm2 = skin_quadrature(nectarine)
    load = points.point_load((-0.1 * area_mm2[:, None] * points.normal)[None])
    centre = nectarine.nodes_mm.mean(axis=0)
    resultant = np.einsum("nxk,nx->k", rigid_modes(nectarine.nodes_mm, centre_mm=centre), load[0])
    # the divergence theorem holds for force on any closed surface and for moment too
    assert np.abs(resultant).max() < 1e-9 * np.abs(load).sum()


def test_points_off_the_skin_are_refused(nectarine):
    with pytest.raises(
        FemFailure, match=r"1 of 2 contact points are more than 2 mm from the skin"
    ) as refused:
        locate(nectarine, np.array([[30.0, 0.5, 0.5], [40.0, 0, 0]]), within_mm=2.0)
    assert refused.value.problem is FemProblem.OFF_SURFACE
    assert re.search(r"the worst at \(40\.0, 0\.0, 0\.0\) mm, by (9|10)\.\d\d mm", str(refused.value))
    with pytest.raises(FemFailure, match="non-finite"):
        locate(nectarine, np.array([[np.nan, 0, 0]]))


def test_closest_points_are_found_among_triangles_of_all_sizes():
    # sizes over a factor of 200; from afar more triangles may be near than are looked up at first
    rng = np.random.default_rng(6)
    size = np.exp(rng.uniform(np.log(0.01), np.log(2), 400))
    corner = rng.uniform(-3, 3, (400, 1, 3)) + size[:, None, None] * rng.normal(size=(400, 3, 3))
    vertices, faces = corner.reshape(-1, 3), np.arange(1200).reshape(-1, 3)
    points = np.vstack([rng.uniform(-4, 4, (80, 3)), 30 * rng.normal(size=(40, 3))])
    closest = closest_on_triangles(points, vertices, faces)
    alone = [closest_on_triangles(points, vertices, face[None]).distance_mm for face in faces]
    assert closest.distance_mm == pytest.approx(np.min(alone, axis=0), abs=1e-12)
    assert (closest.face == np.argmin(alone, axis=0)).all()
