"""A pit that is two rigid halves, parted by a plane through the stem's axis, that move each for itself."""

import numpy as np
from scipy.sparse import coo_array, csr_array

from fem.sparse.solver import factorise
from samples.brick_flesh import HOLDING, BrickFlesh, assembled, rigid_tie


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
