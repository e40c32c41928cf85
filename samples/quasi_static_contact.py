"""One fruit between two gel pads, step by step, every step in equilibrium at finite strain.

The flesh's linear compliance of all nodes that a pad can reach is computed once; a step then alternates
between the contact (semi-smooth Newton on that small dense compliance) and what finite strain adds (one
residual and two solves with the factorised linear stiffness), sped up by Anderson mixing, until the whole
residual is small.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from samples.anderson_mixing import AndersonMixing
from samples.brick_flesh import BrickFlesh
from samples.factors import Solve, factorise
from samples.gel_contact import Anchors, Gel, gel_areas, gel_points, slid_anchors, traction, untouched
from samples.sample_failure import NotInEquilibrium

REACH_MM = 9.9
"""From a pad's middle, mm: skin farther out would leave the gel of 20 mm."""
TOLERANCE = 3e-5
"""Unbalanced force over the pads' force: 0.003 %, hundreds of times less than a force's noise."""

DEPTH = 6
"""Earlier rounds of a step that are mixed (set by hand)."""


@dataclass(frozen=True, kw_only=True)
class Face:
    """The skin in front of one pad: its nodes, those the pad can reach, its cells (local numbers)."""

    turn: Float[np.ndarray, "3 3"]
    nodes: Int[np.ndarray, " n"]
    reachable: Int[np.ndarray, " r"]
    cells: Int[np.ndarray, "k 3 3"]


@dataclass(frozen=True, kw_only=True)
class QuasiStaticContact:
    """Everything that stays the same over a recording."""

    flesh: BrickFlesh
    gels: tuple[Gel, ...]
    faces: tuple[Face, ...]
    solve: Solve
    dofs: Int[np.ndarray, "r 3"]
    compliance: Float[np.ndarray, "c c"]


@dataclass(frozen=True, kw_only=True)
class LoadStep:
    """One instant in equilibrium; per face the anchors and the nodal force on the skin (fruit frame, N)."""

    q: Float[np.ndarray, " u"]
    anchors: tuple[Anchors, ...]
    force_N: tuple[Float[np.ndarray, "_n 3"], ...]
    residual: float


