"""Places on the skin: a nine-node cell and two coordinates in it, found from above and read off again."""

import numpy as np
from jaxtyping import Float, Int

from samples.hexahedra import lagrange

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
