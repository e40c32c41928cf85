"""The normal equations of a gel's forces, solved for one set of touching nodes after another.

    (G' W G + Q + S) [t; s] = G' W y

t: forces on the touching nodes, zero on the others; s: coefficients of the smooth fields. Their precision S
depends on the frame's largest displacement. The solver eliminates s after t, so that all frames share one
factor of the forces' block.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import blas, lapack

from tactile.gel.grid import dofs_of

KEPT_NUMBERS = 8_000_000
"""Most numbers in cached factors: 64 MB."""


@dataclass(frozen=True, kw_only=True)
class TouchingFactor:
    """Cholesky factor of the forces `at` some nodes. `root`: lower factor of their block; `across`: root^-1
    times their coupling with the smooth fields; `left`: Schur complement for the smooth fields.
    """

    at: Int[np.ndarray, " a"]
    root: Float[np.ndarray, "a a"]
    across: Float[np.ndarray, "a s"]
    left: Float[np.ndarray, "s s"]

    def solved(
        self, right: Float[np.ndarray, " u"], smooth: Float[np.ndarray, " s"]
    ) -> tuple[Float[np.ndarray, " a"], Float[np.ndarray, " s"], float]:
        """Forces, smooth coefficients with precision `smooth`, and ln det of the whole factor."""
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
    """The equations of one gel and prior for the markers in view: `normal` = G' W G + Q.

    `push_information`: diagonal of G' W G for the nodes' pressures. `usual_smooth`: precision of the smooth
    fields in a usual press. `whole`: equations of all markers; `lost`: hidden markers' rows V; V' V is
    subtracted.
    """

    normal: Float[np.ndarray, "u u"]
    push_information: Float[np.ndarray, " m"]
    usual_smooth: Float[np.ndarray, " s"]
    whole: "NormalEquations | None" = None
    lost: Float[np.ndarray, "l u"] | None = None
    _kept: dict[bytes, TouchingFactor] = field(default_factory=dict)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(self.push_information)

    @property
    def fields(self) -> Float[np.ndarray, "s s"]:
        """The smooth fields' block."""
        return self.normal[3 * self.nodes :, 3 * self.nodes :]

    @property
    def fields_by_pressure(self) -> Float[np.ndarray, "m s"]:
        """The block that couples the nodes' pressures with the smooth fields."""
        return self.normal[2 : 3 * self.nodes : 3, 3 * self.nodes :]

    def factor(self, touching: Bool[np.ndarray, " m"]) -> TouchingFactor:
        """The factor for these touching nodes, cached."""
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
        """The left side of each node's equation of pressure."""
        by_forces = forces @ self._pressure_columns[at]
        return np.asarray(by_forces + self.fields_by_pressure @ fields)

    def without(self, lost: Float[np.ndarray, "l u"]) -> "NormalEquations":
        """The equations minus V' V, for the rows V of hidden markers."""
        gone = (lost[:, 2 : 3 * self.nodes : 3] ** 2).sum(axis=0)
        information = np.maximum(self.push_information - gone, 1e-9 * self.push_information)
        return NormalEquations(self.normal - lost.T @ lost, information, self.usual_smooth, self, lost)

    def free_pressures(self, right: Float[np.ndarray, " u"]) -> Float[np.ndarray, " m"]:
        """Normal forces (N) of all nodes without constraints; Woodbury's identity subtracts lost rows."""
        if self.whole is None:
            return self._free.solved(right, self.usual_smooth)[0][2::3]
        root, (gone, inner) = self.whole.free_root, self._lost_parts
        z = root @ right
        return np.asarray(root[:, 2 : 3 * self.nodes : 3].T @ (z + gone @ (inner @ (gone.T @ z))))

    @cached_property
    def free_sd(self) -> Float[np.ndarray, " m"]:
        """Standard deviations of these normal forces, N."""
        if self.whole is None:
            return np.asarray(np.sqrt((self.free_root[:, 2 : 3 * self.nodes : 3] ** 2).sum(axis=0)))
        gone, inner = self._lost_parts
        more = self.whole.free_root[:, 2 : 3 * self.nodes : 3].T @ gone
        return np.asarray(np.sqrt(self.whole.free_sd**2 + ((more @ inner) * more).sum(axis=1)))

    @cached_property
    def free_root(self) -> Float[np.ndarray, "u u"]:
        """R with R' R the covariance of all unknowns without the contact's constraints."""
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

    Like `forward` and `backward` it calls LAPACK directly: scipy's checks take longer than such small
    systems.
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