def quasi_static_contact(
    flesh: BrickFlesh,
    gels: tuple[Gel, ...],
    turns: tuple[Float[np.ndarray, "3 3"], ...],
    origins: Float[np.ndarray, "p 3"],
) -> QuasiStaticContact:
    """Prepare: faces in front of pads with the given rotations (pad to fruit) that point at `origins`."""
    bricks = flesh.bricks
    faces = []
    for turn, origin in zip(turns, origins, strict=True):
        local = (bricks.nodes_mm - origin) @ turn
        centre = local[bricks.skin_cells[:, 1, 1]]
        corners = local[bricks.skin_cells]
        normal = np.cross(corners[:, 2, 1] - corners[:, 0, 1], corners[:, 1, 2] - corners[:, 1, 0])
        near = (np.abs(centre[:, :2]).max(axis=1) < 17.0) & (
            normal[:, 2] < -0.3 * np.linalg.norm(normal, axis=1)
        )
        nodes, cells = np.unique(bricks.skin_cells[near], return_inverse=True)
        reachable = np.flatnonzero(np.linalg.norm(local[nodes, :2], axis=1) < REACH_MM)
        faces.append(Face(turn=turn, nodes=nodes, reachable=reachable, cells=cells.reshape(-1, 3, 3)))
    number = np.full(len(bricks.nodes_mm), -1)
    number[flesh.free_nodes] = np.arange(len(flesh.free_nodes))
    touched = np.concatenate([number[f.nodes[f.reachable]] for f in faces])
    dofs = 3 * touched[:, None] + np.arange(3)
    solve = factorise(flesh.stiffness)
    flat = dofs.ravel()
    columns = []
    for part in np.array_split(np.arange(len(flat)), max(1, len(flat) // 150)):
        unit = np.zeros((flesh.unknowns, len(part)))
        unit[flat[part], np.arange(len(part))] = 1.0
        columns.append(solve(unit)[flat])
    compliance = np.concatenate(columns, axis=1)
    return QuasiStaticContact(
        flesh=flesh, gels=gels, faces=tuple(faces), solve=solve, dofs=dofs, compliance=compliance
    )


def at_rest(contact: QuasiStaticContact, origins: Float[np.ndarray, "p 3"]) -> LoadStep:
    """The load step before anything touches."""
    q = np.zeros(contact.flesh.unknowns)
    places = _positions(contact, q, origins)
    return LoadStep(
        q=q,
        anchors=tuple(untouched(x) for x in places),
        force_N=tuple(np.zeros_like(x) for x in places),
        residual=0.0,
    )


def step(
    contact: QuasiStaticContact, before: LoadStep, origins: Float[np.ndarray, "p 3"], *, rounds: int = 60
) -> LoadStep:
    """The next load step, with the pads' faces at `origins` (fruit frame, mm).

    Raises NotInEquilibrium when `rounds` rounds leave more than TOLERANCE of the force unbalanced, or
    when the patch leaves the pad. A step that is too long for the alternation may do so too: take it in two.
    """
    flesh = contact.flesh
    rest = np.zeros(flesh.unknowns)
    if not np.any(_forces(contact, rest, origins, *_lagged(contact, before, rest, origins))):
        return _finished(contact, before, rest, origins, 0.0)
    q, history = before.q.copy(), AndersonMixing(DEPTH)
    residual = np.inf
    for _ in range(rounds):
        excess = flesh.excess(q)
        freely = -contact.solve(excess)
        anchors, areas = _lagged(contact, before, q, origins)
        loads = _contact(contact, freely, origins, anchors, areas, start=q)
        mapped = freely + contact.solve(_spread(contact, loads))
        forces = _forces(contact, mapped, origins, *_lagged(contact, before, mapped, origins))
        balance = flesh.stiffness @ mapped + flesh.excess(mapped) - _spread(contact, forces)
        size = max(float(np.linalg.norm(forces)), 1e-3)
        residual = float(np.linalg.norm(balance)) / size
        if residual < TOLERANCE:
            return _finished(contact, before, mapped, origins, residual)
        if not residual < 1e3:
            break
        q = history.mixed(q, mapped)
    raise NotInEquilibrium(f"the step stopped at a residual of {residual:.1e} of the contact force")


def _positions(
    contact: QuasiStaticContact, q: Float[np.ndarray, " u"], origins: Float[np.ndarray, "p 3"]
) -> list[Float[np.ndarray, "_n 3"]]:
    now = contact.flesh.bricks.nodes_mm + contact.flesh.displacement(q)
    return [(now[f.nodes] - o) @ f.turn for f, o in zip(contact.faces, origins, strict=True)]


def _lagged(
    contact: QuasiStaticContact,
    before: LoadStep,
    q: Float[np.ndarray, " u"],
    origins: Float[np.ndarray, "p 3"],
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    anchors, areas = [], []
    for face, held, x in zip(contact.faces, before.anchors, _positions(contact, q, origins), strict=True):
        anchor = gel_points(held, x)
        anchors.append(anchor)
        areas.append(gel_areas(anchor, face.cells))
    return anchors, areas


def _forces(
    contact: QuasiStaticContact,
    q: np.ndarray,
    origins: np.ndarray,
    anchors: list[np.ndarray],
    areas: list[np.ndarray],
) -> Float[np.ndarray, "r 3"]:
    """Force on every reachable node, fruit frame."""
    found = []
    places = _positions(contact, q, origins)
    for face, gel, x, anchor, area in zip(contact.faces, contact.gels, places, anchors, areas, strict=True):
        load, _ = traction(gel, x, anchor)
        found.append((load * area[:, None])[face.reachable] @ face.turn.T)
    return np.concatenate(found)


def _contact(
    contact: QuasiStaticContact,
    freely: np.ndarray,
    origins: np.ndarray,
    anchors: list[np.ndarray],
    areas: list[np.ndarray],
    *,
    start: np.ndarray,
) -> Float[np.ndarray, "r 3"]:
    """Solve u = freely + C f(u) for the reachable nodes; returns f. Semi-smooth Newton with halved steps."""
    base = contact.flesh.bricks.nodes_mm
    rest, turns, feet, area = [], [], [], []
    for face, origin, anchor, a in zip(contact.faces, origins, anchors, areas, strict=True):
        r = face.reachable
        rest.append(base[face.nodes[r]] - origin)
        turns.append(np.broadcast_to(face.turn, (len(r), 3, 3)))
        feet.append(anchor[r])
        area.append(a[r])
    at, turn = np.concatenate(rest), np.concatenate(turns)
    foot, weight = np.concatenate(feet), np.concatenate(area)
    ends = np.cumsum([0, *(len(own) for own in rest)])
    sides = [slice(start, end) for start, end in pairwise(ends)]

    def load(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = np.einsum("ni,nij->nj", at + u, turn)
        each = [traction(gel, x[part], foot[part]) for gel, part in zip(contact.gels, sides, strict=True)]
        force, slope = (np.concatenate([own[k] for own in each]) for k in (0, 1))
        force = np.einsum("nij,nj->ni", turn, force) * weight[:, None]
        return force, np.einsum("nij,njk,nlk->nil", turn, slope, turn) * weight[:, None, None]

    given = freely[contact.dofs]
    u = start[contact.dofs]
    force, slope = load(u)
    miss = u - given - (contact.compliance @ force.ravel()).reshape(-1, 3)
    for _ in range(40):
        if np.abs(miss).max() < 1e-10:
            break
        active = np.flatnonzero(np.abs(slope).max(axis=(1, 2)) > 0)
        move = -miss
        if len(active):
            block = (3 * active[:, None] + np.arange(3)).ravel()
            small = contact.compliance[np.ix_(block, block)]
            product = np.einsum("anj,njk->ank", small.reshape(len(block), -1, 3), slope[active])
            inner = np.linalg.solve(
                np.eye(len(block)) - product.reshape(len(block), -1), -miss[active].ravel()
            ).reshape(-1, 3)
            pushed = np.einsum("nij,nj->ni", slope[active], inner)
            move = -miss + (contact.compliance[:, block] @ pushed.ravel()).reshape(-1, 3)
        best = np.linalg.norm(miss)
        for share in (1.0, 0.5, 0.25, 0.125):
            trial = u + share * move
            force, slope = load(trial)
            left = trial - given - (contact.compliance @ force.ravel()).reshape(-1, 3)
            if np.linalg.norm(left) < best:
                break
        u, miss = trial, left
    return force


def _spread(contact: QuasiStaticContact, loads: Float[np.ndarray, "r 3"]) -> Float[np.ndarray, " u"]:
    full = np.zeros(contact.flesh.unknowns)
    np.add.at(full, contact.dofs.ravel(), loads.ravel())
    return full


def _finished(
    contact: QuasiStaticContact, before: LoadStep, q: np.ndarray, origins: np.ndarray, residual: float
) -> LoadStep:
    anchors, forces = [], []
    places = _positions(contact, q, origins)
    for face, gel, held, x in zip(contact.faces, contact.gels, before.anchors, places, strict=True):
        anchor = gel_points(held, x)
        load, _ = traction(gel, x, anchor)
        force = load * gel_areas(anchor, face.cells)[:, None]
        beyond_reach = np.ones(len(x), dtype=bool)
        beyond_reach[face.reachable] = False
        if np.any(force[beyond_reach]):
            raise NotInEquilibrium("the contact patch grew past the pad: close less or move the pads")
        anchors.append(slid_anchors(gel, held, x))
        forces.append(force @ face.turn.T)
    return LoadStep(q=q, anchors=tuple(anchors), force_N=tuple(forces), residual=residual)
