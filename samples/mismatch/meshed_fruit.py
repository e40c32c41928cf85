"""A fruit meshed for its grasps: for each direction the bricks, the linear flesh and the skin patches."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from samples.brick_flesh import BrickFlesh, flesh_of
from samples.fruit import SampleFruit
from samples.graded_bricks import BrickGrading, graded_bricks, touched_skin_mm
from samples.grasp_plan import PlannedGrasp
from samples.hexahedra import Bricks, Fineness, flesh_bricks
from samples.mismatch.marker_sensor import DEFAULT_SENSOR, MarkerSensor

CASE = BrickGrading(cells=4, layers=4)
"""Bricks of 0.049 of the fruit's radius (1.3 mm at 27 mm) at the skin under the pads.
benchmarks/truth_verification.py measures the remaining error (docs/validation.md, Solver). Fewer layers are
too stiff between skin and pit: with two, a pad's force is 0.25 % too large."""
RIGID_SHARE, HALF, FIRMNESS_MM, SPARE_MM = 1.2, 0.5, 2.4, 0.1
"""Skin touches a pad if its height above the first touch is below a share of the travel. The share is half
for flesh much softer than the gel (Hertz), and one for flesh much firmer. In between it is about 1 - 0.5 / (1
+ E / (2.4 mm kn)), from 6 pads of one fruit. 0.2 and 0.1 mm are reserves: patches end with whole cells."""
WIDE_SHARE = 0.3
"""Increase of that share for flesh stiffer than its modulus: its share may reach the whole travel."""


@dataclass(frozen=True, kw_only=True)
class SkinPatch:
    """The skin that one pad can reach: its nodes (numbers in the bricks), its cells (local numbers).

    Nodes are in the order in which an approaching face would meet them. `turn` takes pad axes to fruit axes;
    `rim`: nodes (local) that other skin shares.
    """

    turn: Float[np.ndarray, "3 3"]
    nodes: Int[np.ndarray, " n"]
    cells: Int[np.ndarray, "k 9"]
    rim: Int[np.ndarray, " r"]


@dataclass(frozen=True, kw_only=True)
class MeshedFruit:
    """One mesh of one fruit (with its true E): its linear flesh, its two patches, their unknowns.

    `touch_mm`: middle of each pad's face at first touch (fruit frame); `sensor`: that of both pads.
    """

    flesh: BrickFlesh
    patches: tuple[SkinPatch, SkinPatch]
    dofs: Int[np.ndarray, " d"]
    touch_mm: Float[np.ndarray, "2 3"]
    sensor: MarkerSensor


def meshed_fruit(
    fruit: SampleFruit,
    grasp: PlannedGrasp,
    *,
    sensor: MarkerSensor = DEFAULT_SENSOR,
    fineness: BrickGrading | Fineness = CASE,
    wider: float = 0.0,
) -> MeshedFruit:
    """The fruit meshed finer under the pads of the grasp, with patches as wide as the deepest press needs.

    `wider` adds to the share of RIGID_SHARE (see WIDE_SHARE). Raises ValueError for inverted bricks or
    hanging nodes in a patch.
    """
    firmness = fruit.E_MPa / (FIRMNESS_MM * sensor.gel.kn_MPa_per_mm)
    share = RIGID_SHARE - HALF / (1 + firmness) + wider
    overlap_mm = share * float(grasp.motion.travel_mm.max()) + SPARE_MM
    pads = list(zip(grasp.hold.turns, grasp.hold.touch_mm, strict=True))
    axis = grasp.hold.turns[0][:, 2]
    if isinstance(fineness, Fineness):
        bricks = flesh_bricks(fruit, axis, fineness)
    else:
        touched = [touched_skin_mm(fruit, turn, touch_mm=at, overlap_mm=overlap_mm) for turn, at in pads]
        bricks = graded_bricks(fruit, axis, fineness, touched_mm=np.concatenate(touched))
    flesh = flesh_of(bricks, E_MPa=fruit.E_MPa, poisson_ratio=fruit.poisson_ratio)
    left, right = (patch_of(bricks, turn, touch_mm=at, overlap_mm=overlap_mm) for turn, at in pads)
    dofs = flesh.dofs_of(np.concatenate([left.nodes, right.nodes])).ravel()
    return MeshedFruit(
        flesh=flesh, patches=(left, right), dofs=dofs, touch_mm=grasp.hold.touch_mm, sensor=sensor
    )


def patch_of(
    bricks: Bricks, turn: Float[np.ndarray, "3 3"], *, touch_mm: Float[np.ndarray, " 3"], overlap_mm: float
) -> SkinPatch:
    """Cells that face the pad and come within `overlap_mm` of its face at first touch."""
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
