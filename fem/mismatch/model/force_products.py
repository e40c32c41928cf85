"""Draws of the noise that is left in a recording's forces, and what is linear in these.

The model's response c = C f holds the noise of the forces, and where these come from the gel's springs
(fem.estimation.denoised_force) that is the noise of the markers' own displacement. Whatever field phi is
linear in the forces holds it too, so that its product with the data has an expected value by noise alone:

    n = E[phi(df) . W e],        e = dy - s C df

dy, df: noise of the markers' places, and of the forces after they were brought to their patterns. W e,
brought back to the forces, g_r = sum_t a_r(t) (W e)(t), and its adjoint field of the flesh K0^-1 L g_r serve
every phi: where phi is a change of the flesh's law, phi(t) = s sum_r a_r(t) L' K0^-1 b(U_r),

    phi(df) . W e = s sum_r (K0^-1 L g_r) . b(dU_r)

With an effect of amount a in the model the noise of the response is C df + a phi(df), and fields' products
with each other, q = E[phi(df) . W phi(df)], say from where on more of it leaves no less noise: a = n / q.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float

from fem.cached_value import cached_value
from fem.estimation.sensitivity import inner_work
from fem.mismatch.model.baseline import GraspResponse
from fem.solid.linear_solid import UnitModulusSolid


@dataclass(frozen=True, kw_only=True)
class ForceNoise:
    """p draws of one recording's noise, each by patterns r; s is the plain model's 1/E.

    `force_N`: df_r on the markers. `moved`: dU_r = K0^-1 L df_r of the whole flesh (E = 1 MPa), `response`
    the markers'. `weighed`: W e. `pulled`: g_r. `adjoint`: K0^-1 L g_r of the whole flesh, `adjoint_response`
    the markers'.
    """

    compliance: float
    recording: GraspResponse
    solid: UnitModulusSolid
    force_N: Float[np.ndarray, "p r n 3"]
    moved: Float[np.ndarray, "p r m 3"]
    response: Float[np.ndarray, "p r n 3"]
    weighed: Float[np.ndarray, "p f n 3"]
    pulled: Float[np.ndarray, "p r n 3"]
    adjoint: Float[np.ndarray, "p r m 3"]
    adjoint_response: Float[np.ndarray, "p r n 3"]

    def of_draws(self, products: Float[np.ndarray, " p"]) -> float:
        """Their mean, for the recording as it is thinned: a frame left out has its share in the patterns."""
        return float(products.mean()) * self.recording.kept

    def solved(self, loads: Float[np.ndarray, "p r m 3"]) -> Float[np.ndarray, "p f n 3"]:
        """s sum_r a_r(t) L' K0^-1 b_r at the markers, of loads on the whole flesh by the first patterns."""
        flat = loads.reshape(-1, *loads.shape[2:])
        moved = self.recording.at_markers(self.solid.displacement(flat)[:, self.solid.contact_nodes])
        return self.over_time(moved.reshape(*loads.shape[:2], *moved.shape[1:]))

    def over_time(self, response: Float[np.ndarray, "p r n 3"]) -> Float[np.ndarray, "p f n 3"]:
        """s sum_r a_r(t) c_r of responses by the first patterns."""
        shares = self.recording.shares[:, : response.shape[1]]
        return np.asarray(self.compliance * np.einsum("fr,prnx->pfnx", shares, response))

    @cached_value
    def inner_products(self) -> dict[str, float]:
        """n / s of pit and Poisson's ratio, cause by cause (fem.estimation.sensitivity).

        The surface's undulations are each recording's own, and eliminated without them.
        """
        draws, patterns, nodes = len(self.moved), self.recording.finer.first, self.moved.shape[2]
        moved = self.moved[:, :patterns].reshape(draws * patterns, nodes, 3)
        work = inner_work(self.solid, moved, self.adjoint[:, :patterns].reshape(moved.shape))
        return {
            cause: self.of_draws(cause_work.reshape(draws, patterns).sum(axis=1))
            for cause, cause_work in work.items()
        }


