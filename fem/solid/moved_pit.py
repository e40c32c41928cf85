"""The same mesh with the pit elsewhere in it, or of another size: no new elements, only moved nodes."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from fem.fem_failure import FemFailure, FemProblem
from fem.mesh.boundary_fit import t10_jacobians
from fem.mesh.flesh_mesh import FleshMesh
from fem.solid.shape_derivative import pit_velocities


def with_pit_moved(mesh: FleshMesh, place: Float[np.ndarray, "4"]) -> FleshMesh:
    """The pit shifted by `place[:3]` (mm) and its lengths multiplied by exp(place[3]), about its middle.

    The flesh follows, less and less towards the skin, which stays. Raises INVERTED_ELEMENTS where that would
    turn an element inside out: the pit then belongs too close to the skin for this mesh.
    """
    amounts = np.append(place[:3], np.expm1(place[3]))
    nodes = mesh.nodes_mm + np.tensordot(amounts, pit_velocities(mesh), axes=1)
    folded = int((t10_jacobians(nodes, mesh.tets).min(axis=1) <= 0).sum())
    if folded:
        shift = ", ".join(f"{x:.1f}" for x in place[:3])
        raise FemFailure(
            FemProblem.INVERTED_ELEMENTS,
            f"{folded} elements become inverted when the pit moves by ({shift}) mm and grows to "
            f"{np.exp(place[3]):.2f} of its size. Check the pit prior, or make a new mesh with that "
            "pit",
        )
    return replace(mesh, nodes_mm=nodes)
