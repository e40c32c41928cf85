"""The normal equations of a gel's forces, solved on one set of touching nodes after another.

    (G' W G + Q + S) [t; s] = G' W y

with forces t on the nodes that touch, zero on the others, and coefficients s of the smooth fields, whose
precision S goes with the frame's motion. S is eliminated after the forces, so that one factor of their block
serves all frames.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import blas, lapack

from tactile.gel.grid import dofs_of

KEPT_NUMBERS = 8_000_000
"""Of the factors that are kept, numbers at most: 64 MB."""


@dataclass(frozen=True, kw_only=True)
class TouchingFactor:
    """The factor of the forces on some nodes: `root` (lower, Cholesky's) of their block, `across` = root^-1
    times their columns with the smooth fields, `left` what these leave of the smooth fields' block.
    """

    at: Int[np.ndarray, " a"]
    root: Float[np.ndarray, "a a"]
    across: Float[np.ndarray, "a s"]
    left: Float[np.ndarray, "s s"]

    def solved(
        self, right: Float[np.ndarray, " u"], smooth: Float[np.ndarray, " s"]
    ) -> tuple[Float[np.ndarray, " a"], Float[np.ndarray, " s"], float]:
        """Forces, smooth coefficients of precision `smooth`, and ln det of the whole root."""
        inner = lower_root(self.left + np.diag(smooth))
        z = forward(self.root, right[self.at])
        fields = backward(inner, forward(inner, right[len(right) - len(smooth) :] - z @ self.across))
        forces = backward(self.root, z - self.across @ fields)
        log_det_root = np.log(np.diag(self.root)).sum() + np.log(np.diag(inner)).sum()
        return forces, fields, float(log_det_root)

    def covariance_root(self, smooth: Float[np.ndarray, " s"]) -> Float[np.ndarray, "b b"]:
        """R with R' R the covariance of the forces and the smooth coefficients."""
        inner = lower_root(self.left + np.diag(smooth))
        whole = np.block([[self.root, np.zeros_like(self.across)], [self.across.T, inner]])
        return np.asarray(lapack.dtrtri(whole, lower=1)[0])


@dataclass(frozen=True)
class NormalEquations:
    """The equations of one gel and prior while some markers are in view: `normal` = G' W G + Q.

    `push_information`: the diagonal of G' W G in the nodes' pressures. `usual_smooth`: precision of the
    smooth fields in a frame of usual motion. `whole` and `lost`: the equations of all markers, and rows V
    whose V' V is taken out of them.
    """

    normal: Float[np.ndarray, "u u"]
    push_information: Float[np.ndarray, " m"]
    usual_smooth: Float[np.ndarray, " s"]
    whole: "NormalEquations | None" = None
    lost: Float[np.ndarray, "l u"] | None = None
    _kept: dict[bytes, TouchingFactor] = field(default_factory=dict)

    @property
    def nodes(self) -> int:
        """How many nodes there are."""
        return len(self.push_information)

    @property
    def fields(self) -> Float[np.ndarray, "s s"]:
        """The smooth fields' block."""
        return self.normal[3 * self.nodes :, 3 * self.nodes :]

    @property
    def fields_by_pressure(self) -> Float[np.ndarray, "m s"]:
        """The smooth fields' block with the nodes' pressures."""
        return self.normal[2 : 3 * self.nodes : 3, 3 * self.nodes :]

    def factor(self, touching: Bool[np.ndarray, " m"]) -> TouchingFactor:
        """The factor of the nodes that touch; kept for the next time."""
        key = touching.tobytes()
        if key not in self._kept:
            if sum(factor.root.size for factor in self._kept.values()) > KEPT_NUMBERS:
                self._kept.clear()
            at = dofs_of(touching)
            root = lower_root(self.normal[np.ix_(at, at)])
            across = forward(root, self.normal[at, 3 * self.nodes :])
            self._kept[key] = TouchingFactor(
                at=at, root=root, across=across, left=self.fields - across.T @ across
            )
        return self._kept[key]

    def resisted(
        self, at: Int[np.ndarray, " a"], forces: Float[np.ndarray, " a"], fields: Float[np.ndarray, " s"]
    ) -> Float[np.ndarray, " m"]:
        """The equations' left side in every node's pressure."""
        by_forces = forces @ self._pressure_columns[at]
        return np.asarray(by_forces + self.fields_by_pressure @ fields)

    def without(self, lost: Float[np.ndarray, "l u"]) -> "NormalEquations":
        """The same less V' V of these rows V."""
        gone = (lost[:, 2 : 3 * self.nodes : 3] ** 2).sum(axis=0)
        information = np.maximum(self.push_information - gone, 1e-9 * self.push_information)
        return NormalEquations(self.normal - lost.T @ lost, information, self.usual_smooth, self, lost)

    def free_pressures(self, right: Float[np.ndarray, " u"]) -> Float[np.ndarray, " m"]:
        """Pressures of all nodes (N) where nothing binds them, by Woodbury's identity where rows are lost."""
        if self.whole is None:
            return self._free.solved(right, self.usual_smooth)[0][2::3]
        root, (gone, inner) = self.whole.free_root, self._lost_parts
        z = root @ right
        return np.asarray(root[:, 2 : 3 * self.nodes : 3].T @ (z + gone @ (inner @ (gone.T @ z))))

    @cached_property
    def free_sd(self) -> Float[np.ndarray, " m"]:
        """Standard deviations of the free pressures."""
        if self.whole is None:
            return np.asarray(np.sqrt((self.free_root[:, 2 : 3 * self.nodes : 3] ** 2).sum(axis=0)))
        gone, inner = self._lost_parts
        more = self.whole.free_root[:, 2 : 3 * self.nodes : 3].T @ gone
        return np.asarray(np.sqrt(self.whole.free_sd**2 + ((more @ inner) * more).sum(axis=1)))

    @cached_property
    def free_root(self) -> Float[np.ndarray, "u u"]:
        """A root R of the covariance of all unknowns, R' R, where nothing binds them."""
        return self._free.covariance_root(self.usual_smooth)

    @cached_property
    def _lost_parts(self) -> tuple[Float[np.ndarray, "u l"], Float[np.ndarray, "l l"]]:
        """R V', and (1 - V R' R V')^-1."""
        if self.whole is None or self.lost is None:
            raise TypeError("no rows are lost")
        gone = self.whole.free_root @ self.lost.T
        return gone, np.linalg.inv(np.eye(gone.shape[1]) - gone.T @ gone)

    @cached_property
    def _free(self) -> TouchingFactor:
        return self.factor(np.ones(self.nodes, dtype=bool))

    @cached_property
    def _pressure_columns(self) -> Float[np.ndarray, "f m"]:
        return np.ascontiguousarray(self.normal[: 3 * self.nodes, 2 : 3 * self.nodes : 3])


def lower_root(matrix: Float[np.ndarray, "a a"]) -> Float[np.ndarray, "a a"]:
    """Cholesky's lower factor; raises numpy.linalg.LinAlgError for a matrix that is not positive definite.

    These three call the library directly: scipy's checks take longer than such small systems.
    """
    root, wrong = lapack.dpotrf(matrix, lower=1)
    if wrong:
        raise np.linalg.LinAlgError(f"not positive definite from row {wrong} on")
    return np.asarray(root)


def forward(root: Float[np.ndarray, "a a"], right: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """root^-1 right."""
    if not len(right):
        return right
    vector = right.ndim == 1
    return np.asarray(blas.dtrsv(root, right, lower=1) if vector else blas.dtrsm(1.0, root, right, lower=1))


def backward(root: Float[np.ndarray, "a a"], right: Float[np.ndarray, " a"]) -> Float[np.ndarray, " a"]:
    """root'^-1 right."""
    return np.asarray(blas.dtrsv(root, right, lower=1, trans=1)) if len(right) else right
