"""Derivative of the stiffness by the shape of the flesh.

Nodes move by e V, V the velocity field; gradients become grad u (1 - e grad V), volumes grow by e div V, and

    d/de a(u, v) = integral of  sigma(u) : grad v div V - sigma(grad u grad V) : grad v
                                - sigma(u) : (grad v grad V)

with sigma the linear elastic stress for E = 1 MPa (Sokolowski and Zolesio 1992, Introduction to Shape
Optimization, section 2.11, for elasticity).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from fem.elements.assembly import unit_lame_constants
from fem.elements.gradients import slopes_and_volumes
from fem.elements.shape_functions import TET_EDGES, t10_gradient
from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.boundary_fit import t10_jacobians
from fem.mesh.flesh_mesh import FleshMesh

_CORNERS = np.vstack([np.zeros(3), np.eye(3)])
"""Reference coordinates of a tetrahedron's corners."""
POINTS = np.vstack([np.full(3, 1 / 4), 1 / 6 + _CORNERS / 3])
"""Reference coordinates of the middle and of four points, each a third of the way from it to a corner."""
SHARES = np.array([-0.8, 0.45, 0.45, 0.45, 0.45])
"""Five points, exact to degree 3 (Hammer and Stroud 1956, Numerical Integration over Simplexes).

In straight elements that covers grad u, grad v and the linear part of V's slope. Compared with differences of
assembled solids the error is 0.4 % on a mesh of ten thousand dofs. With four points of degree 2 it is 1.6 %.
"""
WAVE_MM = 20.0
"""Wavelength of a scanned surface's error: errors from photos are smooth."""
DRAWN_WAVES = 24
"""Waves of a drawn surface error: enough for its amplitude to be nearly Gaussian."""
PAD_FADES_MM, LEAST_STEEP = 10.0, 0.5
"""Distance from a pad's markers within which the skin moves with the pad; least cosine of the two normals
(60 degrees)."""
_BATCH = 512
"""Elements processed at once, to limit memory."""


def stiffness_change(
    mesh: FleshMesh,
    poisson_ratio: float,
    displacement: Float[np.ndarray, "f n 3"],
    velocities: Float[np.ndarray, "p n 3"],
) -> Float[np.ndarray, "p f n 3"]:
    """(dK0/de) u for each velocity field and displacement: forces on the nodes for E = 1 MPa."""
    mu, lame = unit_lame_constants(poisson_ratio)
    n_loads, n_ways = len(displacement), len(velocities)
    change = np.zeros((len(mesh.nodes_mm), n_ways * n_loads * 3))
    for tets, (strained, moving), slope, measure in _gradients(mesh, displacement, velocities):
        stress = _stress(strained, mu, lame)
        flux = np.empty((measure.size, 3, n_ways, n_loads, 3))
        for k, g in enumerate(moving):
            turned = np.einsum("fixe,xye->fiye", strained, g)
            stress_change = np.trace(g) * stress
            stress_change -= _stress(turned, mu, lame)
            stress_change -= np.einsum("fixe,yxe->fiye", stress, g)
            stress_change *= measure.ravel()
            flux[:, :, k] = stress_change.transpose(3, 2, 0, 1)
        force = slope.transpose(0, 2, 1) @ flux.reshape(*slope.shape[:2], -1)
        nodes, place = np.unique(tets, return_inverse=True)
        gather = csr_array((np.ones(tets.size), (place.ravel(), np.arange(tets.size))))
        change[nodes] += gather @ force.reshape(tets.size, -1)
    nodal_force = change.reshape(-1, n_ways, n_loads, 3).transpose(1, 2, 0, 3)
    return np.ascontiguousarray(nodal_force)


