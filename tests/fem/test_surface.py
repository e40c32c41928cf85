"""Surfaces: their nearest points, and bad ones refused with what was found, where, and by how much."""

import re
from pathlib import Path

import numpy as np
import pytest
from fem_shapes import ball, box, cube_mesh
from small_batches import python

from fem.elements.shape_functions import t6_shape
from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.closed_surface import checked_surface, must_enclose, winding_number
from fem.mesh.closest_point import closest_on_triangles, enclosed_volume_mm3
from fem.mesh.flesh_mesh import _quadratic, tetrahedralise
from fem.mesh.surface_points import locate, skin_quadrature
from fem.mesh.tetrahedra import compact
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


FRUIT = ball(800, semi_axes_mm=(30, 30, 30))
PIT = ball(300, semi_axes_mm=(12, 9, 10))


def joined(*surfaces):
    start = np.cumsum([0, *(len(v) for v, _ in surfaces)])
    return np.vstack([v for v, _ in surfaces]), np.vstack(
        [f + at for (_, f), at in zip(surfaces, start, strict=False)]
    )


def refused(*surfaces):
    with pytest.raises(FemFailure) as failure:
        tetrahedralise(*surfaces, edge_mm=7.0)
    return failure.value


def numbers(text):
    return [float(x) for x in re.findall(r"-?\d+\.?\d*(?:e[+-]?\d+)?", text)]


def test_a_pit_that_pokes_out_is_named_with_place_and_amount():
    failure = refused(*FRUIT, *ball(300, semi_axes_mm=(12, 9, 10), centre_mm=(22, 0, 0)))
    assert failure.problem is FemProblem.PIT_OUTSIDE_FRUIT
    amount, *place = numbers(failure.detail)[:4]
    assert amount == pytest.approx(34 - 30, abs=0.2)
    assert np.linalg.norm(np.array(place) - [34, 0, 0]) < 3


def test_flesh_too_thin_to_mesh_is_named_with_place_and_thickness():
    failure = refused(*FRUIT, *ball(300, semi_axes_mm=(10, 10, 10), centre_mm=(19.8, 0, 0)))
    assert failure.problem is FemProblem.PIT_OUTSIDE_FRUIT
    thickness, *place = numbers(failure.detail)[:4]
    assert thickness == pytest.approx(0.2, abs=0.2)
    assert np.linalg.norm(np.array(place) - [30, 0, 0]) < 2
    skin = box((10, 10, 10))
    must_enclose(skin, np.array([[4.6, 0.0, 0]]), thinnest_mm=0.3)
    with pytest.raises(FemFailure, match=re.escape("0.40 mm thick at (4.6, 0.0, 0.0) mm")):
        must_enclose(skin, np.array([[4.6, 0.0, 0]]), thinnest_mm=0.5)


def test_a_point_is_inside_where_the_surface_winds_round_it_once():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 3))
    points *= (rng.uniform(0.2, 1.8, size=200) * 30 / np.linalg.norm(points, axis=1))[:, None]
    radius = np.linalg.norm(points, axis=1)
    clear = np.abs(radius - 30) > 1
    inside = (radius < 30)[clear].astype(float)
    assert winding_number(points[clear], *FRUIT) == pytest.approx(inside, abs=1e-9)


def test_a_triangle_of_the_skin_turned_inside_out_does_not_put_the_pit_outside():
    vertices, faces = (values.copy() for values in FRUIT)
    first, second = faces[0, :2]
    vertices[first] = 0.93 * (vertices[first] + 1.6 * (vertices[second] - vertices[first]))
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    inward = np.einsum("fx,fx->f", np.cross(b - a, c - a), a + b + c) < 0
    pit, _ = ball(2000, semi_axes_mm=(15, 15, 15))
    assert inward[closest_on_triangles(pit, vertices, faces).face].any()
    must_enclose((vertices, faces), pit, thinnest_mm=0.5)


def test_a_second_fruit_in_the_scan_is_named_with_place_and_size():
    failure = refused(*joined(FRUIT, ball(400, semi_axes_mm=(10, 10, 10), centre_mm=(60, 0, 0))), *PIT)
    assert failure.problem is FemProblem.DISCONNECTED_FLESH
    pieces, _, volume, _, *place = numbers(failure.detail)[:7]
    assert pieces == 2
    second = enclosed_volume_mm3(*ball(400, semi_axes_mm=(10, 10, 10)))
    assert volume == pytest.approx(second, rel=0.05)
    assert np.linalg.norm(np.array(place) - [60, 0, 0]) < 2


def test_a_hole_in_the_flesh_that_no_pit_fills_is_named_with_its_place():
    vertices, faces = ball(400, semi_axes_mm=(4, 4, 4), centre_mm=(0, 0, 20))
    failure = refused(*joined(FRUIT, (vertices, faces[:, ::-1])), *PIT)
    assert failure.problem is FemProblem.DISCONNECTED_FLESH
    places = np.array(numbers(failure.detail.split("around")[1])[:9]).reshape(3, 3)
    assert np.linalg.norm(places - [0, 0, 20], axis=1).min() < 1


def test_elements_inside_out_are_named_with_place_and_amount():
    nodes, tets = cube_mesh(3)
    inside = np.flatnonzero(
        ((nodes > 0.2) & (nodes < 0.8)).all(axis=1) & np.isin(np.arange(len(nodes)), tets[:, :4])
    )
    moved = nodes.copy()
    moved[inside[0]] += [0.0, 0, 0.6]
    skin = checked_surface(*box((10, 10, 10), centre_mm=(5, 5, 5)), name="fruit")
    with pytest.raises(FemFailure, match=r"are inverted, the worst near \(") as failure:
        _quadratic(*compact(10 * moved, tets[:, :4]), skin, None)
    assert failure.value.problem is FemProblem.INVERTED_ELEMENTS
    *place, jacobian = numbers(failure.value.detail.split("near")[1])[:4]
    assert np.linalg.norm(np.array(place) - 10 * moved[inside[0]]) < 6
    assert jacobian < 0


