"""The Gaussian prior of forces on a gel's face, and the smooth fields that go with them.

    Q = (1 + roughness^2 Laplacian) / sd^2

on each component of the nodal forces, and a spread of the grid's `smooth_share` times the frame's motion on
the coefficients of displacement that no force makes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import cholesky

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
    smooth = _smoothness(grid, hyperparameters)
    out = np.zeros((m, 3, m, 3))
    for k, scale in enumerate(_scales(grid, hyperparameters)):
        out[:, k, :, k] = smooth * scale
    return out.reshape(3 * m, 3 * m)


class PriorDeterminant:
    """ln det of Q of some nodes."""

    def __init__(self, grid: GelGrid, hyperparameters: PriorHyperparameters) -> None:
        self._smooth = _smoothness(grid, hyperparameters)
        self._log_scale = float(np.log(_scales(grid, hyperparameters)).sum())

    def __call__(self, nodes: Int[np.ndarray, " k"]) -> float:
        """0 of none."""
        if not len(nodes):
            return 0.0
        root = cholesky(self._smooth[np.ix_(nodes, nodes)], lower=True, check_finite=False)
        return float(6.0 * np.log(np.diag(root)).sum() + len(nodes) * self._log_scale)


def _smoothness(grid: GelGrid, hyperparameters: PriorHyperparameters) -> Float[np.ndarray, "m m"]:
    return np.asarray(np.eye(len(grid.nodes_mm)) + hyperparameters.roughness**2 * grid.laplacian)


def _scales(grid: GelGrid, hyperparameters: PriorHyperparameters) -> Float[np.ndarray, "3"]:
    """1 over the variance of one node's force along x, y and z, 1/N^2."""
    sd_MPa = np.array([hyperparameters.shear_MPa, hyperparameters.shear_MPa, hyperparameters.pressure_MPa])
    return np.asarray((sd_MPa * grid.pitch_mm**2) ** -2.0)


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
