"""A drawn fruit meshed for its grasps: per direction the bricks, the linear flesh and the skin patches."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from samples.brick_flesh import BrickFlesh, flesh_of
from samples.hexahedra import Fineness, flesh_bricks
from samples.mismatch.drawn_fruit import DrawnFruit
from samples.mismatch.four_grasps import CaseGrasp
from samples.mismatch.skin_patch import SkinPatch, degrees_of_freedom, patch_of

CASE = Fineness(degrees=(0, 6.4, 12.8, 19.4, 45), along=2, depths=(0, 0.12, 0.3, 0.6, 1))
"""Cells of 3.3 mm under the pads of a 60 mm fruit."""
TOUCHED_SHARE, SHARE_PER_MPA, SPARE_MM = 0.72, 0.1, 0.1
"""Skin touches a pad where its height above the first touch is below this share of the travel."""
WIDE_SHARE = 0.3
"""So much greater is that share where flesh gives way less: then it may reach the whole travel."""


@dataclass(frozen=True, kw_only=True)
class MeshedFruit:
    """One mesh of one fruit (E as true of it): its linear flesh, its two patches, their unknowns."""

    flesh: BrickFlesh
    patches: tuple[SkinPatch, SkinPatch]
    dofs: Int[np.ndarray, " d"]


def meshed_fruit(
    drawn: DrawnFruit, grasp: CaseGrasp, *, fineness: Fineness = CASE, wide: bool = False
) -> MeshedFruit:
    """The fruit meshed finer under the pads of the grasp, with patches as wide as the deepest press needs.

    `wide`: it gives way less than plain flesh of its modulus.
    """
    fruit = drawn.fruit
    bricks = flesh_bricks(fruit, grasp.hold.turns[0][:, 2], fineness)
    flesh = flesh_of(bricks, E_MPa=fruit.E_MPa, poisson_ratio=fruit.poisson_ratio, law="linear")
    share = TOUCHED_SHARE + SHARE_PER_MPA * fruit.E_MPa + (WIDE_SHARE if wide else 0.0)
    overlap = share * float(grasp.motion.travel_mm.max()) + SPARE_MM
    left, right = (
        patch_of(bricks, turn, touch_mm=touch, overlap_mm=overlap)
        for turn, touch in zip(grasp.hold.turns, grasp.hold.touch_mm, strict=True)
    )
    dofs = degrees_of_freedom((left, right), flesh.free_nodes, len(bricks.nodes_mm))
    return MeshedFruit(flesh=flesh, patches=(left, right), dofs=dofs)


def nodes_of(stands: MeshedFruit) -> Float[np.ndarray, "n 3"]:
    """Nodes of the mesh at rest."""
    return stands.flesh.bricks.nodes_mm