class LinearInForces(Protocol):
    """How a field follows from the forces."""

    def product(self, noise: ForceNoise) -> float:
        """n of the module's docstring for one recording."""
        ...

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """phi(df) of each draw at the markers, mm in the column's unit."""
        ...


@dataclass(frozen=True)
class OfFlesh:
    """phi(t) = s sum_r a_r(t) L' K0^-1 b(U_r), r the leading patterns (GraspResponse.leading).

    `load`: b of fields of a recording's flesh, nodal forces.
    """

    load: Callable[[GraspResponse, Float[np.ndarray, "q m 3"]], Float[np.ndarray, "q m 3"]]

    def product(self, noise: ForceNoise) -> float:
        """By the adjoint fields: no solve."""
        loads = self._loads(noise)
        work = np.einsum("prmx,prmx->p", noise.adjoint[:, : loads.shape[1]], loads, optimize=True)
        return noise.compliance * noise.of_draws(work)

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """One solve for each draw and pattern."""
        return noise.solved(self._loads(noise))

    def _loads(self, noise: ForceNoise) -> Float[np.ndarray, "p r m 3"]:
        draws, patterns, nodes = len(noise.moved), noise.recording.finer.first, noise.moved.shape[2]
        moved = noise.moved[:, :patterns].reshape(draws * patterns, nodes, 3)
        return self.load(noise.recording, moved).reshape(draws, patterns, nodes, 3)


@dataclass(frozen=True)
class OfResponse:
    """phi = s part(c): `part` of a recording's response c(t)."""

    part: Callable[[GraspResponse, Float[np.ndarray, "f n 3"]], Float[np.ndarray, "f n 3"]]

    def product(self, noise: ForceNoise) -> float:
        """Directly."""
        return noise.of_draws(np.einsum("pfnx,pfnx->p", self.fields(noise), noise.weighed))

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """Without a solve."""
        return np.stack([self.part(noise.recording, draw) for draw in noise.over_time(noise.response)])


@dataclass(frozen=True)
class OfSomeForces:
    """phi = s C g(f): `part`: g of forces on a recording's markers, as the response to some of them alone."""

    part: Callable[[GraspResponse, Float[np.ndarray, "q n 3"]], Float[np.ndarray, "q n 3"]]

    def product(self, noise: ForceNoise) -> float:
        """By the adjoint fields at the markers."""
        force_N = self._forces(noise)
        return noise.compliance * noise.of_draws(np.einsum("prnx,prnx->p", noise.adjoint_response, force_N))

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """One solve for each draw and pattern."""
        force_N, nodes = self._forces(noise), noise.moved.shape[2]
        loads = np.zeros((*force_N.shape[:2], nodes, 3))
        flat = force_N.reshape(-1, *force_N.shape[2:])
        loads[:, :, noise.solid.contact_nodes] = noise.recording.nodal_of(flat).reshape(
            *force_N.shape[:2], -1, 3
        )
        return noise.solved(loads)

    def _forces(self, noise: ForceNoise) -> Float[np.ndarray, "p r n 3"]:
        flat = noise.force_N.reshape(-1, *noise.force_N.shape[2:])
        return self.part(noise.recording, flat).reshape(noise.force_N.shape)


@dataclass(frozen=True)
class OfAll:
    """phi = C f in another unit: `share` of s c."""

    share: float = 1.0

    def product(self, noise: ForceNoise) -> float:
        """g_r . L' dU_r."""
        work = np.einsum("prnx,prnx->p", noise.pulled, noise.response)
        return self.share * noise.compliance * noise.of_draws(work)

    def fields(self, noise: ForceNoise) -> Float[np.ndarray, "p f n 3"]:
        """The response itself."""
        return self.share * noise.over_time(noise.response)
