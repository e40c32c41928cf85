"""Fruit with another body: a loose pit with an even gap, a split pit, a third contact, a palm.

A third contact is a seat that fits the skin within a few millimetres of one place, on a spring along the
skin's normal. It touches after the skin has moved `gap_mm` towards it: a palm, a table, a stop.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array, diags_array, eye_array, hstack, kron

from fem.sparse.solver import factorise
from samples.brick_flesh import HOLDING, BrickFlesh, assembled, rigid_tie
from samples.fruit import Skin
from samples.hexahedra import Bricks
from samples.mismatch.flesh_laws import Lame
from samples.mismatch.grip import InnerContact
from samples.mismatch.skin_compliance import SkinCompliance, skin_compliance
from samples.mismatch.true_recording import TrueRecording
from samples.sample_failure import SampleFailure

LOWEST_CAP_DEG = 30.0
"""Largest angle of the place from the lowest point, degrees. The pads do not reach it: their lowest spot is
60 degrees from that point (samples.grasp_plan)."""
STEP = 1e-4
"""Step of directions for the skin's normal by differences; on a smooth skin any small number serves."""
SEAT_RADIUS_MM = 6.0
"""Radius of skin around the place that the seat bears, mm. Set by hand, as for a palm's soft cushion."""
FEWEST = 9
"""Fewest nodes that it bears on a coarse mesh: those of a cell's face."""


def drawn_place_mm(skin: Skin, rng: np.random.Generator) -> Float[np.ndarray, " 3"]:
    """A place on the skin within LOWEST_CAP_DEG of its lowest point, uniform over the cap."""
    height = rng.uniform(np.cos(np.radians(LOWEST_CAP_DEG)), 1.0)
    azimuth, across = rng.uniform(0, 2 * np.pi), np.sqrt(1 - height**2)
    direction = np.array([across * np.cos(azimuth), across * np.sin(azimuth), -height])
    return np.asarray(skin.points_mm(direction[None])[0])


def inward_normal(skin: Skin, place_mm: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Unit normal of the skin at a place, into the fruit."""
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
    """Compliance of the skin's unknowns and of the inward displacement of the seat's nodes; and the seat.

    `normal`: the seat's, inward. `stiffness`: the flesh's (None: plain). Raises SampleFailure on a coarse
    mesh.
    """
    bricks = flesh.bricks
    skin = np.unique(bricks.skin_cells)
    away = np.linalg.norm(bricks.nodes_mm[skin] - centre_mm, axis=1)
    away[~np.isin(skin, flesh.free_nodes)] = np.inf
    able = away < max(SEAT_RADIUS_MM, float(np.sort(away)[FEWEST - 1]) + 1e-9)
    seat = flesh.dofs_of(skin[able])[:, 0]
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
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
    """Share of the stiffness per node: the most even shares with the seat's centre, all positive."""
    rows = np.column_stack([np.ones(len(across_mm)), across_mm])
    shares = np.linalg.lstsq(rows.T, np.array([1.0, 0.0, 0.0]))[0]
    if np.linalg.matrix_rank(rows) < 3 or not (shares > 0).all():
        raise SampleFailure(
            f"the mesh has {len(across_mm)} nodes where the third contact is, not all round it: "
            "expected three at least; take another place or a finer mesh"
        )
    return np.asarray(shares)


def borne_N(truth: TrueRecording) -> float:
    """Largest force on other supports in a recording, N: the pads' resultant."""
    total = np.sum([np.einsum("tij,tnj->ti", p.pose[:, :3, :3], p.force_N) for p in truth.pads], axis=0)
    return float(np.linalg.norm(total, axis=1).max())


def split_pit_stiffness(flesh: BrickFlesh, *, angle_deg: float = 0.0, share: float = 1.0) -> csr_array:
    """Stiffness with two rigid half pits; the second half's six unknowns come last.

    `angle_deg`: angle of the parting plane about the stem's axis z, from x towards y. `share`: relative
    motion of the halves over that without a bond. Below 1 a bond joins them, with (1 / share - 1) times the
    flesh's stiffness between them.
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
    """Bond between the halves: (1 / share - 1) times the stiffness of their relative motion."""
    last = np.arange(free.shape[0] - 12, free.shape[0])
    apart = np.hstack([-np.eye(6), np.eye(6)])
    gives = apart @ factorise(free).compliance(last) @ apart.T
    bond = (1 / share - 1) * apart.T @ np.linalg.inv((gives + gives.T) / 2) @ apart
    rows, columns = np.meshgrid(last, last, indexing="ij")
    return csr_array(coo_array((bond.ravel(), (rows.ravel(), columns.ravel())), shape=free.shape))


def on_a_palm(flesh: BrickFlesh, *, N_per_mm: float, area_radius_mm: float) -> csr_array:
    """Added stiffness of springs along z under the lowest part of the skin."""
    bricks = flesh.bricks
    skin = np.unique(bricks.skin_cells)
    places = bricks.nodes_mm[skin]
    lowest = places[np.argmin(places[:, 2])]
    under = (np.linalg.norm(places[:, :2] - lowest[:2], axis=1) < area_radius_mm) & (places[:, 2] < 0)
    near = skin[under & np.isin(skin, flesh.free_nodes)]
    at = flesh.dofs_of(near)[:, 2]
    values = np.full(len(at), N_per_mm / len(at))
    return csr_array(coo_array((values, (at, at)), shape=(flesh.unknowns, flesh.unknowns)))


THREADS_N_PER_MM = 0.05
"""Total stiffness of weak threads between flesh and loose pit, which keep the flesh in place."""
PENALTY_PER_MM = 25.0
"""Contact stiffness per area over E, 1/mm: at pressure p a closed gap yields by p / (25 E) mm."""


def loose_compliance(
    flesh: BrickFlesh, skin_dofs: Int[np.ndarray, " d"], *, extra: csr_array | None = None
) -> SkinCompliance:
    """Compliance of the skin's unknowns, then of the opening of every pit node.

    `extra`: added stiffness on the flesh's unknowns, with bonded pit nodes (a skin).
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
    """Contact of the pit's surface: a stiff frictionless bed at `gap_mm`."""
    modulus = Lame(mu=flesh.mu_MPa, lam=flesh.lam_MPa).modulus
    _, areas = _normals(flesh)
    return InnerContact(gap_mm=gap_mm, N_per_mm=PENALTY_PER_MM * modulus * areas)


def _normals(flesh: BrickFlesh) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, " p"]]:
    """Outward unit normals of the pit's opening nodes, and the area that each represents, mm²."""
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
    """Nodes of the pit with unknowns once it is loose: all but hanging ones."""
    if bricks.follows is None:
        return bricks.pit_nodes
    return np.asarray(bricks.pit_nodes[bricks.follows.diagonal()[bricks.pit_nodes] == 1.0])


def _pit_quads(flesh: BrickFlesh) -> Int[np.ndarray, "k 4"]:
    """Four small outward quadrilaterals per innermost cell."""
    bricks = flesh.bricks
    inner = bricks.cells[np.all(np.isin(bricks.cells[:, :9], bricks.pit_nodes), axis=1), :9].reshape(-1, 3, 3)
    quads = [
        np.stack([inner[:, i, j], inner[:, i + 1, j], inner[:, i + 1, j + 1], inner[:, i, j + 1]], axis=1)
        for i in (0, 1)
        for j in (0, 1)
    ]
    return np.concatenate(quads)


def _motion_off_pit(flesh: BrickFlesh) -> coo_array:
    """Displacement of the flesh relative to the pit at each node: along the normal and two tangents."""
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
