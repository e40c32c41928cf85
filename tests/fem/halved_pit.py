"""A pit of two rigid halves by a stiffness of its own: six more unknowns, factorised anew.

As samples.mismatch.out_of_catalogue does on its bricks. The fruit is that of coarse_fruit but for a pit as
large, beside the flesh, as a nectarine's: what its halves do is seen through 8 mm of flesh.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from coarse_fruit import NU, PIT_MIDDLE_MM
from fem_shapes import ball
from injected_mismatch import E_MPA, TIME_S, Altered, Recording, bare_grasps, meshed, true_pads
from scipy.sparse import csr_array, diags_array, hstack

from fem.mesh.flesh_mesh import FleshMesh
from fem.mismatch.model.parted_pit import EDGE_MM
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import pad_link
from fem.solid.rigid_core import pit_centre_mm, reduction
from fem.sparse.solver import factorise

PIT_HALF_AXES_MM = np.array([12.0, 11.0, 12.0])
PIT = ball(500, semi_axes_mm=PIT_HALF_AXES_MM, centre_mm=PIT_MIDDLE_MM)


@cache
def finders_mesh() -> FleshMesh:
    """The mesh that the finder is handed."""
    return meshed(7.0, 2.8, 1000, PIT)


@cache
def true_mesh() -> FleshMesh:
    """The mesh that the truth is solved on."""
    return meshed(6.0, 2.0, 2000, PIT)


@cache
def true_solid() -> UnitModulusSolid:
    """The truth's mesh factorised about a whole pit."""
    return UnitModulusSolid.factorise(true_mesh(), poisson_ratio=NU, support="free")


def off_suture_mm(solid: UnitModulusSolid, angle_deg: float) -> np.ndarray:
    """Distance of the pit's nodes from the plane through the stem's axis at this angle to x."""
    angle, mesh = np.radians(angle_deg), solid.mesh
    from_centre = mesh.nodes_mm[mesh.pit_nodes] - pit_centre_mm(mesh.nodes_mm, mesh.pit_nodes)
    return from_centre @ np.array([-np.sin(angle), np.cos(angle), 0.0])


def parted_displacement(solid: UnitModulusSolid, loads: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Displacement of a free fruit, E = 1 MPa; `second`: the share of the second half's motion that each of
    the pit's nodes takes part in, the first half's being nothing.
    """
    mesh = solid.mesh
    motions = reduction(mesh.nodes_mm, mesh.pit_nodes).tocsc()
    weight = np.ones(len(mesh.nodes_mm))
    weight[mesh.pit_nodes] = second
    ways = csr_array(hstack([motions[:, :-6], diags_array(np.repeat(weight, 3)) @ motions[:, -6:]]))
    factor = factorise(csr_array(ways.T @ solid.stiffness @ ways))
    balanced = solid.free_body.balance(loads.reshape(len(loads), -1).T)
    moved = solid.free_body.without_rigid_motion(ways @ factor.solve(ways.T @ balanced))
    return np.ascontiguousarray(moved.T).reshape(loads.shape)


@cache
def units(angle_deg: float | None, edge_mm: float = EDGE_MM) -> dict[tuple[str, bytes], np.ndarray]:
    """By pad and its axes: displacement of its markers for E = 1 MPa about a pit split at an angle, or whole.

    At the suture's edge the surface's displacement passes from one half's to the other's over `edge_mm`.
    """
    mesh, units_by_pad = true_mesh(), {}
    bare, nodes = bare_grasps(mesh)
    solid = replace(true_solid(), contact_nodes=nodes)
    links = [[pad_link(pad, solid) for pad in pads] for pads in bare]
    loads = np.zeros((len(bare), len(TIME_S), *mesh.nodes_mm.shape))
    for load, pad_links, pads in zip(loads, links, bare, strict=True):
        load[:, nodes] = sum(link.nodal_force(pad.force_N) for link, pad in zip(pad_links, pads, strict=True))
    together = loads.reshape(-1, *mesh.nodes_mm.shape)
    if angle_deg is None:
        moved = solid.displacement(together)
    else:
        second = np.clip(0.5 + off_suture_mm(solid, angle_deg) / edge_mm, 0.0, 1.0)
        moved = parted_displacement(solid, together, second)
    for at_nodes, pad_links, pads in zip(
        moved.reshape(loads.shape)[:, :, nodes], links, true_pads(), strict=True
    ):
        for link, true in zip(pad_links, pads, strict=True):
            units_by_pad[true.name, true.axes.tobytes()] = link.at_markers(at_nodes)
    return units_by_pad


def about_the_pit(angle_deg: float | None = None, share: float = 1.0) -> Altered:
    """Every pad as it is about the large pit: whole (None), or with a share of what free halves do."""
    whole, split = units(None), units(angle_deg)
    before = {(pad.name, pad.axes.tobytes()): pad.unit for pads in true_pads() for pad in pads}

    def change(pad: Recording) -> Recording:
        key = (pad.name, pad.axes.tobytes())
        unit = whole[key] + share * (split[key] - whole[key])
        moved = (unit - before[key]) / E_MPA
        return replace(pad, position_mm=pad.position_mm + moved, origin_mm=pad.origin_mm + moved.mean(axis=1))

    return change