def work_of_change(
    mesh: FleshMesh,
    poisson_ratio: float,
    displacement: Float[np.ndarray, "f n 3"],
    other: Float[np.ndarray, "f n 3"],
    velocities: Float[np.ndarray, "p n 3"],
) -> Float[np.ndarray, "p f"]:
    """v' (dK0/de) u for each velocity field and pair of a displacement u and another one v, E = 1 MPa.

    That is the integral of T : grad V with one tensor for all velocity fields,

        T = (sigma(u) : grad v) 1 - (grad u)' sigma(v) - (grad v)' sigma(u)

    (the energy-momentum tensor of two fields; Eshelby, "The elastic energy-momentum tensor", J. Elasticity 5,
    1975).
    """
    mu, lame = unit_lame_constants(poisson_ratio)
    work = np.zeros((len(velocities), len(displacement)))
    for _, (u, v, moving), _, measure in _gradients(mesh, displacement, other, velocities):
        of_u, of_v = _stress(u, mu, lame), _stress(v, mu, lame)
        tensor = -np.einsum("fixe,fiye->fxye", u, of_v) - np.einsum("fixe,fiye->fxye", v, of_u)
        both = np.einsum("fixe,fixe->fe", of_u, v)
        for x in range(3):
            tensor[:, x, x] += both
        tensor *= measure.ravel()
        work += moving.reshape(len(moving), -1) @ tensor.reshape(len(u), -1).T
    return work


def pit_velocities(mesh: FleshMesh) -> Float[np.ndarray, "4 n 3"]:
    """The pit moved along x, y, z (per mm), and enlarged about its middle (per unit of ln scale).

    In the flesh the motion fades from the pit to the skin, in proportion to the distances to both. Inner
    edges stay straight: this allows the largest motion before an element inverts.
    """
    on_pit = mesh.pit_share
    middle = mesh.nodes_mm[mesh.pit_nodes].mean(axis=0)
    shift = on_pit[None, :, None] * np.eye(3)[:, None, :]
    growth = on_pit[:, None] * (mesh.nodes_mm - middle)
    velocities = np.concatenate([shift, growth[None]])
    middles, ends = mesh.tets[:, 4:].ravel(), mesh.tets[:, TET_EDGES].reshape(-1, 2)
    inside = ~np.isin(middles, np.concatenate([mesh.outer_nodes, mesh.pit_nodes]))
    velocities[:, middles[inside]] = velocities[:, ends[inside]].mean(axis=2)
    return velocities


def skin_velocities(
    mesh: FleshMesh, pads: Sequence[tuple[Float[np.ndarray, "_ 3"], Float[np.ndarray, "3"]]] = ()
) -> Float[np.ndarray, "6 n 3"]:
    """Six waves of the skin along its normal, cosines and sines of WAVE_MM along x, y and z, fading inward.

    With independent amounts of variance sd^2 / 3 they are a surface error of that sd everywhere.
    `pads`: points on the skin and their mean outward normal. There the skin moves along that normal, by the
    amount that gives the same surface: the markers of a pad keep their distances on any skin. Motion along
    the skin's own normals would spread them where it rises, and C would fall with the patch's width.
    """
    nodes, motion = mesh.nodes_mm, _skin_motion(mesh, pads)
    phase = 2 * np.pi / WAVE_MM * (nodes - nodes[mesh.outer_nodes].mean(axis=0)).T
    waves = np.concatenate([np.cos(phase), np.sin(phase)])
    return np.asarray(waves[:, :, None] * motion)


def with_surface_error(
    mesh: FleshMesh,
    pads: Sequence[tuple[Float[np.ndarray, "_ 3"], Float[np.ndarray, "3"]]],
    *,
    sd_mm: float,
    rng: np.random.Generator,
) -> FleshMesh:
    """The mesh with a drawn surface error: DRAWN_WAVES waves of WAVE_MM in random directions, `sd_mm` in all.

    `pads`: as in `skin_velocities`. Raises INVERTED_ELEMENTS.
    """
    direction = rng.normal(size=(DRAWN_WAVES, 3))
    direction *= 2 * np.pi / WAVE_MM / np.linalg.norm(direction, axis=1)[:, None]
    phase = mesh.nodes_mm @ direction.T + rng.uniform(0, 2 * np.pi, DRAWN_WAVES)
    error_mm = sd_mm * np.sqrt(2 / DRAWN_WAVES) * np.cos(phase).sum(axis=1)
    return moved_mesh(
        mesh,
        error_mm[:, None] * _skin_motion(mesh, pads),
        "the skin moves by its error. Check the error of the surface",
    )


