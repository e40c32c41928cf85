"""The skin in front of the two pads: its nodes, its cells, its unknowns."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from samples.hexahedra import Bricks


@dataclass(frozen=True, kw_only=True)
class SkinPatch:
    """The skin that one pad can reach: its nodes (numbers in the bricks), its cells (local numbers).

    Nodes are in the order in which a face that comes nearer would meet them.
    `turn` takes pad axes to fruit axes; `rim`: the nodes (local) that border on other skin.
    """

    turn: Float[np.ndarray, "3 3"]
    nodes: Int[np.ndarray, " n"]
    cells: Int[np.ndarray, "k 9"]
    rim: Int[np.ndarray, " r"]


def patch_of(
    bricks: Bricks, turn: Float[np.ndarray, "3 3"], *, touch_mm: Float[np.ndarray, " 3"], overlap_mm: float
) -> SkinPatch:
    """Cells that face the pad and come within `overlap_mm` of its face where it first touches."""
    local = (bricks.nodes_mm - touch_mm) @ turn
    corners = local[bricks.skin_cells]
    normal = np.cross(corners[:, 2, 1] - corners[:, 0, 1], corners[:, 1, 2] - corners[:, 1, 0])
    faces_it = normal[:, 2] < -0.3 * np.linalg.norm(normal, axis=1)
    near = faces_it & (corners[..., 2].min(axis=(1, 2)) < overlap_mm)
    nodes, cells = np.unique(bricks.skin_cells[near], return_inverse=True)
    order = np.argsort(local[nodes, 2], kind="stable")
    nodes, cells = nodes[order], np.argsort(order)[cells]
    rim = np.isin(nodes, bricks.skin_cells[~near])
    return SkinPatch(turn=turn, nodes=nodes, cells=cells.reshape(-1, 9), rim=np.flatnonzero(rim))
