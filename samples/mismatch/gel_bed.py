"""A gel pad as a bed of springs, each held by the skin point it met: contact followed from the gel's side.

Every gel point X carries the traction of samples.gel_contact: pressure kn times depth, shear kt times how
far the skin point x that it met has moved aside, and no more shear than friction times pressure. A gel
point that is free looks straight up at the skin; what it sees when the skin comes through the gel's face,
it keeps.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array

from samples.gel_contact import Gel, traction
from samples.hexahedra import lagrange
from samples.mismatch.marker_sensor import MarkerSensor
from samples.sample_failure import NotInEquilibrium

NEAREST_CELLS = 6
"""Cells that are tried for a point: those round a corner of the mesh, and two to spare."""
EDGE = 1.0 + 1e-6
"""Of a cell's coordinates, which end at 1, with rounding errors."""


def weights(at: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 9"]:
    """Shares of a cell's nine nodes at the coordinates `at` (-1 to 1)."""
    (a, _), (b, _) = lagrange(at[:, 0]), lagrange(at[:, 1])
    return np.asarray((a[:, :, None] * b[:, None, :]).reshape(-1, 9))


def _slopes(at: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2 9"]:
    (a, da), (b, db) = lagrange(at[:, 0]), lagrange(at[:, 1])
    first = (da[:, :, None] * b[:, None, :]).reshape(-1, 9)
    second = (a[:, :, None] * db[:, None, :]).reshape(-1, 9)
    return np.stack([first, second], axis=1)


def settle_in_cell(
    corners: Float[np.ndarray, "n 9 2"], target: Float[np.ndarray, "n 2"], at: Float[np.ndarray, "n 2"],
    *, rounds: int = 6,
) -> Float[np.ndarray, "n 2"]:  # fmt: skip
    """Coordinates at which each cell (its nodes seen from above) covers its target, by Newton from `at`."""
    place = at
    for _ in range(rounds):
        miss = target - np.einsum("na,nac->nc", weights(place), corners)
        if np.abs(miss).max(initial=0.0) < 1e-10:
            break
        slope = np.einsum("nia,nac->nci", _slopes(place), corners)
        det = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
        det = np.where(np.abs(det) < 1e-9, np.inf, det)
        first = (slope[:, 1, 1] * miss[:, 0] - slope[:, 0, 1] * miss[:, 1]) / det
        second = (slope[:, 0, 0] * miss[:, 1] - slope[:, 1, 0] * miss[:, 0]) / det
        place = np.clip(place + np.stack([first, second], axis=1), -2.5, 2.5)
    return place


def seen_from_above(
    nodes: Float[np.ndarray, "n 2"],
    cells: Int[np.ndarray, "k 9"],
    target: Float[np.ndarray, "m 2"],
    cell: Int[np.ndarray, " m"],
    at: Float[np.ndarray, "m 2"],
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"]]:
    """The cell and coordinates that cover each target, starting from an earlier place (cell -1: none).

    Where no cell covers a target, the cell comes back as -1.
    """
    cell, at = cell.copy(), at.copy()
    known = np.flatnonzero(cell >= 0)
    at[known] = settle_in_cell(nodes[cells[cell[known]]], target[known], at[known])
    lost = np.ones(len(target), dtype=bool)
    lost[known] = np.abs(at[known]).max(axis=1, initial=0.0) > EDGE
    lost = np.flatnonzero(lost)
    if len(lost) == 0:
        return cell, at
    middle = nodes[cells[:, 4]]
    away = ((target[lost][:, None] - middle) ** 2).sum(axis=-1)
    choices = np.argsort(away, axis=1)[:, :NEAREST_CELLS]
    best = np.full(len(lost), EDGE)
    cell[lost] = -1
    for choice in choices.T:
        place = settle_in_cell(nodes[cells[choice]], target[lost], np.zeros((len(lost), 2)), rounds=8)
        miss = target[lost] - np.einsum("na,nac->nc", weights(place), nodes[cells[choice]])
        reach = np.abs(place).max(axis=1)
        better = (reach <= best) & (np.abs(miss).max(axis=1) < 1e-6)
        cell[lost[better]], at[lost[better]], best[better] = choice[better], place[better], reach[better]
    return cell, at


POINTS = 4
"""Gel points along each side of a skin cell: 3 or 6 change markers by less than 0.1 um and a pad's force by
less than 0.02 %."""
CLOSE_MM, SPACE_MM = 0.1, 1.0
"""Only gel points this near to skin this low look up."""


@dataclass(frozen=True, kw_only=True)
class Bed:
    """Gel points of one pad (pad frame), the gel area of each (mm^2); the markers come last, with none.

    `marker_area_mm2`: of the square of gel that a marker stands for.
    """

    points_mm: Float[np.ndarray, "g 2"]
    areas_mm2: Float[np.ndarray, " g"]
    markers: int
    marker_area_mm2: float


def bed_of(sensor: MarkerSensor, skin_mm: Float[np.ndarray, "n 3"], cells: Int[np.ndarray, "k 9"]) -> Bed:
    """Gauss points of the skin's cells as they face the gel (pad frame, mm), then the markers.

    Skin meets the gel nearly straight, so that integrals over the gel are integrals over whole cells: a grid
    of points that the cells' borders cut at random spreads pressure on a cell's nodes by wrong shares (a grid
    of 0.5 mm on cells of 1 mm put 1 to 2 um of waves on the markers).
    """
    at, weight = np.polynomial.legendre.leggauss(POINTS)
    (value, slope), corners = lagrange(at), skin_mm[cells, :2].reshape(-1, 3, 3, 2)
    places = np.einsum("pi,qj,kijc->kpqc", value, value, corners).reshape(-1, 2)
    first = np.einsum("pi,qj,kijc->kpqc", slope, value, corners).reshape(-1, 2)
    second = np.einsum("pi,qj,kijc->kpqc", value, slope, corners).reshape(-1, 2)
    size = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    areas = size * np.tile(np.outer(weight, weight).ravel(), len(cells))
    inside = np.abs(places).max(axis=1) <= sensor.half_width_mm
    rest = sensor.rest_mm[:, :2]
    return Bed(
        points_mm=np.concatenate([places[inside], rest]),
        areas_mm2=np.concatenate([areas[inside], np.zeros(len(rest))]),
        markers=len(rest),
        marker_area_mm2=sensor.pitch_mm**2,
    )


@dataclass(frozen=True, kw_only=True)
class Held:
    """Where on the skin each gel point is: cell (-1: no skin above), coordinates, and whether it touches."""

    cell: Int[np.ndarray, " g"]
    at: Float[np.ndarray, "g 2"]
    touching: Bool[np.ndarray, " g"]


def nothing_held(bed: Bed) -> Held:
    """Before the first touch."""
    count = len(bed.points_mm)
    return Held(cell=np.full(count, -1), at=np.zeros((count, 2)), touching=np.zeros(count, dtype=bool))


def looked_up(
    bed: Bed, held: Held, cells: Int[np.ndarray, "k 9"], was: Float[np.ndarray, "n 3"],
    now: Float[np.ndarray, "n 3"],
) -> Held:  # fmt: skip
    """Free points find the skin above them; one that the skin came through since `was`, where it did so.

    `was`, `now`: the skin's nodes in the pad frame then and now.
    """
    close = np.linalg.norm(now[now[:, 2] < CLOSE_MM, :2], axis=1).max(initial=0.0) + SPACE_MM
    if close == SPACE_MM:
        return held
    free = np.flatnonzero(~held.touching & (np.linalg.norm(bed.points_mm, axis=1) < close))
    target = bed.points_mm[free]
    cell, at = seen_from_above(now[:, :2], cells, target, held.cell[free], held.at[free])
    seen = np.flatnonzero(cell >= 0)
    shares = weights(at[seen])
    below = np.einsum("na,na->n", shares, now[cells[cell[seen]], 2])
    above = np.einsum("na,na->n", shares, was[cells[cell[seen]], 2])
    through = np.flatnonzero(below < 0)
    if len(through):
        who = seen[through]
        share = np.clip(above[through] / np.maximum(above[through] - below[through], 1e-12), 0.0, 1.0)
        corners = cells[cell[who]]
        crossing = was[corners, :2] + share[:, None, None] * (now[corners, :2] - was[corners, :2])
        at[who] = settle_in_cell(crossing, target[who], at[who])
    all_cell, all_at = held.cell.copy(), held.at.copy()
    all_cell[free], all_at[free] = cell, at
    return Held(cell=all_cell, at=all_at, touching=held.touching)


@dataclass(frozen=True, kw_only=True)
class Link:
    """Gel points tied to skin nodes: `shares` (points x nodes), and the points that have skin above them.

    `stuck`: those that the skin has touched and not yet left, where the gel sticks.
    """

    points: Int[np.ndarray, " s"]
    shares: csr_array
    anchors_mm: Float[np.ndarray, "s 2"]
    areas_mm2: Float[np.ndarray, " s"]
    stuck: Bool[np.ndarray, " s"] | None


def link_of(gel: Gel, bed: Bed, held: Held, cells: Int[np.ndarray, "k 9"], nodes: int) -> Link:
    """The interpolation from skin nodes to gel points for the places that `held` says."""
    points = np.flatnonzero(held.cell >= 0)
    columns = cells[held.cell[points]]
    rows = np.repeat(np.arange(len(points)), 9)
    shares = csr_array(
        (weights(held.at[points]).ravel(), (rows, columns.ravel())), shape=(len(points), nodes)
    )
    return Link(
        points=points,
        shares=shares,
        anchors_mm=bed.points_mm[points],
        areas_mm2=bed.areas_mm2[points],
        stuck=held.touching[points] if gel.reach_mm > 0 else None,
    )


def let_go(gel: Gel, held: Held, link: Link, now: Float[np.ndarray, "n 3"]) -> Held | None:
    """What is held once points drawn out beyond the gel's reach have let go; None where none has."""
    if link.stuck is None:
        return None
    beyond = link.stuck & (np.asarray(link.shares @ now)[:, 2] >= gel.reach_mm)
    if not beyond.any():
        return None
    touching = held.touching.copy()
    touching[link.points[beyond]] = False
    return replace(held, touching=touching)


def after_step(
    gel: Gel, bed: Bed, held: Held, cells: Int[np.ndarray, "k 9"], now: Float[np.ndarray, "n 3"], link: Link
) -> Held:
    """What stays held after a converged step; points past the friction cone are drawn along the skin.

    Raises NotInEquilibrium when skin that no cell of the patch covers would touch.
    """
    position = np.asarray(link.shares @ now)
    touching = np.zeros(len(bed.points_mm), dtype=bool)
    touching[link.points] = (position[:, 2] < 0) | (False if link.stuck is None else link.stuck)
    force, _ = traction(gel, position, link.anchors_mm, link.stuck)
    asked = gel.kt_MPa_per_mm * np.linalg.norm(position[:, :2] - link.anchors_mm, axis=1)
    slips = (position[:, 2] < 0) & (asked > gel.friction * force[:, 2] * (1 + 1e-9))
    after = replace(held, touching=touching)
    if not np.any(slips):
        return after
    who = link.points[slips]
    target = bed.points_mm[who] - force[slips, :2] / gel.kt_MPa_per_mm
    cell, at = seen_from_above(now[:, :2], cells, target, held.cell[who], held.at[who])
    if np.any(cell < 0):
        raise NotInEquilibrium("the contact patch slid past the skin that was meshed for it: press less")
    new_cell, new_at = held.cell.copy(), held.at.copy()
    new_cell[who], new_at[who] = cell, at
    return Held(cell=new_cell, at=new_at, touching=touching)


def marker_values(
    gel: Gel, bed: Bed, link: Link, now: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
    """Shift of every marker (mm) and force on its square of gel (N), pad frame; zero without touch."""
    position = np.asarray(link.shares @ now)
    force, _ = traction(gel, position, link.anchors_mm, link.stuck)
    load = np.zeros((len(bed.points_mm), 3))
    load[link.points] = force
    load = load[-bed.markers :]
    stiffness = np.array([gel.kt_MPa_per_mm, gel.kt_MPa_per_mm, gel.kn_MPa_per_mm])
    return -load / stiffness, bed.marker_area_mm2 * load
