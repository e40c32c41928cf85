"""Unknowns of the inverse problem for a gel's forces, and their Gaussian prior.

The unknowns are forces at traction nodes on the face, and coefficients of smooth displacement fields that no
force causes. The precision of each component of the nodal forces is

    Q = (1 + roughness^2 Laplacian) / sd^2

The coefficients' standard deviation is the grid's `smooth_share` times the frame's largest displacement.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, cKDTree

from tactile.gel.slab import GelSlab, tent_compliance

SIDES_UNKNOWN, SIDES_KNOWN = np.array([0.02, 0.02, 0.005]), np.array([0.002, 0.002, 0.0005])
"""Standard deviation of smooth fields' coefficients over the frame's largest displacement, x, y and z. Free
sides three thicknesses away cause 0.03 and 0.007. If the outline is known, a tenth remains for other
deviations from a slab (`benchmarks/gel_image_errors.py`)."""
NODE_PER_MARKER = 0.7
"""Spacing of nodes over that of markers: slightly finer, since the prior smooths. Set by hand."""
LEAST_MOTION_MM, USUAL_MOTION_MM = 0.1, 0.5
"""Least value of a frame's largest displacement for the smooth fields, and its value in a usual press, mm."""


@dataclass(frozen=True, kw_only=True)
class GelGrid:
    """Markers and traction nodes of one gel. `compliance`: marker displacement (mm) per nodal force (N).

    Forces act on the fruit, so a positive normal force goes with a negative displacement. `to_markers` maps
    nodal forces to marker forces: traction times a marker's cell `cell_mm2`, with the same sum and moment.
    `smooth_share`: standard deviation of the smooth fields' coefficients over a frame's largest displacement,
    x, y and z.
    """

    rest_mm: Float[np.ndarray, "n 3"]
    nodes_mm: Float[np.ndarray, "m 2"]
    pitch_mm: float
    cell_mm2: float
    compliance: Float[np.ndarray, "3*n 3*m"]
    smooth_share: Float[np.ndarray, "3"]
    to_markers: Float[np.ndarray, "n m"]
    laplacian: Float[np.ndarray, "m m"]


