"""Draws of the noise that is left in a recording's forces, and what is linear in these.

The model's response c = C f holds the noise of the forces, and where these come from the gel's springs
(fem.estimation.denoised_force) that is the noise of the markers' own displacement. Whatever field phi is
linear in the forces holds it too, so that its product with the data has an expected value by noise alone:

    n = E[phi(df) . W e],        e = dy - s C df

dy, df: noise of the markers' places, and of the forces after they were brought to their patterns. W e,
brought back to the forces, g_r = sum_t a_r(t) (W e)(t), and its adjoint field of the flesh K0^-1 L g_r serve
every phi: where phi is a change of the flesh's law, phi(t) = s sum_r a_r(t) L' K0^-1 b(U_r),

    phi(df) . W e = s sum_r (K0^-1 L g_r) . b(dU_r)
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from jaxtyping import Float

from fem.estimation.sensitivity import inner_forces
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

    @cached_property
    def inner_products(self) -> dict[str, float]:
        """n / s of pit and Poisson's ratio, cause by cause (fem.estimation.sensitivity).

        The surface's undulations are each recording's own, and eliminated without them.
        """
        draws, patterns, nodes = len(self.moved), self.recording.finer.first, self.moved.shape[2]
        moved = self.moved[:, :patterns].reshape(draws * patterns, nodes, 3)
        causes, loads = inner_forces(self.solid, moved, list(self.recording.links), with_surface=False)
        adjoint = self.adjoint[:, :patterns].reshape(moved.shape)
        work = np.einsum("qmx,cqmx->cq", adjoint, loads, optimize=True)
        by_draw = work.reshape(len(causes), draws, patterns).sum(axis=2)
        return {cause: self.of_draws(own) for cause, own in zip(causes, by_draw, strict=True)}


class LinearInForces(Protocol):
    """How a field follows from the forces."""

    def product(self, noise: ForceNoise) -> float:
        """n of the module's docstring for one recording."""
        ...


@dataclass(frozen=True)
class OfFlesh:
    """phi(t) = s sum_r a_r(t) L' K0^-1 b(U_r), r the leading patterns (GraspResponse.leading).

    `load`: b of fields of a recording's flesh, nodal forces.
    """

    load: Callable[[GraspResponse, Float[np.ndarray, "q m 3"]], Float[np.ndarray, "q m 3"]]

    def product(self, noise: ForceNoise) -> float:
        """By the adjoint fields: no solve."""
        draws, patterns, nodes = len(noise.moved), noise.recording.finer.first, noise.moved.shape[2]
        moved = noise.moved[:, :patterns].reshape(draws * patterns, nodes, 3)
        loads = self.load(noise.recording, moved)
        work = np.einsum("qmx,qmx->q", noise.adjoint[:, :patterns].reshape(loads.shape), loads)
        return noise.compliance * noise.of_draws(work.reshape(draws, patterns).sum(axis=1))


@dataclass(frozen=True)
class OfResponse:
    """phi = s part(c): `part` of a recording's response c(t)."""

    part: Callable[[GraspResponse, Float[np.ndarray, "f n 3"]], Float[np.ndarray, "f n 3"]]

    def product(self, noise: ForceNoise) -> float:
        """Directly."""
        recording = noise.recording
        found = [
            float((self.part(recording, recording.over_time(response)) * weighed).sum())
            for response, weighed in zip(_all_patterns(recording, noise.response), noise.weighed, strict=True)
        ]
        return noise.compliance * noise.of_draws(np.array(found))


@dataclass(frozen=True)
class OfSomeForces:
    """phi = s C g(f): `part`: g of forces on a recording's markers, as the response to some of them alone."""

    part: Callable[[GraspResponse, Float[np.ndarray, "q n 3"]], Float[np.ndarray, "q n 3"]]

    def product(self, noise: ForceNoise) -> float:
        """By the adjoint fields at the markers."""
        flat = noise.force_N.reshape(-1, *noise.force_N.shape[2:])
        own = self.part(noise.recording, flat).reshape(noise.force_N.shape)
        return noise.compliance * noise.of_draws(np.einsum("prnx,prnx->p", noise.adjoint_response, own))


@dataclass(frozen=True)
class OfAll:
    """phi = C f in another unit: `share` of s c."""

    share: float = 1.0

    def product(self, noise: ForceNoise) -> float:
        """g_r . L' dU_r."""
        own = np.einsum("prnx,prnx->p", noise.pulled, noise.response)
        return self.share * noise.compliance * noise.of_draws(own)


def _all_patterns(
    recording: GraspResponse, response: Float[np.ndarray, "p r n 3"]
) -> Float[np.ndarray, "p q n 3"]:
    """With zeros for the patterns that have no noise of their own (a drift's)."""
    found = np.zeros((len(response), len(recording.patterns), *response.shape[2:]))
    found[:, : response.shape[1]] = response
    return found
