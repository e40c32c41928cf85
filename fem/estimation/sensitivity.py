"""Sensitivity of the markers' displacement to uncertain inputs: pit, Poisson's ratio, surface, pose.

One column per cause, d(unit displacement)/d(cause), frame by frame: the derivative of C f at fixed forces.
The forces of a recording span few directions, so a few full solves (for their leading singular vectors) serve
all its frames:  dU = -K^-1 (dK/dp) U  with dK/dp from fem.solid.shape_derivative.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory
from fem.solid.discretisation_error import discretisation_error
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import PadLink, slid
from fem.solid.rigid_core import pit_centre_mm, rigid_modes
from fem.solid.shape_derivative import pit_velocities, skin_velocities, stiffness_change, work_of_change

PIT_OFFSET = ("pit x", "pit y", "pit z")
PIT_SIZE = "pit size"
PIT = (*PIT_OFFSET, PIT_SIZE)
POISSON_RATIO = "Poisson's ratio"
SURFACE = tuple(f"surface {k + 1}" for k in range(6))
"""Six waves of the scanned surface (skin_velocities of fem.solid.shape_derivative)."""
MOST_MODES = 4
"""Most singular vectors of a recording's forces: each costs a solve. Set by hand."""
LEAST_SHARE = 1e-3
"""Singular vectors of the forces below this share of the greatest one are left out."""
SLIDE_MM = 0.1
"""Half the step of the difference quotient for a pad moved along the skin."""


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """d(unit displacement, mm MPa)/d(cause) for the markers of all pads in the frames used.

    Causes: "pit x", "pit y", "pit z" (mm), "pit size" (its ln), "surface 1" to "surface 6" (mm, waves
    of fem.solid.shape_derivative), "Poisson's ratio" (1), and for each pad "<pad> across", "<pad> along"
    (mm, its place on the skin). A fruit without a pit has no pit columns.
    """

    causes: tuple[str, ...]
    values: Float[np.ndarray, "p f n 3"]


def sensitivities(
    history: GraspHistory, solid: UnitModulusSolid, links: list[PadLink], frames: Bool[np.ndarray, " t"]
) -> tuple[Sensitivity, float]:
    """The columns of one grasp whose pads are linked to the solid, and the share of the energy that the mesh
    misses under its leading force pattern."""
    force = np.concatenate([pad.force_N[frames] for pad in history.pads], axis=1)
    modes, share = leading_patterns(force)
    split = np.cumsum([len(pad.rest_mm) for pad in history.pads])[:-1]
    by_pad = np.split(modes, split, axis=1)
    nodal = [link.nodal_force(pad_modes) for link, pad_modes in zip(links, by_pad, strict=True)]
    loads = np.zeros((len(modes), len(solid.mesh.nodes_mm), 3))
    nodal_sum = np.sum(nodal, axis=0)
    loads[:, solid.contact_nodes] = nodal_sum
    moved = solid.displacement(loads)
    withheld = discretisation_error(solid.mesh, moved[:1], poisson_ratio=solid.poisson_ratio)[0]
    causes, forces = inner_forces(solid, moved, links)
    moved = solid.contact_displacement(forces.reshape(-1, *loads.shape[1:]))
    recording = np.concatenate([link.at_markers(moved) for link in links], axis=1)
    markers_move = list(recording.reshape(len(causes), len(modes), -1, 3))
    for k, pad in enumerate(history.pads):
        for name, way in zip(("across", "along"), tangents(links[k].place.normal), strict=True):
            causes.append(f"{pad.name} {name}")
            ends = []
            for step in (SLIDE_MM, -SLIDE_MM):
                slid_pads = [*links[:k], slid(links[k], solid, step * way), *links[k + 1 :]]
                total = nodal_sum - nodal[k] + slid_pads[k].nodal_force(by_pad[k])
                flat = solid.contact_compliance @ total.reshape(len(modes), -1).T
                under = np.ascontiguousarray(flat.T).reshape(total.shape)
                ends.append(np.concatenate([link.at_markers(under) for link in slid_pads], axis=1))
            markers_move.append((ends[0] - ends[1]) / (2 * SLIDE_MM))
    values = np.einsum("fr,prnx->pfnx", share, np.stack(markers_move))
    return Sensitivity(causes=tuple(causes), values=values), float(withheld)


def leading_patterns(
    force: Float[np.ndarray, "f n 3"],
) -> tuple[Float[np.ndarray, "r n 3"], Float[np.ndarray, "f r"]]:
    """The leading force patterns (unit vectors) and the amount of each in every frame, N; raises NO_LOAD."""
    left, size, right = np.linalg.svd(force.reshape(len(force), -1), full_matrices=False)
    if not size[0] > 0:
        raise FemFailure(
            FemProblem.NO_LOAD,
            "found no force in any frame with a marker in contact, expected the contact force; check "
            "the sensor's force channel",
        )
    kept = np.flatnonzero(size[:MOST_MODES] > LEAST_SHARE * size[0])
    return right[kept].reshape(len(kept), -1, 3), left[:, kept] * size[kept]


