"""Sensitivities are what a second mesh, another Poisson's ratio or a pad elsewhere give by differences."""

from dataclasses import replace

import numpy as np
import pytest
from coarse_fruit import NU, all_nodes, fruit_mesh, fruit_solid, pinch

from fem.elements.assembly import assemble
from fem.estimation.grasp_model import grasp_model
from fem.estimation.sensitivity import PIT, PIT_SIZE, POISSON_RATIO
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.moved_pit import with_pit_moved
from fem.solid.pad_link import pad_link
from fem.solid.rigid_core import rigid_modes

SHIFT = np.array([0.6, -0.64, 0.48])
SHIFT_MM, SIZE, RATIO = 0.25, 0.02, 0.005
SUPPORTS = ("free", "base")


def moved(cause, sign):
    """The mesh with the pit shifted or grown, and its parts (None: unmoved, with another Poisson's ratio)."""
    if cause == POISSON_RATIO:
        return fruit_mesh(), None
    amounts = np.append(SHIFT_MM * SHIFT, 0) if cause == "pit shift" else np.array([0, 0, 0, SIZE])
    mesh = with_pit_moved(fruit_mesh(), sign * amounts)
    return mesh, assemble(mesh.nodes_mm, mesh.tets)


def response(cause, support, sign):
    """The markers' displacement with the pit moved or grown, or with another Poisson's ratio."""
    mesh, parts = moved(cause, sign)
    ratio = NU + sign * RATIO if cause == POISSON_RATIO else NU
    return solved(mesh, parts or fruit_solid(support).parts, support, ratio)


def solved(mesh, parts, support, poisson_ratio):
    """Full solves of the pinch's nodal loads; the skin under the pads is that of the unmoved mesh."""
    of_prior = fruit_solid(support)
    links = [pad_link(pad, of_prior) for pad in pinch().pads]
    nodal = sum(link.nodal_force(pad.force_N) for link, pad in zip(links, pinch().pads, strict=True))
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=poisson_ratio, support=support, parts=parts)
    moved = solid.displacement(all_nodes(nodal, of_prior))[:, of_prior.contact_nodes]
    return np.concatenate([link.at_markers(moved) for link in links], axis=1)


def sensitivity(support):
    model = grasp_model(pinch(), fruit_solid(support))
    columns = dict(zip(model.sensitivity.causes, model.sensitivity.values, strict=True))
    columns["pit shift"] = np.tensordot(SHIFT, [columns[name] for name in PIT[:3]], axes=1)
    return columns


def strained(field, support):
    """A free fruit's field without its best rigid motion; a based one's as it is."""
    if support == "base":
        return field
    place = np.vstack([pad.surface_mm for pad in pinch().pads])
    rigid = rigid_modes(place, centre_mm=place.mean(axis=0)).reshape(-1, 6)
    flat = field.reshape(len(field), -1).T
    return (flat - rigid @ np.linalg.lstsq(rigid, flat, rcond=None)[0]).T.reshape(field.shape)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "step", "support"),
    [
        ("pit shift", SHIFT_MM, "free"),
        pytest.param("pit shift", SHIFT_MM, "base", marks=pytest.mark.proof),
        pytest.param(PIT_SIZE, SIZE, "free", marks=pytest.mark.proof),
        (PIT_SIZE, SIZE, "base"),
        (POISSON_RATIO, RATIO, "free"),
        pytest.param(POISSON_RATIO, RATIO, "base", marks=pytest.mark.proof),
    ],
)
def test_inner_causes_change_the_response_as_a_second_solid_does(cause, step, support):
    """Every load on a base; on a free fruit those that balance (the last one does not)."""
    wanted = (response(cause, support, 1) - response(cause, support, -1)) / (2 * step)
    wanted, column = strained(wanted, support), strained(sensitivity(support)[cause], support)
    off = np.linalg.norm(column - wanted, axis=(1, 2)) / np.linalg.norm(wanted, axis=(1, 2))
    assert off[: 3 if support == "free" else 4].max() < 5e-3


@pytest.mark.parametrize("support", SUPPORTS)
def test_a_pad_that_presses_elsewhere_changes_the_response_as_locating_it_anew_does(support):
    """To the kinks of a coarse skin over a short way; without rigid motion they weigh more."""
    solid, step_mm = fruit_solid(support), 0.1
    force = np.concatenate([pad.force_N for pad in pinch().pads], axis=1)
    left, right = pinch().pads
    normal = pad_link(left, solid).place.normal.mean(axis=0)
    across = np.linalg.svd(normal[None])[2][1]
    ends = []
    for sign in (1, -1):
        slid = replace(left, surface_mm=left.surface_mm + sign * step_mm * across)
        model = grasp_model(replace(pinch(), pads=(slid, right)), solid)
        ends.append(model.unit_displacement(force))
    wanted = strained((ends[0] - ends[1]) / (2 * step_mm), support)
    column = strained(sensitivity(support)["left across"], support)
    within = 0.05 if support == "base" else 0.2
    assert np.linalg.norm(column - wanted) < within * np.linalg.norm(wanted)


def test_a_fruit_without_a_pit_has_no_pit_among_its_causes():
    history = pinch()
    whole = replace(fruit_mesh(), pit_nodes=np.zeros(0, dtype=np.int64))
    solid = UnitModulusSolid.factorise(
        whole, poisson_ratio=NU, support="free", contact_nodes=fruit_solid("free").contact_nodes
    )
    causes = grasp_model(history, solid).sensitivity.causes
    assert not set(PIT) & set(causes)
    assert causes[6] == POISSON_RATIO
    assert causes[7:] == ("left across", "left along", "right across", "right along")
