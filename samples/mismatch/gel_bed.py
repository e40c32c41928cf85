"""A gel pad as a bed of springs, each anchored to the skin point that it met.

Every gel point X carries the traction of samples.gel_contact: its pressure is kn times depth. Its shear is kt
times the sideways motion of the skin point x that it met, at most friction times pressure. A free gel point
is projected along z to the skin. It keeps the skin point that passes the gel's face.
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
"""Nearest cells tried for a point: those around a corner of the mesh, and two to spare."""
EDGE = 1.0 + 1e-6
"""Largest coordinate of a point in a cell, whose edge is at 1, with rounding errors."""


def weights(at: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 9"]:
    """Shape functions of a cell's nine nodes at the coordinates `at` (-1 to 1)."""
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
    """Coordinates at which each cell, projected along z, covers its target, by Newton's method from `at`."""
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
    """Cell and coordinates that cover each target, starting from an earlier solution (cell -1: none).

    The cell is -1 if no cell covers a target.
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
"""Gel points along each side of a skin cell. With 3 or 6, markers change by less than 0.1 um and a pad's
force by less than 0.02 %."""
CLOSE_MM, SPACE_MM = 0.1, 1.0
"""Searched gel points lie within a radius: that of the farthest node with z < CLOSE_MM, plus SPACE_MM."""


@dataclass(frozen=True, kw_only=True)
class Bed:
    """Gel points of one pad (pad frame) and the gel area of each; the markers come last, with no area.

    `marker_area_mm2`: area of the square of gel that a marker represents.
    """

    points_mm: Float[np.ndarray, "g 2"]
    areas_mm2: Float[np.ndarray, " g"]
    markers: int
    marker_area_mm2: float


def bed_of(sensor: MarkerSensor, skin_mm: Float[np.ndarray, "n 3"], cells: Int[np.ndarray, "k 9"]) -> Bed:
    """Gauss points of the skin's cells that face the gel (pad frame, mm), then the markers.

    Skin meets the gel nearly along z, so that integrals over the gel are integrals over whole cells. A grid
    that the cells' edges cut at random would distribute pressure wrongly to a cell's nodes. A grid of 0.5 mm
    on cells of 1 mm put 1 to 2 um of waves on the markers.
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
    """Skin point of each gel point: cell (-1: no skin above), coordinates, and whether it touches."""

    cell: Int[np.ndarray, " g"]
    at: Float[np.ndarray, "g 2"]
    touching: Bool[np.ndarray, " g"]


def nothing_held(bed: Bed) -> Held:
    """The state before the first touch."""
    count = len(bed.points_mm)
    return Held(cell=np.full(count, -1), at=np.zeros((count, 2)), touching=np.zeros(count, dtype=bool))


def looked_up(
    bed: Bed, held: Held, cells: Int[np.ndarray, "k 9"], was: Float[np.ndarray, "n 3"],
    now: Float[np.ndarray, "n 3"],
) -> Held:  # fmt: skip
    """Free points with the skin above them; if the skin passed one since `was`, with the point of passage.

    `was`, `now`: the skin's nodes in the pad frame, before and now.
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
    """Interpolation from skin nodes: `points` with skin above them, and `shares` (points x nodes).

    `stuck`: points that the skin has touched and not yet left, if the gel adheres.
    """

    points: Int[np.ndarray, " s"]
    shares: csr_array
    anchors_mm: Float[np.ndarray, "s 2"]
    areas_mm2: Float[np.ndarray, " s"]
    stuck: Bool[np.ndarray, " s"] | None


def link_of(gel: Gel, bed: Bed, held: Held, cells: Int[np.ndarray, "k 9"], nodes: int) -> Link:
    """The interpolation from skin nodes to gel points at the places in `held`."""
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
    """`held` after points beyond the gel's reach have detached; None if none has."""
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
    """`held` after a converged step; points beyond the friction cone slide along the skin.

    Raises NotInEquilibrium if a point slides past the cells of the patch.
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
    """Displacement of markers (mm) and force on their squares of gel (N), pad frame; zero without contact."""
    position = np.asarray(link.shares @ now)
    force, _ = traction(gel, position, link.anchors_mm, link.stuck)
    load = np.zeros((len(bed.points_mm), 3))
    load[link.points] = force
    load = load[-bed.markers :]
    stiffness = np.array([gel.kt_MPa_per_mm, gel.kt_MPa_per_mm, gel.kn_MPa_per_mm])
    return -load / stiffness, bed.marker_area_mm2 * load