def inner_forces(
    solid: UnitModulusSolid,
    moved: Float[np.ndarray, "r n 3"],
    links: list[PadLink],
    *,
    with_surface: bool = True,
) -> tuple[list[str], Float[np.ndarray, "p r n 3"]]:
    """Causes inside the fruit and -(dK/dp) U of each; U is relative to the pit: rigid motion strains nothing.

    `with_surface`: whether to include the surface's undulations.
    """
    mesh = solid.mesh
    has_pit = len(mesh.pit_nodes) > 0
    causes: list[str] = []
    velocities: list[np.ndarray] = []
    if has_pit:
        causes += PIT
        velocities += list(pit_velocities(mesh))
        moved = _from_the_pit(solid, moved)
    if with_surface:
        causes += SURFACE
        pads = [(link.place.point_mm, mean_normal(link.place.normal)) for link in links]
        velocities += list(skin_velocities(mesh, pads))
    moving = np.reshape(velocities, (-1, *mesh.nodes_mm.shape))
    forces = -stiffness_change(mesh, solid.poisson_ratio, moved, moving)
    if has_pit and solid.support == "base":
        forces[causes.index(PIT_SIZE)] -= _couple(solid, moved, velocities[causes.index(PIT_SIZE)])
    flat = moved.reshape(len(moved), -1).T
    by_nu = -solid.parts.change_with_poisson_ratio(flat, poisson_ratio=solid.poisson_ratio)
    causes.append(POISSON_RATIO)
    return causes, np.concatenate([forces, by_nu.T.reshape(1, *moved.shape)])


def inner_work(
    solid: UnitModulusSolid, moved: Float[np.ndarray, "r n 3"], other: Float[np.ndarray, "r n 3"]
) -> dict[str, Float[np.ndarray, " r"]]:
    """-v' (dK/dp) U of pit and Poisson's ratio: the work of `inner_forces` on other displacements v."""
    mesh, nu = solid.mesh, solid.poisson_ratio
    by_nu = solid.parts.change_with_poisson_ratio(moved.reshape(len(moved), -1).T, poisson_ratio=nu)
    work = {POISSON_RATIO: -np.einsum("rd,dr->r", other.reshape(len(other), -1), by_nu)}
    if not len(mesh.pit_nodes):
        return work
    moved, velocities = _from_the_pit(solid, moved), pit_velocities(mesh)
    by_pit = dict(zip(PIT, -work_of_change(mesh, nu, moved, other, velocities), strict=True))
    if solid.support == "base":
        couple = _couple(solid, moved, velocities[PIT.index(PIT_SIZE)])
        by_pit[PIT_SIZE] -= np.einsum("rnx,rnx->r", other, couple)
    return by_pit | work


def _from_the_pit(solid: UnitModulusSolid, moved: Float[np.ndarray, "r n 3"]) -> Float[np.ndarray, "r n 3"]:
    """Displacements less the rigid motion of the pit."""
    nodes = solid.mesh.nodes_mm
    modes = rigid_modes(nodes, centre_mm=pit_centre_mm(nodes, solid.mesh.pit_nodes))
    return np.asarray(moved - np.einsum("nik,rk->rni", modes, solid.pit_motion(moved)))


def _couple(
    solid: UnitModulusSolid, moved: Float[np.ndarray, "r n 3"], velocity: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "r n 3"]:
    """Moment of the flesh's forces on a growing pit, as forces on its nodes: their arms grow."""
    nodes = solid.mesh.pit_nodes
    reaction = (solid.stiffness @ moved.reshape(len(moved), -1).T).T.reshape(moved.shape)[:, nodes]
    moment = np.cross(velocity[nodes], reaction).sum(axis=1)
    centre = pit_centre_mm(solid.mesh.nodes_mm, nodes)
    turns = rigid_modes(solid.mesh.nodes_mm[nodes], centre_mm=centre)[:, :, 3:]
    amounts = np.linalg.solve(np.einsum("nik,nil->kl", turns, turns), moment.T)
    couple = np.zeros_like(moved)
    couple[:, nodes] = np.einsum("nik,kr->rni", turns, amounts)
    return couple


def mean_normal(normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """Unit vector along the mean of a pad's normals."""
    mean = normal.mean(axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def tangents(normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 3"]:
    """Two directions along the skin under a pad."""
    return np.asarray(np.linalg.svd(normal.mean(axis=0)[None])[2][1:])
