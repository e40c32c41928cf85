"""A third contact: something beside the pads touches the fruit and pushes back, without friction.

A seat that fits the skin within a few millimetres of one place, on a spring along the skin's normal there,
first touches when the skin has come `gap_mm` towards it: a palm under the fruit, a table, a stop.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array

from samples.brick_flesh import BrickFlesh
from samples.fruit import Skin
from samples.mismatch.grip import InnerContact
from samples.mismatch.skin_compliance import SkinCompliance, skin_compliance
from samples.mismatch.true_recording import TrueRecording
from samples.sample_failure import SampleFailure

LOWEST_CAP_DEG = 30.0
"""Degrees from the lowest point within which a place is drawn: out of the pads' way, whose lowest spot is 60
degrees from it (samples.mismatch.four_grasps)."""
STEP = 1e-4
"""Of directions, by which the skin's normal is found by differences; on a smooth skin any small number
does."""
SEAT_RADIUS_MM = 6.0
"""What of the skin about the place the seat bears. Set by hand, as a palm's soft cushion would."""
FEWEST = 9
"""Nodes that it bears at least, on a mesh that is coarse there: those of a cell's face."""


def drawn_place_mm(skin: Skin, rng: np.random.Generator) -> Float[np.ndarray, " 3"]:
    """A place on the skin within LOWEST_CAP_DEG of its lowest point, evenly over the cap."""
    height = rng.uniform(np.cos(np.radians(LOWEST_CAP_DEG)), 1.0)
    azimuth, across = rng.uniform(0, 2 * np.pi), np.sqrt(1 - height**2)
    direction = np.array([across * np.cos(azimuth), across * np.sin(azimuth), -height])
    return np.asarray(skin.points_mm(direction[None])[0])


def inward_normal(skin: Skin, place_mm: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Unit normal of the skin there, into the fruit."""
    outward = place_mm - np.array(skin.centre_mm)
    outward = outward / np.linalg.norm(outward)
    first = np.cross(outward, np.eye(3)[np.abs(outward).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(outward, first)
    ways = np.stack([outward + s * way for way in (first, second) for s in (STEP, -STEP)])
    ahead, back, left, right = skin.points_mm(ways / np.linalg.norm(ways, axis=1, keepdims=True))
    normal = np.cross(ahead - back, left - right)
    normal /= np.linalg.norm(normal)
    return np.asarray(-normal * np.sign(normal @ outward))


def with_third_contact(
    flesh: BrickFlesh,
    skin_dofs: Int[np.ndarray, " d"],
    *,
    centre_mm: Float[np.ndarray, " 3"],
    normal: Float[np.ndarray, " 3"],
    N_per_mm: float,
    gap_mm: float = 0.0,
    stiffness: csr_array | None = None,
) -> tuple[SkinCompliance, InnerContact]:
    """Compliance of the skin's unknowns, then of the way inward of every node of the seat; and the seat.

    `normal`: into the fruit, that of the seat. `stiffness`: of the flesh, on its unknowns (None: plain).
    """
    bricks = flesh.bricks
    skin = np.unique(bricks.skin_cells)
    away = np.linalg.norm(bricks.nodes_mm[skin] - centre_mm, axis=1)
    away[~np.isin(skin, flesh.free_nodes)] = np.inf
    able = away < max(SEAT_RADIUS_MM, float(np.sort(away)[FEWEST - 1]) + 1e-9)
    seat = flesh.dofs_of(skin[able])[:, 0]
    helper = np.eye(3)[np.abs(normal).argmin()]
    first = np.cross(normal, helper)
    first /= np.linalg.norm(first)
    axes = np.column_stack([normal, first, np.cross(normal, first)])
    shares = _shares((bricks.nodes_mm[skin[able]] - centre_mm) @ axes[:, 1:])
    whole = flesh.stiffness if stiffness is None else stiffness
    others = np.setdiff1d(np.arange(whole.shape[0]), (seat[:, None] + np.arange(3)).ravel())
    rows = np.concatenate([others, np.repeat(seat[:, None] + np.arange(3), 3, axis=1).ravel()])
    columns = np.concatenate([others, np.tile(seat[:, None] + np.arange(3), (1, 3)).ravel()])
    values = np.concatenate([np.ones(len(others)), np.tile(axes.ravel(), len(seat))])
    turn = csr_array(coo_array((values, (rows, columns)), shape=whole.shape).tocsr())
    compliance = skin_compliance(csr_array(turn.T @ whole @ turn), np.concatenate([skin_dofs, seat]))
    return compliance, InnerContact(gap_mm=gap_mm, N_per_mm=N_per_mm * shares)


def _shares(across_mm: Float[np.ndarray, "s 2"]) -> Float[np.ndarray, " s"]:
    """Of the stiffness that each node has: the most even ones about the middle, all above zero."""
    rows = np.column_stack([np.ones(len(across_mm)), across_mm])
    shares = np.linalg.lstsq(rows.T, np.array([1.0, 0.0, 0.0]))[0]
    if np.linalg.matrix_rank(rows) < 3 or not (shares > 0).all():
        raise SampleFailure(
            f"the mesh has {len(across_mm)} nodes where the third contact is, not all round it: "
            "expected three at least; take another place or a finer mesh"
        )
    return np.asarray(shares)


def borne_N(truth: TrueRecording) -> float:
    """The greatest force that the pads of a recording leave to others, N."""
    total = np.sum([np.einsum("tij,tnj->ti", p.pose[:, :3, :3], p.force_N) for p in truth.pads], axis=0)
    return float(np.linalg.norm(total, axis=1).max())
