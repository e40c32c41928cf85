"""The same mesh with the pit elsewhere in it, or of another size: no new elements, only moved nodes."""

import numpy as np
from jaxtyping import Float

from fem.mesh.flesh_mesh import FleshMesh
from fem.solid.shape_derivative import moved_mesh, pit_velocities


def with_pit_moved(mesh: FleshMesh, place: Float[np.ndarray, "4"]) -> FleshMesh:
    """The pit shifted by `place[:3]` (mm) and its lengths multiplied by exp(place[3]), about its middle.

    The flesh follows, less and less towards the skin, which does not move. Raises INVERTED_ELEMENTS if that
    would invert an element: the pit is then too close to the skin for this mesh.
    """
    amounts = np.append(place[:3], np.expm1(place[3]))
    by_mm = np.tensordot(amounts, pit_velocities(mesh), axes=1)
    shift = ", ".join(f"{x:.1f}" for x in place[:3])
    size = f"{np.exp(place[3]):.2f} of its size"
    when = f"the pit moves by ({shift}) mm and grows to {size}. Check the pit prior"
    return moved_mesh(mesh, by_mm, when)
