"""Everything dense that a grasp needs equals what full solves give, and loses neither force nor motion."""

import numpy as np
import pytest
from coarse_fruit import all_nodes, fruit_mesh, fruit_solid, lowest_nodes, pinch

from fem.estimation.grasp_model import grasp_model
from fem.solid.pad_link import contact_nodes, pad_link
from fem.solid.rigid_core import rigid_modes


@pytest.fixture(params=["free", "base"])
def solid(request):
    return fruit_solid(request.param)


def test_compliance_at_the_contact_is_that_of_full_solves(solid):
    rng = np.random.default_rng(0)
    size = 3 * len(solid.contact_nodes)
    some = np.vstack([np.eye(size)[rng.choice(size, 6, replace=False)], rng.normal(size=(4, size))])
    loads = all_nodes(some.reshape(len(some), -1, 3), solid)
    moved = solid.displacement(loads)[:, solid.contact_nodes].reshape(len(some), -1)
    response = some @ solid.contact_compliance
    assert np.abs(response - moved).max() < 1e-9 * np.abs(moved).max()


def test_nodes_that_a_base_holds_neither_move_nor_push():
    solid = fruit_solid("base")
    held = np.isin(solid.contact_nodes, lowest_nodes(solid.mesh))
    assert held.sum() == 3
    rows = np.repeat(held, 3)
    assert not solid.contact_compliance[rows].any()
    assert not solid.contact_compliance[:, rows].any()
    assert (np.diag(solid.contact_compliance)[~rows] > 0).all()


def linked(solid):
    return [pad_link(pad, solid) for pad in pinch().pads]


def test_the_markers_displacement_is_that_of_a_full_solve_of_their_nodal_loads(solid):
    links = linked(solid)
    nodal = sum(link.nodal_force(pad.force_N) for link, pad in zip(links, pinch().pads, strict=True))
    moved = solid.displacement(all_nodes(nodal, solid))[:, solid.contact_nodes]
    wanted = np.concatenate([link.at_markers(moved) for link in links], axis=1)
    model = grasp_model(pinch(), solid)
    force = np.concatenate([pad.force_N for pad in pinch().pads], axis=1)
    displacement = model.unit_displacement(force)
    assert np.abs(displacement - wanted).max() < 1e-9 * np.abs(wanted).max()
    assert np.abs(model.compliance - model.compliance.T).max() < 1e-12 * np.abs(model.compliance).max()
    assert model.fruit_moves is (solid.support == "free")


def test_nodal_loads_keep_the_markers_force_and_moment():
    solid = fruit_solid("free")
    nodes = solid.mesh.nodes_mm[solid.contact_nodes]
    for link in linked(solid):
        force = np.random.default_rng(1).normal(size=(3, len(link.place.point_mm), 3))
        origin = np.array([5.0, 0, -3])
        at_markers = rigid_modes(link.place.point_mm, centre_mm=origin)
        wanted = np.einsum("nxk,fnx->fk", at_markers, force)
        given = np.einsum("nxk,fnx->fk", rigid_modes(nodes, centre_mm=origin), link.nodal_force(force))
        assert np.abs(given - wanted).max() < 1e-9 * np.abs(wanted).max()


def test_reading_does_the_same_work_as_loading():
    solid = fruit_solid("free")
    rng = np.random.default_rng(3)
    moved = rng.normal(size=(1, len(solid.contact_nodes), 3))
    for link in linked(solid):
        force = rng.normal(size=(1, len(link.place.point_mm), 3))
        assert np.vdot(link.nodal_force(force), moved) == pytest.approx(
            np.vdot(force, link.at_markers(moved))
        )


def test_contact_nodes_are_the_faces_under_the_pads_sorted_and_once():
    nodes = contact_nodes(fruit_mesh(), [pinch(), pinch()])
    np.testing.assert_array_equal(nodes, contact_nodes(fruit_mesh(), [pinch()]))
    assert np.isin(nodes, fruit_mesh().outer_nodes).all()
    assert (np.diff(nodes) > 0).all()
    assert len(contact_nodes(fruit_mesh(), [])) == 0
