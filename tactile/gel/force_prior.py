"""The Gaussian prior of forces on a gel's face, and the smooth fields that go with them.

    Q = (1 + roughness^2 Laplacian) / sd^2

on each component of the nodal forces, and a spread of the grid's `smooth_share` times the frame's motion on
the coefficients of displacement that no force makes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from tactile.gel.grid import GelGrid, with_smooth

LEAST_MOTION_MM, USUAL_MOTION_MM = 0.1, 0.5
"""Largest displacement of a frame, mm: at least this for the smooth field, and that of a usual press."""


@dataclass(frozen=True, kw_only=True)
class PriorHyperparameters:
    """The prior: spread of pressure and of shear (MPa), roughness (pitches); noise over that in the air."""

    pressure_MPa: float
    shear_MPa: float
    roughness: float
    noise: float


INITIAL_HYPERPARAMETERS = PriorHyperparameters(pressure_MPa=0.03, shear_MPa=0.01, roughness=1.0, noise=2.0)
"""Where the search for the prior starts: a usual press, node by node as noisy as twice what frames say. Set
by hand."""


def prior_precision(grid: GelGrid, hyperparameters: PriorHyperparameters) -> Float[np.ndarray, "d d"]:
    """Q of the nodal forces, 1/N^2; node by node x, y and z."""
    m = len(grid.nodes_mm)
    smooth = np.eye(m) + hyperparameters.roughness**2 * grid.laplacian
    area = grid.pitch_mm**2
    out = np.zeros((m, 3, m, 3))
    for k, sd in enumerate(
        (hyperparameters.shear_MPa, hyperparameters.shear_MPa, hyperparameters.pressure_MPa)
    ):
        out[:, k, :, k] = smooth / (sd * area) ** 2
    return out.reshape(3 * m, 3 * m)


def displacement_by(grid: GelGrid) -> Float[np.ndarray, "d u"]:
    """Marker displacement (mm) by nodal forces (N) and the smooth fields."""
    return with_smooth(grid, grid.compliance, grid.rest_mm[:, :2])


def motion_of(y: Float[np.ndarray, "n 3"]) -> float:
    """The largest displacement of a frame, mm, and LEAST_MOTION_MM at least."""
    return max(float(np.linalg.norm(y, axis=1).max()), LEAST_MOTION_MM)


def smooth_precision(grid: GelGrid, motion_mm: float) -> Float[np.ndarray, " s"]:
    """Of the smooth fields' coefficients, in a frame of this motion."""
    return np.tile(1.0 / (grid.smooth_share * motion_mm) ** 2, 6)


def dofs_of(touching: Bool[np.ndarray, " m"]) -> Int[np.ndarray, " d"]:
    """Unknowns of the touching nodes: three each."""
    return np.asarray((3 * np.flatnonzero(touching)[:, None] + np.arange(3)).ravel())
