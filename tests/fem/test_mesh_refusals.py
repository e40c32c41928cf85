"""Every bad surface is refused with what was found, where, and by how much."""

import re

import numpy as np
import pytest
from fem_shapes import ball, box, cube_mesh

from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.closed_surface import checked_surface, must_enclose, winding_number
from fem.mesh.closest_point import closest_on_triangles, enclosed_volume_mm3
from fem.mesh.flesh_mesh import _quadratic, tetrahedralise
from fem.mesh.tetrahedra import compact

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
