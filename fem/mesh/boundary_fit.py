"""Pull boundary nodes onto a target surface, as far as every element stays well shaped."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from fem.elements.shape_functions import t10_gradient, tet_quadrature
from fem.mesh.tetrahedra import signed_volumes_mm3

#: smallest share of its former Jacobian that an element keeps anywhere when nodes are pulled
KEPT = 0.15
_CORNERS_AND_MIDDLES = np.array(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0], [0, 0, 0.5],
     [0.5, 0, 0.5], [0, 0.5, 0.5]]
)  # fmt: skip
"""Reference coordinates of a T10's ten nodes, in their order."""
_PROBES = t10_gradient(np.vstack([_CORNERS_AND_MIDDLES, tet_quadrature()[0]]))
"""Shape functions' derivatives at an element's nodes and quadrature points: where it is looked at for
folds."""


def t10_jacobians(
    nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 10"]
) -> Float[np.ndarray, "m q"]:
    """det dx/dxi of curved elements at their nodes and quadrature points; all positive: none is folded."""
    return np.asarray(np.linalg.det(np.einsum("qin,mnx->mqix", _PROBES, nodes_mm[tets])))


def t4_jacobians(
    nodes_mm: Float[np.ndarray, "n 3"], tets: Int[np.ndarray, "m 4"]
) -> Float[np.ndarray, "m 1"]:
    """det dx/dxi of straight elements: six times the signed volume."""
    return 6 * signed_volumes_mm3(nodes_mm, tets)[:, None]


def pull(
    nodes_mm: Float[np.ndarray, "n 3"],
    cells: Int[np.ndarray, "m c"],
    moving: Int[np.ndarray, " p"],
    target_mm: Float[np.ndarray, "p 3"],
    jacobians: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Float[np.ndarray, "n 3"]:
    """Nodes with `moving` at `target_mm`; those of an element that would fold go half way, or less.

    After six halvings such a node stays where it was, so a valid mesh stays valid.
    """
    touched = np.zeros(len(nodes_mm), dtype=bool)
    touched[moving] = True
    near = cells[touched[cells].any(axis=1)]
    floor = KEPT * jacobians(nodes_mm, near).min(axis=1)
    way = np.ones(len(nodes_mm))
    shift = np.zeros_like(nodes_mm)
    shift[moving] = target_mm - nodes_mm[moving]
    for _ in range(7):
        moved = np.asarray(nodes_mm + way[:, None] * shift)
        bad: Bool[np.ndarray, " m"] = jacobians(moved, near).min(axis=1) < floor
        if not bad.any():
            return moved
        at_fault = np.unique(near[bad])
        way[at_fault] = np.where(way[at_fault] > 1 / 64, way[at_fault] / 2, 0.0)
    way[np.unique(near[bad])] = 0.0
    return np.asarray(nodes_mm + way[:, None] * shift)