def gel_grid(layer: GelSlab, rest_mm: Float[np.ndarray, "n 3"]) -> GelGrid:
    """Traction nodes on a square grid among the markers.

    Their pitch is 0.7 times the side of a square as large as a marker's cell. A factor of 1.0 resolves the
    rim of a contact too coarsely: computed forces are 2 to 5 % too large. Raises ValueError for fewer than
    nine markers.
    """
    if len(rest_mm) < 9:
        raise ValueError(f"a force field needs nine markers; there are {len(rest_mm)}")
    flat = rest_mm[:, :2]
    mesh = Delaunay(flat)
    a, b, c = (flat[mesh.simplices[:, k]] for k in range(3))
    twice = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    cell_mm2 = float(np.median(twice))
    pitch_mm = NODE_PER_MARKER * float(np.sqrt(cell_mm2))
    low, high = flat.min(axis=0), flat.max(axis=0)
    count = np.floor((high - low) / pitch_mm + 1e-6).astype(int) + 1
    first = (low + high - (count - 1) * pitch_mm) / 2
    axes = [first[k] + pitch_mm * np.arange(count[k]) for k in range(2)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    nodes = nodes[mesh.find_simplex(nodes, tol=1e-3) >= 0]
    compliance = -tent_compliance(layer, flat, nodes, pitch_mm=pitch_mm)
    apart = np.linalg.norm(nodes[:, None] - nodes, axis=-1) / pitch_mm
    return GelGrid(
        rest_mm=rest_mm,
        nodes_mm=nodes,
        pitch_mm=pitch_mm,
        cell_mm2=cell_mm2,
        compliance=compliance.reshape(3 * len(flat), 3 * len(nodes)),
        smooth_share=SIDES_UNKNOWN if layer.outline is None else SIDES_KNOWN,
        to_markers=_shares(flat, nodes, pitch_mm, cell_mm2),
        laplacian=4.0 * np.eye(len(nodes)) - (np.abs(apart - 1.0) < 0.01),
    )


def _shares(
    flat: Float[np.ndarray, "n 2"], nodes: Float[np.ndarray, "m 2"], pitch_mm: float, cell_mm2: float
) -> Float[np.ndarray, "n m"]:
    """Force at each marker per nodal force: the node's traction there times the marker's cell.

    This conserves sum and moment only on average. The least-squares correction over the nine nearest markers
    conserves both for every node.
    """
    _, near = cKDTree(flat).query(nodes, k=9)
    arm = (flat[near] - nodes[:, None]) / pitch_mm
    tent = np.maximum(1.0 - np.abs(arm), 0.0).prod(axis=2) * cell_mm2 / pitch_mm**2
    keeps = np.concatenate([np.ones((*near.shape, 1)), arm], axis=2)
    miss = np.array([1.0, 0.0, 0.0]) - np.einsum("mqk,mq->mk", keeps, tent)
    square = np.einsum("mqk,mql->mkl", keeps, keeps)
    exact = tent + np.einsum("mqk,mk->mq", keeps, np.linalg.solve(square, miss[..., None])[..., 0])
    out = np.zeros((len(flat), len(nodes)))
    out[near, np.arange(len(nodes))[:, None]] = exact
    return out


@dataclass(frozen=True, kw_only=True)
class PriorHyperparameters:
    """Standard deviations of pressure and shear (MPa), roughness (pitches), noise over no-contact noise."""

    pressure_MPa: float
    shear_MPa: float
    roughness: float
    noise: float


INITIAL_HYPERPARAMETERS = PriorHyperparameters(pressure_MPa=0.03, shear_MPa=0.01, roughness=1.0, noise=2.0)
"""Start of the search for the prior: a usual press, twice the noise of no-contact frames. Set by hand."""


def prior_precision(grid: GelGrid, hyperparameters: PriorHyperparameters) -> Float[np.ndarray, "d d"]:
    """Q of the nodal forces, 1/N^2. Unknowns are ordered by node, then x, y and z."""
    m = len(grid.nodes_mm)
    smooth = np.eye(len(grid.nodes_mm)) + hyperparameters.roughness**2 * grid.laplacian
    out = np.zeros((m, 3, m, 3))
    for k, scale in enumerate(_scales(grid, hyperparameters)):
        out[:, k, :, k] = smooth * scale
    return out.reshape(3 * m, 3 * m)


def log_det_prior(
    grid: GelGrid, hyperparameters: PriorHyperparameters, touching: Bool[np.ndarray, " m"]
) -> float:
    """ln det Q of the touching nodes; 0 if none touches."""
    among = grid.laplacian[np.ix_(touching, touching)]
    smooth = np.eye(len(among)) + hyperparameters.roughness**2 * among
    log_scale = np.log(_scales(grid, hyperparameters)).sum()
    return float(3.0 * np.linalg.slogdet(smooth)[1] + touching.sum() * log_scale)


def _scales(grid: GelGrid, hyperparameters: PriorHyperparameters) -> Float[np.ndarray, "3"]:
    """Inverse variance of one node's force along x, y and z, 1/N^2."""
    sd_MPa = np.array([hyperparameters.shear_MPa, hyperparameters.shear_MPa, hyperparameters.pressure_MPa])
    return np.asarray((sd_MPa * grid.pitch_mm**2) ** -2.0)


def displacement_by(grid: GelGrid) -> Float[np.ndarray, "d u"]:
    """Marker displacement (mm) per nodal force (N), then per coefficient of the smooth fields.

    These fields are 1, x, y, x^2, x y and y^2 over the pad (from -1 to 1), each for x, y and z.
    """
    low, high = grid.rest_mm[:, :2].min(axis=0), grid.rest_mm[:, :2].max(axis=0)
    x, y = ((grid.rest_mm[:, :2] - (low + high) / 2) / ((high - low) / 2)).T
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    return np.hstack([grid.compliance, np.kron(basis, np.eye(3))])


def motion_of(y: Float[np.ndarray, "n 3"]) -> float:
    """The largest displacement of a frame, mm, but at least LEAST_MOTION_MM."""
    return max(float(np.linalg.norm(y, axis=1).max()), LEAST_MOTION_MM)


def smooth_precision(grid: GelGrid, motion_mm: float) -> Float[np.ndarray, " s"]:
    """Precision of the smooth fields' coefficients, 1/mm^2, in a frame with this largest displacement."""
    return np.tile(1.0 / (grid.smooth_share * motion_mm) ** 2, 6)


def dofs_of(touching: Bool[np.ndarray, " m"]) -> Int[np.ndarray, " d"]:
    """Indices of the touching nodes' unknowns, three per node."""
    return np.asarray((3 * np.flatnonzero(touching)[:, None] + np.arange(3)).ravel())
