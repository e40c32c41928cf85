"""A gel pad against skin: an elastic layer with Coulomb friction, followed on the moving surface.

The gel is a bed of springs on a rigid face: pressure p = kn depth, shear t = -kt (x - X) where X is the gel
point that a skin point met when it first touched (its anchor), |t| <= friction p; past that the skin slips
and the anchor is dragged along. In the pad frame z points out of the gel, so that a depth is a negative z.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from samples.hexahedra import lagrange


@dataclass(frozen=True, kw_only=True)
class Gel:
    """Normal and shear stiffness per area, friction between gel and skin, and how far the gel is drawn out
    by skin that it has touched before it lets go (0: it does not stick).
    """

    kn_MPa_per_mm: float = 0.22
    kt_MPa_per_mm: float = 0.055
    friction: float = 0.8
    reach_mm: float = 0.0


DEFAULT_GEL = Gel()
"""Of the sample batch."""


@dataclass(frozen=True, kw_only=True)
class Anchors:
    """What the gel remembers of each skin node: its gel point, whether it touches, where it was."""

    gel_point_mm: Float[np.ndarray, "n 2"]
    touching: Bool[np.ndarray, " n"]
    position_mm: Float[np.ndarray, "n 3"]


def untouched(position_mm: Float[np.ndarray, "n 3"]) -> Anchors:
    """Before the first touch."""
    return Anchors(
        gel_point_mm=position_mm[:, :2],
        touching=np.zeros(len(position_mm), dtype=bool),
        position_mm=position_mm,
    )


def gel_points(before: Anchors, position_mm: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """The gel point of every node now: kept while it touches, met on the way in, its own shadow in the air.

    A node that came through the gel's face since `before` is anchored where the straight way crosses it.
    """
    now, was = position_mm[:, 2], before.position_mm[:, 2]
    share = np.clip(was / np.where(np.abs(was - now) < 1e-12, 1.0, was - now), 0.0, 1.0)
    met = before.position_mm[:, :2] + share[:, None] * (position_mm[:, :2] - before.position_mm[:, :2])
    anchor = np.where(before.touching[:, None], before.gel_point_mm, met)
    return np.where((now < 0)[:, None], anchor, position_mm[:, :2])


def traction(
    gel: Gel,
    position_mm: Float[np.ndarray, "n 3"],
    anchor_mm: Float[np.ndarray, "n 2"],
    stuck: Bool[np.ndarray, " n"] | None = None,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
    """Force per gel area on the skin (MPa, pad frame) and its derivative by the position.

    Points that are `stuck` pull, and hold their shear, however far they are.
    """
    n = len(position_mm)
    pressed = position_mm[:, 2] < 0
    inside = pressed if stuck is None else pressed | stuck
    pressure = np.where(inside, -gel.kn_MPa_per_mm * position_mm[:, 2], 0.0)
    trial = -gel.kt_MPa_per_mm * (position_mm[:, :2] - anchor_mm)
    size, limit = np.linalg.norm(trial, axis=1), gel.friction * pressure
    slips = pressed & (size > limit)
    direction = trial / np.maximum(size, 1e-30)[:, None]
    shear = np.where(slips[:, None], limit[:, None] * direction, trial)
    force = np.zeros((n, 3))
    force[:, :2] = np.where(inside[:, None], shear, 0.0)
    force[:, 2] = pressure
    slope = np.zeros((n, 3, 3))
    slope[inside, 2, 2] = -gel.kn_MPa_per_mm
    stiff = np.where(slips, limit / np.maximum(size, 1e-30), 1.0)[:, None, None] * np.eye(2)
    ring = np.where(slips, limit / np.maximum(size, 1e-30), 0.0)[:, None, None]
    block = -gel.kt_MPa_per_mm * (stiff - ring * direction[:, :, None] * direction[:, None, :])
    slope[:, :2, :2] = np.where(inside[:, None, None], block, 0.0)
    drag = -gel.friction * gel.kn_MPa_per_mm * direction
    slope[:, :2, 2] = np.where(slips[:, None], drag, 0.0)
    return force, slope


def slid_anchors(gel: Gel, before: Anchors, position_mm: Float[np.ndarray, "n 3"]) -> Anchors:
    """The anchors after a converged step: those of slipping nodes are dragged along."""
    anchor = gel_points(before, position_mm)
    force, _ = traction(gel, position_mm, anchor)
    touching = position_mm[:, 2] < 0
    dragged = position_mm[:, :2] + force[:, :2] / gel.kt_MPa_per_mm
    return Anchors(
        gel_point_mm=np.where(touching[:, None], dragged, position_mm[:, :2]),
        touching=touching,
        position_mm=position_mm,
    )


_AT_NODES = lagrange(np.array([-1.0, 0.0, 1.0]))
"""Quadratic shape functions at their own three nodes."""
_SIMPSON = np.array([1.0, 4.0, 1.0]) / 3.0
"""Weights of Simpson's rule on [-1, 1]."""


