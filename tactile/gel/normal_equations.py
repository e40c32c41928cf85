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
from scipy.linalg import cholesky, lapack, solve_triangular

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
    smooth fields in a frame of usual motion.
    """

    normal: Float[np.ndarray, "u u"]
    push_information: Float[np.ndarray, " m"]
    usual_smooth: Float[np.ndarray, " s"]
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
        by_forces = forces @ self.normal[at, 2 : 3 * self.nodes : 3]
        return np.asarray(by_forces + self.fields_by_pressure @ fields)

    def free_pressures(self, right: Float[np.ndarray, " u"]) -> Float[np.ndarray, " m"]:
        """Pressures of all nodes (N) where nothing binds them."""
        return self._free.solved(right, self.usual_smooth)[0][2::3]

    @cached_property
    def _free(self) -> TouchingFactor:
        return self.factor(np.ones(self.nodes, dtype=bool))

    @cached_property
    def free_sd(self) -> Float[np.ndarray, " m"]:
        """Standard deviations of the free pressures."""
        root = self._free.covariance_root(self.usual_smooth)[:, 2 : 3 * self.nodes : 3]
        return np.asarray(np.sqrt((root**2).sum(axis=0)))


def lower_root(matrix: Float[np.ndarray, "a a"]) -> Float[np.ndarray, "a a"]:
    """Cholesky's lower factor; raises numpy.linalg.LinAlgError for a matrix that is not positive definite."""
    return np.asarray(cholesky(matrix, lower=True, check_finite=False))


def forward(root: Float[np.ndarray, "a a"], right: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """root^-1 right."""
    return np.asarray(solve_triangular(root, right, lower=True, check_finite=False))


def backward(root: Float[np.ndarray, "a a"], right: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """root'^-1 right."""
    return np.asarray(solve_triangular(root, right, lower=True, trans=1, check_finite=False))