def moved_mesh(mesh: FleshMesh, by_mm: Float[np.ndarray, "n 3"], when: str) -> FleshMesh:
    """The mesh with moved nodes. Raises FemFailure (INVERTED_ELEMENTS), whose sentence `when` completes."""
    nodes = mesh.nodes_mm + by_mm
    folded = int((t10_jacobians(nodes, mesh.tets).min(axis=1) <= 0).sum())
    if folded:
        raise FemFailure(
            FemProblem.INVERTED_ELEMENTS,
            f"{folded} elements become inverted when {when}, or make a new mesh",
        )
    return replace(mesh, nodes_mm=nodes)


def _skin_motion(
    mesh: FleshMesh, pads: Sequence[tuple[Float[np.ndarray, "_ 3"], Float[np.ndarray, "3"]]]
) -> Float[np.ndarray, "n 3"]:
    """Motion of nodes by a unit error of the skin: outward, along a pad's normal near it, fading inward."""
    nodes = mesh.nodes_mm
    skin = mesh.outer_nodes
    corners = nodes[mesh.outer_faces[:, :3]]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = np.zeros_like(nodes)
    for corner in range(6):
        np.add.at(normal, mesh.outer_faces[:, corner], area)
    normal[skin] /= np.linalg.norm(normal[skin], axis=1)[:, None]
    outward = normal[skin[cKDTree(nodes[skin]).query(nodes)[1]]]
    for points, axis in pads:
        steep = outward @ axis
        away = cKDTree(points).query(nodes, distance_upper_bound=PAD_FADES_MM)[0]  # infinite beyond
        near = np.maximum(1 - away / PAD_FADES_MM, 0) * (steep > LEAST_STEEP)
        slide = axis / np.maximum(steep, LEAST_STEEP)[:, None] - outward
        outward = outward + near[:, None] * slide
    fading = 1 - mesh.pit_share if len(mesh.pit_nodes) else np.ones(len(nodes))
    return np.asarray(fading[:, None] * outward)


def _gradients(
    mesh: FleshMesh, *fields: Float[np.ndarray, "_ n 3"]
) -> Iterator[
    tuple[
        Int[np.ndarray, "m 10"],
        list[Float[np.ndarray, "_ 3 3 e"]],
        Float[np.ndarray, "m q3 10"],
        Float[np.ndarray, "m q"],
    ]
]:
    """For elements in batches: nodes; d(field)_i/dx at all points as [i, x], for each group of fields; dN/dx
    and volumes of the points.
    """
    nodal = np.ascontiguousarray(np.concatenate(fields).transpose(1, 0, 2)).reshape(len(mesh.nodes_mm), -1)
    groups = np.cumsum([len(field) for field in fields])[:-1]
    for start in range(0, len(mesh.tets), _BATCH):
        tets = mesh.tets[start : start + _BATCH]
        slope, det = slopes_and_volumes(mesh.nodes_mm[tets], t10_gradient(POINTS))
        slope, measure = slope.reshape(len(tets), -1, 10), det * SHARES / 6
        values = nodal[tets]
        values -= values[:, :1]  # a uniform motion then has no gradient, to the last digit
        gradient = (slope @ values).reshape(measure.size, 3, -1, 3)
        yield tets, np.split(np.ascontiguousarray(gradient.transpose(2, 3, 1, 0)), groups), slope, measure


def _stress(gradient: Float[np.ndarray, "f 3 3 e"], mu: float, lame: float) -> Float[np.ndarray, "f 3 3 e"]:
    """mu (g + g') + lambda tr g."""
    stress = mu * (gradient + gradient.transpose(0, 2, 1, 3))
    trace = lame * np.trace(gradient, axis1=1, axis2=2)
    for i in range(3):
        stress[:, i, i] += trace
    return np.asarray(stress)
