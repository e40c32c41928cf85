"""A small fruit on a flat foot around a pit that is off its middle, and two pads that pinch it; coarse.

For tests that compare one way of computing with another on the same mesh.
"""

from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from fem_shapes import ball
from recorded_pad import recorded_pad

from fem.grasp_history import GraspHistory
from fem.mesh import flesh_mesh
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.mesh.surface_points import locate
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes

NU = 0.45
HALF_AXES_MM = np.array([20.0, 19.0, 18.0])
PIT_HALF_AXES_MM = np.array([9.0, 6.0, 7.0])
PIT_MIDDLE_MM = np.array([0.5, -0.8, 1.0])
FOOT_MM = -15.5
AXIS = np.linspace(-3.0, 3.0, 5)
FLAT = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1).reshape(-1, 2)
STORED = Path(__file__).parents[1] / "data" / "injected-fruit"
NUMBERS = ("tets", "outer_faces", "pit_nodes")


def store(name: str, mesh: FleshMesh) -> None:
    """The mesher starts from the clock: with another mesh in each run what tests compare moves by up to a
    fifth.
    """
    numbers = {key: getattr(mesh, key).astype(np.int32) for key in NUMBERS}
    np.savez_compressed(STORED / f"{name}.npz", nodes_mm=mesh.nodes_mm.astype(np.float32), **numbers)


def stored(name: str) -> FleshMesh:
    with np.load(STORED / f"{name}.npz", allow_pickle=False) as archive:
        numbers = {key: archive[key].astype(np.int64) for key in NUMBERS}
        return FleshMesh(nodes_mm=archive["nodes_mm"].astype(float), **numbers)


def coarse_mesh(
    *surfaces: np.ndarray, longest_share: float, edge_mm: float = np.inf, **finer: Any
) -> FleshMesh:
    """Flesh between a skin and a pit (vertices and faces each). `longest_share`: edges as a share of the cube
    root of the volume; grading has an eighth at most. `finer`: where it is finer (tetrahedralise).
    """
    with mock.patch.object(flesh_mesh, "LARGEST_SHARE", longest_share):
        return tetrahedralise(*surfaces, edge_mm=edge_mm, **finer)


def meshed(longest_share: float) -> FleshMesh:
    vertices, faces = ball(2000, semi_axes_mm=HALF_AXES_MM)
    vertices[:, 2] = np.maximum(vertices[:, 2], FOOT_MM)
    pit = ball(800, semi_axes_mm=PIT_HALF_AXES_MM, centre_mm=PIT_MIDDLE_MM)
    return coarse_mesh(vertices, faces, *pit, longest_share=longest_share)


@cache
def fruit_mesh() -> FleshMesh:
    """Some twenty thousand degrees of freedom; `meshed(1 / 7.5)`, stored (injected_mismatch.store_meshes)."""
    return stored("coarse")


@cache
def pinch() -> GraspHistory:
    """Four frames: two of pressing, one of shear within each pad, and one in which a single pad presses."""
    return pinch_of(fruit_mesh())


def pinch_of(mesh: FleshMesh) -> GraspHistory:
    half_x = HALF_AXES_MM[0] * np.sqrt(1 - ((FLAT / HALF_AXES_MM[1:]) ** 2).sum(axis=1))
    bowl = 0.02 * np.exp(-(FLAT**2).sum(axis=1) / 8)
    pads, rest = [], np.column_stack([FLAT, np.zeros(len(FLAT))])
    for name, side in (("left", -1.0), ("right", 1.0)):
        place = locate(mesh, np.column_stack([side * half_x, FLAT])).point_mm
        force = np.zeros((4, len(FLAT), 3))
        force[0, :, 0], force[1, :, 0] = -side * 0.4 * bowl, -side * bowl
        force[2, :, 1:] = 0.3 * FLAT[:, ::-1] * bowl[:, None]
        force[3, :, 0] = -side * bowl * (side > 0)
        pads.append(
            recorded_pad(place, force, touching=True, sd_mm=0.004, sd_N=1e-4, name=name, rest_mm=rest)
        )
    return GraspHistory(time_s=np.arange(4.0), phase=("load",) * 4, pads=tuple(pads))


def lowest_nodes(mesh: FleshMesh) -> np.ndarray:
    """Three skin nodes that a base holds."""
    skin = mesh.outer_nodes
    return np.sort(skin[np.argsort(mesh.nodes_mm[skin, 2])[:3]])


@cache
def fruit_solid(support: str) -> UnitModulusSolid:
    """Factorised for the pinch's contact and three nodes at the foot."""
    return solid_of(fruit_mesh(), pinch(), support)


def solid_of(mesh: FleshMesh, history: GraspHistory, support: str) -> UnitModulusSolid:
    nodes = np.union1d(contact_nodes(mesh, [history]), lowest_nodes(mesh))
    return UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support=support, contact_nodes=nodes)


def all_nodes(at_contact: np.ndarray, solid: UnitModulusSolid) -> np.ndarray:
    """Forces on the contact nodes as forces on all nodes."""
    loads = np.zeros((len(at_contact), *solid.mesh.nodes_mm.shape))
    loads[:, solid.contact_nodes] = at_contact
    return loads
