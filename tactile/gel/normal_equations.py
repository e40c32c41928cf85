"""The normal equations of a gel's forces, solved on one set of touching nodes after another.

    (G' W G + Q + S) [t; s] = G' W y

with forces t on the nodes that touch, zero on the others, and coefficients s of the smooth fields, whose
precision S goes with the frame's motion. All that frames share is computed once: the factor of the forces'
block of a set of nodes (S is eliminated after it, by 18 unknowns), which comes back from frame to frame and
from start to start, and the factor of all nodes. Markers that a frame lacks are taken out of both by the few
rows that they had.
"""

from collections import OrderedDict
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import blas, lapack

from tactile.gel.grid import dofs_of

KEPT_NUMBERS = 8_000_000
"""Of the factors that are kept, numbers at most: 64 MB."""
LEAST_INFORMATION = 1e-9
"""Directions of a marker with less than this share of its greatest information are not seen."""


@dataclass(frozen=True, kw_only=True)
class TouchingFactor:
    """The factor of the forces on some nodes: `root` (lower, Cholesky's) of their block, `across` = root^-1
    times their columns with the smooth fields, `left` what these leave of the smooth fields' block.

    `log_det_root`: ln det of the root.
    """

    at: Int[np.ndarray, " a"]
    root: Float[np.ndarray, "a a"]
    across: Float[np.ndarray, "a s"]
    left: Float[np.ndarray, "s s"]
    log_det_root: float

    def solved(
        self, right: Float[np.ndarray, " u"], smooth: Float[np.ndarray, " s"]
    ) -> tuple[Float[np.ndarray, " a"], Float[np.ndarray, " s"], float]:
        """Forces, smooth coefficients of precision `smooth`, and ln det of the whole root."""
        inner = cholesky_of(self.left + np.diag(smooth))
        z = self._forward(right[self.at])
        fields = right[len(right) - len(smooth) :] - z @ self.across
        fields = blas.dtrsv(inner, blas.dtrsv(inner, fields, lower=1), lower=1, trans=1)
        forces = z - self.across @ fields
        if len(forces):
            forces = blas.dtrsv(self.root, forces, lower=1, trans=1)
        return forces, fields, self.log_det_root + float(np.log(np.diag(inner)).sum())

    def covariance_root(self, smooth: Float[np.ndarray, " s"]) -> Float[np.ndarray, "b b"]:
        """R, lower, of the covariance R' R of forces and smooth coefficients."""
        a, s = self.across.shape
        whole = np.zeros((a + s, a + s), order="F")
        whole[:a, :a] = np.tril(self.root)
        whole[a:, :a] = self.across.T
        whole[a:, a:] = np.tril(cholesky_of(self.left + np.diag(smooth)))
        return np.asarray(lapack.dtrtri(whole, lower=1, overwrite_c=1)[0])

    def _forward(self, right: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
        return blas.dtrsv(self.root, right, lower=1) if len(right) else right


class FreeFactor:
    """The factor of the forces on all nodes, the pressures last, so that only their part is solved back.

    `smooth`: precision of the smooth fields.
    """

    def __init__(self, normal: Float[np.ndarray, "u u"], smooth: Float[np.ndarray, " s"]) -> None:
        size = len(normal) - len(smooth)
        unknowns = np.arange(len(normal))
        pressure = np.arange(2, size, 3)
        self._order = np.concatenate([np.setdiff1d(unknowns, pressure), pressure])
        loose = normal.copy()
        loose[unknowns[size:], unknowns[size:]] += smooth
        self._root = cholesky_of(loose[np.ix_(self._order, self._order)])
        self._first = len(normal) - len(pressure)
        corner = np.asfortranarray(self._root[self._first :, self._first :])
        self._corner = corner
        inverse = np.tril(lapack.dtrtri(corner, lower=1)[0])
        self._variance = (inverse**2).sum(axis=0)
        self._added = np.zeros((0, len(normal)))

    def without(self, lost: Float[np.ndarray, "l u"]) -> "FreeFactor":
        """The same less V' V of these rows V, by Woodbury's identity."""
        other = copy(self)
        gone = blas.dtrsm(1.0, self._root, np.asfortranarray(lost[:, self._order].T), lower=1)
        inner = cholesky_of(np.eye(len(lost)) - gone.T @ gone)
        other._added = added = blas.dtrsm(1.0, inner, np.asfortranarray(gone.T), lower=1)
        corner = np.asfortranarray(added[:, self._first :].T)
        more = blas.dtrsm(1.0, self._corner, corner, lower=1, trans_a=1)
        other._variance = self._variance + (more**2).sum(axis=1)
        return other

    def pressures(
        self, right: Float[np.ndarray, " u"]
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Pressures of the nodes (N) and their standard deviations."""
        z = blas.dtrsv(self._root, right[self._order], lower=1)
        z = z + (self._added @ z) @ self._added
        return blas.dtrsv(self._corner, z[self._first :], lower=1, trans=1), np.sqrt(self._variance)


class NormalEquations:
    """The equations of one gel and prior while some markers are in view.

    `normal`: G' W G + Q of all markers, `free` its factor; `lost`: rows V whose V' V is taken out of both
    (`without`). `fields` and `fields_by_pressure`: the smooth fields' block, and theirs with the nodes'
    pressures. `log_det_prior` gives ln det of the prior's precision of some nodes.
    """

    def __init__(
        self,
        normal: Float[np.ndarray, "u u"],
        nodes: int,
        log_det_prior: Callable[[Int[np.ndarray, " k"]], float],
        free: FreeFactor,
    ) -> None:
        size = 3 * nodes
        self.free = free
        self._size, self.log_det_prior = size, log_det_prior
        self._normal = normal
        self._mixed = np.ascontiguousarray(normal[:size, size:])
        self._pressure_columns = np.ascontiguousarray(normal[:size, 2:size:3])
        self.fields = normal[size:, size:].copy()
        self.fields_by_pressure = np.ascontiguousarray(normal[2:size:3, size:])
        self.pressure_lost = np.zeros(nodes)
        self.lost: Float[np.ndarray, "l u"] | None = None
        self._lost_pressure = np.zeros((0, nodes))
        self._kept: OrderedDict[bytes, TouchingFactor] = OrderedDict()
        self._kept_numbers = 0

    def without(self, lost: Float[np.ndarray, "l u"]) -> "NormalEquations":
        """The same without V' V of these rows V."""
        other, size = copy(self), self._size
        other.lost, other._kept, other._kept_numbers = lost, OrderedDict(), 0
        other._lost_pressure = pressure = np.ascontiguousarray(lost[:, 2:size:3])
        fields = lost[:, size:]
        other.free = self.free.without(lost)
        other._mixed = self._mixed - lost[:, :size].T @ fields
        other.fields = self.fields - fields.T @ fields
        other.fields_by_pressure = self.fields_by_pressure - pressure.T @ fields
        other.pressure_lost = (pressure**2).sum(axis=0)
        return other

    def factor(self, touching: Bool[np.ndarray, " m"]) -> TouchingFactor:
        """The factor of the nodes that touch; kept for the next time."""
        key = touching.tobytes()
        if (factor := self._kept.pop(key, None)) is None:
            factor = self._factor(touching)
            self._kept_numbers += factor.root.size
        self._kept[key] = factor
        while len(self._kept) > 1 and self._kept_numbers > KEPT_NUMBERS:
            self._kept_numbers -= self._kept.popitem(last=False)[1].root.size
        return factor

    def _factor(self, touching: Bool[np.ndarray, " m"]) -> TouchingFactor:
        at = dofs_of(touching)
        block = self._normal[np.ix_(at, at)]
        if self.lost is not None:
            lost = self.lost[:, at]
            block -= lost.T @ lost
        return _eliminated(at, block, self._mixed[at], self.fields)

    def resisted(
        self, at: Int[np.ndarray, " a"], forces: Float[np.ndarray, " a"], fields: Float[np.ndarray, " s"]
    ) -> Float[np.ndarray, " m"]:
        """The equations' left side in every node's pressure."""
        left_side = forces @ self._pressure_columns[at] + self.fields_by_pressure @ fields
        if self.lost is not None:
            left_side = left_side - (self.lost[:, at] @ forces) @ self._lost_pressure
        return np.asarray(left_side)


def factor_of(normal: Float[np.ndarray, "b b"], forces: int) -> TouchingFactor:
    """The factor of equations whose first unknowns are forces, the others smooth fields."""
    block, mixed = normal[:forces, :forces].copy(), normal[:forces, forces:]
    return _eliminated(np.arange(forces), block, mixed, normal[forces:, forces:])


def _eliminated(
    at: Int[np.ndarray, " a"],
    block: Float[np.ndarray, "a a"],
    mixed: Float[np.ndarray, "a s"],
    fields: Float[np.ndarray, "s s"],
) -> TouchingFactor:
    if not len(at):
        return TouchingFactor(at=at, root=block, across=mixed, left=fields, log_det_root=0.0)
    root = cholesky_of(block)
    across = blas.dtrsm(1.0, root, np.asfortranarray(mixed), lower=1)
    return TouchingFactor(
        at=at,
        root=root,
        across=across,
        left=fields - across.T @ across,
        log_det_root=float(np.log(np.diag(root)).sum()),
    )


def rows_of(
    observed: Float[np.ndarray, "r u"], information: Float[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, "l u"]:
    """V with V' V = G' W G of some markers; directions that are not seen are left out."""
    values, vectors = np.linalg.eigh(information)
    seen = values > LEAST_INFORMATION * values.max(axis=1, keepdims=True)
    roots = (vectors * np.sqrt(np.where(seen, values, 0.0))[:, None, :]).transpose(0, 2, 1)
    rows = np.matmul(roots, observed.reshape(len(information), 3, -1))
    return np.asarray(rows[seen])


def cholesky_of(matrix: Float[np.ndarray, "a a"]) -> Float[np.ndarray, "a a"]:
    """Cholesky's lower factor of a symmetric matrix, whose numbers are overwritten; above it nothing counts.

    Raises numpy.linalg.LinAlgError where the matrix is not positive definite.
    """
    root, wrong = lapack.dpotrf(matrix.T, lower=1, clean=0, overwrite_a=1)
    if wrong:
        raise np.linalg.LinAlgError(f"not positive definite from row {wrong} on")
    return np.asarray(root)