@pytest.mark.parametrize("flat", [(1, 1, 0), (1, 1, 1e-6)])
def test_a_surface_without_a_body_is_named_with_its_box(flat):
    with pytest.raises(FemFailure, match=r"the pit surface encloses .* mm3 in a box of 23.9 x ") as failure:
        checked_surface(PIT[0] * flat, PIT[1], name="pit")
    assert failure.value.problem is FemProblem.BAD_SURFACE


def test_open_edges_are_counted():
    failure = refused(FRUIT[0], FRUIT[1][:-1], *PIT)
    assert failure.problem is FemProblem.NOT_WATERTIGHT
    assert "fruit surface has 3 edges" in failure.detail


def test_a_surface_with_nan_is_refused_by_name():
    vertices = PIT[0].copy()
    vertices[5, 1] = np.nan
    failure = refused(*FRUIT, vertices, PIT[1])
    assert failure.problem is FemProblem.BAD_SURFACE
    assert "pit" in failure.detail


def test_a_contact_off_the_fruit_is_named_with_place_and_amount():
    at = np.array([[30.0, 0, 0], [50, 0, 0]])
    with pytest.raises(FemFailure, match=re.escape("the worst at (50.0, 0.0, 0.0) mm, by 20.")) as failure:
        tetrahedralise(*FRUIT, *PIT, edge_mm=4.0, refine_at_mm=at)
    assert failure.value.problem is FemProblem.OFF_SURFACE
    with pytest.raises(FemFailure, match="non-finite"):
        tetrahedralise(*FRUIT, *PIT, edge_mm=4.0, refine_at_mm=np.full((1, 3), np.nan))


@pytest.fixture(scope="module")
def points(solid_ball):
    """Three points inside three faces of a ball of radius 20."""
    corners = solid_ball.nodes_mm[solid_ball.outer_faces[[3, 40, 90], :3]]
    return locate(solid_ball, corners.mean(axis=1))


def test_sliding_agrees_with_locating_anew(solid_ball, points):
    way = np.array([0.02, 0.01, -0.03])
    anew = locate(solid_ball, points.point_mm + way)
    moved = points.slid(solid_ball, way)
    assert np.abs(moved.point_mm - anew.point_mm).max() < 2e-4
    assert np.abs(moved.normal - anew.normal).max() < 1e-3


def test_a_field_known_at_a_few_nodes_is_read_as_on_the_whole_mesh(solid_ball, points):
    field = np.random.default_rng(0).normal(size=(2, len(solid_ball.nodes_mm), 3))
    nodes = np.unique(points.face_nodes)
    read = points.among(nodes).sample(field[:, nodes])
    np.testing.assert_allclose(read, points.sample(field), atol=1e-14)


MESH_THEN_INTERRUPT = """
import os, signal, time
import pyvista
from fem.mesh.tetwild import fill

signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the tests' own parent made of it
box = pyvista.Box(bounds=(0, 10, 0, 10, 0, 10)).triangulate()
fill([(box.points, box.regular_faces)], edge_mm=4.0, envelope_mm=0.1)
try:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(20)
except KeyboardInterrupt:
    print("interrupted")
"""

INTERRUPT_WHILE_MESHING = """
import os, signal, subprocess
import pytetwild
from fem_shapes import ball
from fem.mesh.tetwild import fill

mesher = pytetwild.tetrahedralize

def interrupted_mesher(vertices, *arguments, **named):
    if len(vertices) > 1000:  # the ball's own mesh, which takes seconds
        subprocess.Popen(["sh", "-c", f"sleep 0.5; kill -INT {os.getpid()}"])
    return mesher(vertices, *arguments, **named)

pytetwild.tetrahedralize = interrupted_mesher
signal.signal(signal.SIGINT, signal.default_int_handler)
try:
    fill([ball(1500, semi_axes_mm=(30, 30, 30))], edge_mm=5.0, envelope_mm=0.1)
    print("meshed before it came")
except KeyboardInterrupt:
    print("interrupted")
"""
INTERRUPT_WHILE_IMPORTED = """
import os, signal, sys
from importlib.abc import MetaPathFinder

class Interrupts(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.startswith("vtkmodules"):
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupts())
signal.signal(signal.SIGINT, signal.default_int_handler)
from fem_shapes import ball
from fem.mesh.tetwild import simplified
try:
    simplified(*ball(4000, semi_axes_mm=(30, 30, 30)), edge_mm=8.0)
except KeyboardInterrupt:
    print("interrupted", "pyvista" in sys.modules)
"""


@pytest.mark.parametrize(
    ("script", "printed"),
    [(INTERRUPT_WHILE_MESHING, "interrupted\n"), (INTERRUPT_WHILE_IMPORTED, "interrupted True\n")],
    ids=["during the first mesh", "after vtk's import"],
)
def test_ctrl_c_during_the_first_mesh_or_the_import_of_vtk_reaches_python(script, printed):
    ran = python(script, cwd=Path(__file__).parent)
    assert (ran.returncode, ran.stdout) == (0, printed), ran.stderr


def test_ctrl_c_still_reaches_python_after_meshing_and_no_file_is_left(tmp_path):
    ran = python(MESH_THEN_INTERRUPT, cwd=tmp_path)
    assert (ran.returncode, ran.stdout) == (0, "interrupted\n"), ran.stderr
    assert not list(tmp_path.iterdir())
