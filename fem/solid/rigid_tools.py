"""Force of rigid tools without friction on flesh of E = 1 MPa, by unilateral contact.

Under tools that only push, the gap of every skin node is  w = g - d + n' C n p >= 0  with forces p >= 0 and
w p = 0: g the initial gap, d the advance of the tool, n the direction to the tool, C the compliance of the
skin (UnitModulusSolid.contact_compliance). The kinematics are exact for a flat plate; strain is small.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.unilateral_contact import pressures

LOOSE = 1e5
"""Between two tools the fruit may float: a spring this many times softer than a node holds it, and takes less
than 1e-4 of the force."""


@dataclass(frozen=True, kw_only=True)
class RigidTool:
    """A tool that advances against `towards` (unit vector, from the flesh to the tool).

    `nodes`: skin nodes that it may touch; `gap_mm`: how far each is from the tool at first touch.
    """

    nodes: Int[np.ndarray, " c"]
    towards: Float[np.ndarray, "3"]
    gap_mm: Float[np.ndarray, " c"]


def tool_force_N(
    solid: UnitModulusSolid, tools: Sequence[RigidTool], approach_mm: Float[np.ndarray, " f"]
) -> Float[np.ndarray, " f"]:
    """Force on the first tool at each approach from first touch, N per MPa of E; approaches ascend.

    One tool: the mean displacement of the flesh is zero (a free solid). Two: the approach is that of both
    together, and the fruit moves freely between them, without rotation.
    """
    nodes = np.unique(np.concatenate([tool.nodes for tool in tools]))
    compliance = replace(solid, contact_nodes=nodes).contact_compliance
    which = np.concatenate([np.full(len(tool.nodes), k) for k, tool in enumerate(tools)])
    at = np.searchsorted(nodes, np.concatenate([tool.nodes for tool in tools]))
    pushed = np.zeros((3 * len(nodes), len(at)))
    for axis in range(3):
        pushed[3 * at + axis, np.arange(len(at))] = np.stack([tool.towards for tool in tools])[which, axis]
    inward = pushed.T @ compliance @ pushed
    inward = (inward + inward.T) / 2
    if len(tools) > 1:
        along = pushed.reshape(-1, 3, len(at)).sum(axis=0).T @ tools[0].towards
        inward += LOOSE * np.trace(inward) / len(inward) * np.outer(along, along)
    gap = np.concatenate([tool.gap_mm for tool in tools])
    pressed = pressures(inward, gap - approach_mm[:, None] / len(tools))
    return np.asarray(pressed[:, which == 0].sum(axis=1))