def gel_areas(
    gel_point_mm: Float[np.ndarray, "n 2"], cells: Int[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, " n"]:
    """How much gel (mm^2) each node stands for: Simpson's rule over the nine-node cells."""
    _, slope = _AT_NODES
    corner = gel_point_mm[cells]
    along = np.einsum("pi,kijc->kpjc", slope, corner)
    across = np.einsum("qj,kijc->kiqc", slope, corner)
    # seen from the gel the skin's cells turn the other way round
    area = -(along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0])
    area = np.maximum(area, 0.0) * _SIMPSON[:, None] * _SIMPSON
    return np.bincount(cells.ravel(), area.ravel(), minlength=len(gel_point_mm))


def at_markers(
    rest_mm: Float[np.ndarray, "m 2"],
    gel_point_mm: Float[np.ndarray, "n 2"],
    values: Float[np.ndarray, "n c"],
    cells: Int[np.ndarray, "k 3 3"],
) -> Float[np.ndarray, "m c"]:
    """Nodal values seen at gel points `rest_mm`, through the nine-node cells' own functions (Newton).

    A marker that no cell covers gets NaN.
    """
    middle = gel_point_mm[cells[:, 1, 1]]
    nearest = np.argsort(((rest_mm[:, None] - middle) ** 2).sum(-1), axis=1)[:, :14]
    out = np.full((len(rest_mm), values.shape[1]), np.nan)
    best = np.full(len(rest_mm), 1.02)
    for choice in nearest.T:
        sought = np.flatnonzero(best >= 1)  # not yet found inside a cell
        if not len(sought):
            break
        held = cells[choice[sought]]
        place, miss = _place_in_cell(rest_mm[sought], gel_point_mm[held])
        (a, _), (b, _) = lagrange(place[:, 0]), lagrange(place[:, 1])
        reach = np.abs(place).max(axis=1)
        better = (miss < 1e-6) & (reach < best[sought])
        found = sought[better]
        out[found] = np.einsum("mi,mj,mijc->mc", a[better], b[better], values[held[better]])
        best[found] = reach[better]
    return out


def _place_in_cell(
    point_mm: Float[np.ndarray, "m 2"], corner_mm: Float[np.ndarray, "m 3 3 2"]
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
    """Where in its cell each point is, from -1 to 1 (clipped at twice that), and how far off that is, mm."""
    place = np.zeros((len(point_mm), 2))
    for _ in range(12):
        (a, da), (b, db) = lagrange(place[:, 0]), lagrange(place[:, 1])
        miss = point_mm - np.einsum("mi,mj,mijc->mc", a, b, corner_mm)
        slope = np.stack(
            [np.einsum("mi,mj,mijc->mc", da, b, corner_mm), np.einsum("mi,mj,mijc->mc", a, db, corner_mm)],
            axis=-1,
        )
        regular = np.abs(np.linalg.det(slope)) > 1e-9
        slope[~regular] = np.eye(2)
        moved = np.clip(place + np.linalg.solve(slope, miss[..., None])[..., 0], -2.0, 2.0)
        largest = np.abs(moved - place).max()
        place = moved
        if largest < 1e-13:
            break
    (a, _), (b, _) = lagrange(place[:, 0]), lagrange(place[:, 1])
    return place, np.linalg.norm(point_mm - np.einsum("mi,mj,mijc->mc", a, b, corner_mm), axis=1)
