"""Freestone: a pit with an even gap all round, which the flesh closes by being pressed."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array, diags_array, eye_array, hstack, kron

from fem.sparse.solver import factorise
from samples.brick_flesh import HOLDING, BrickFlesh, assembled, rigid_tie
from samples.hexahedra import Bricks
from samples.mismatch.grip import InnerContact
from samples.mismatch.skin_compliance import SkinCompliance, skin_compliance


def split_pit_stiffness(flesh: BrickFlesh, *, angle_deg: float = 0.0, share: float = 1.0) -> csr_array:
    """Stiffness with two rigid half pits; the second half's six unknowns come last.

    `angle_deg`: of the parting plane about the stem's axis z, from x towards y. `share`: how far the halves
    part, of what they would with nothing joining them: below 1 a bond joins them, (1 / share - 1) times what
    the flesh itself holds them together by.
    """
    bricks = flesh.bricks
    full = assembled(
        bricks.cells, flesh.slopes, flesh.volumes, flesh.mu_MPa, flesh.lam_MPa, len(bricks.nodes_mm)
    )
    tie = coo_array(rigid_tie(bricks, flesh.free_nodes, flesh.pit_centre_mm))
    is_second = np.zeros(len(bricks.nodes_mm), dtype=bool)
    pit, angle = bricks.pit_nodes, np.radians(angle_deg)
    x, y = (bricks.nodes_mm[pit] - flesh.pit_centre_mm)[:, :2].T
    is_second[pit[y * np.cos(angle) - x * np.sin(angle) > 0]] = True
    rows, columns = tie.coords
    moved = is_second[rows // 3] & (columns >= flesh.unknowns - 6)
    halves = csr_array(
        coo_array(
            (tie.data, (rows, np.where(moved, columns + 6, columns))),
            shape=(tie.shape[0], flesh.unknowns + 6),
        )
    )
    holding = np.zeros(flesh.unknowns + 6)
    holding[-12:] = np.tile(HOLDING / 2, 2)
    at = np.arange(len(holding))
    free = csr_array(halves.T @ full @ halves + coo_array((holding, (at, at))).tocsr())
    return free if share == 1.0 else csr_array(free + _bond(free, share))


def _bond(free: csr_array, share: float) -> csr_array:
    """Between the halves: (1 / share - 1) times the stiffness of their motion relative to each other."""
    last = np.arange(free.shape[0] - 12, free.shape[0])
    apart = np.hstack([-np.eye(6), np.eye(6)])
    gives = apart @ factorise(free).compliance(last) @ apart.T
    bond = (1 / share - 1) * apart.T @ np.linalg.inv((gives + gives.T) / 2) @ apart
    rows, columns = np.meshgrid(last, last, indexing="ij")
    return csr_array(coo_array((bond.ravel(), (rows.ravel(), columns.ravel())), shape=free.shape))


THREADS_N_PER_MM = 0.05
"""All round, hair-fine threads hold the flesh to the pit; they keep it from floating off."""
PENALTY_PER_MM = 25.0
"""Closed, the pit's surface gives way by the pressure over this many times E."""


def loose_compliance(
    flesh: BrickFlesh, skin_dofs: Int[np.ndarray, " d"], *, extra: csr_array | None = None
) -> SkinCompliance:
    """Compliance of the skin's unknowns, then of the opening of every pit node.

    `extra`: stiffness on the flesh's own unknowns to add, with the pit's nodes bonded (a skin).
    """
    bricks = flesh.bricks
    full = assembled(
        bricks.cells, flesh.slopes, flesh.volumes, flesh.mu_MPa, flesh.lam_MPa, len(bricks.nodes_mm)
    )
    bonded = rigid_tie(bricks, flesh.free_nodes, flesh.pit_centre_mm)
    tie = csr_array(hstack([bonded, _motion_off_pit(flesh)]))
    stiffness = csr_array(tie.T @ full @ tie)
    count, nodes = flesh.unknowns, len(_opening_nodes(bricks))
    diagonal = np.zeros(stiffness.shape[0])
    diagonal[count - 6 : count] = HOLDING
    diagonal[count:] = THREADS_N_PER_MM / nodes
    stiffness = csr_array(stiffness + diags_array(diagonal))
    if extra is not None:
        padded = coo_array(extra)
        padded = coo_array((padded.data, padded.coords), shape=stiffness.shape)
        stiffness = csr_array(stiffness + padded.tocsr())
    openings = count + 3 * np.arange(nodes)
    return skin_compliance(stiffness, np.concatenate([skin_dofs, openings]))


def pit_contact(flesh: BrickFlesh, *, gap_mm: float) -> InnerContact:
    """The pit's surface as a stiff frictionless bed at `gap_mm`."""
    modulus = flesh.mu_MPa * (3 * flesh.lam_MPa + 2 * flesh.mu_MPa) / (flesh.lam_MPa + flesh.mu_MPa)
    _, areas = _normals(flesh)
    return InnerContact(gap_mm=gap_mm, N_per_mm=PENALTY_PER_MM * modulus * areas)


def _normals(flesh: BrickFlesh) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """Outward unit normals of the pit's opening nodes, and the area that each stands for."""
    bricks = flesh.bricks
    quads = _pit_quads(flesh)
    x = bricks.nodes_mm
    cross = np.cross(x[quads[:, 2]] - x[quads[:, 0]], x[quads[:, 3]] - x[quads[:, 1]]) / 2
    total = np.zeros_like(x)
    for corner in quads.T:
        np.add.at(total, corner, cross / 4)
    if bricks.follows is not None:
        total = np.asarray(bricks.follows.T @ total)
    total = total[_opening_nodes(bricks)]
    size = np.linalg.norm(total, axis=1)
    return total / size[:, None], size


def _opening_nodes(bricks: Bricks) -> Int[np.ndarray, " p"]:
    """Nodes of the pit that move for themselves once it is loose: all but hanging ones."""
    if bricks.follows is None:
        return bricks.pit_nodes
    return np.asarray(bricks.pit_nodes[bricks.follows.diagonal()[bricks.pit_nodes] == 1.0])


def _pit_quads(flesh: BrickFlesh) -> Int[np.ndarray, "k 4"]:
    """Four small quadrilaterals per innermost cell, outward."""
    bricks = flesh.bricks
    inner = bricks.cells[np.all(np.isin(bricks.cells[:, :9], bricks.pit_nodes), axis=1), :9].reshape(-1, 3, 3)
    quads = [
        np.stack([inner[:, i, j], inner[:, i + 1, j], inner[:, i + 1, j + 1], inner[:, i, j + 1]], axis=1)
        for i in (0, 1)
        for j in (0, 1)
    ]
    return np.concatenate(quads)


def _motion_off_pit(flesh: BrickFlesh) -> coo_array:
    """How the flesh moves off the pit at each node: along the normal and two tangents."""
    bricks = flesh.bricks
    normal, _ = _normals(flesh)
    helper = np.where(np.abs(normal[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(normal, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frames = np.stack([normal, first, np.cross(normal, first)], axis=2)
    opening = _opening_nodes(bricks)
    nodes = len(opening)
    rows = np.repeat(3 * opening[:, None] + np.arange(3), 3, axis=1).ravel()
    columns = np.tile(3 * np.arange(nodes)[:, None] + np.arange(3), (1, 3)).ravel()
    motion = coo_array((frames.ravel(), (rows, columns)), shape=(3 * len(bricks.nodes_mm), 3 * nodes))
    return (
        motion if bricks.follows is None else coo_array(kron(bricks.follows, eye_array(3)) @ motion.tocsr())
    )
