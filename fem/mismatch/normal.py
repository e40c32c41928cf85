"""Least squares over markers in all frames, with all that is each marker's or frame's own eliminated.

Where a marker sits, its scale error and the fruit's rigid motion are unknown in every recording (fem.
modulus_fit). With them eliminated a field phi weighs W phi, and fields make normal equations by products

    N_ij = phi_i . W phi_j,      W = V - V A (A' V A + L)^-1 A' V

V: inverse variance, the mean over each contact taken out; A: rigid motions and scales, L their priors. So
much is the same whatever fields come; one more field costs two passes over the markers.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from fem.mismatch.baseline import Seen
from fem.mismatch.fields import ARM_MM, wrench
from fem.modulus_fit import (
    GAUGE_SD_MM,
    MarkerTracks,
    about_episode_mean,
    marker_weight,
    motion_equations,
    rigid_motion,
)
from fem.modulus_noise import variance_inflation

MARKER_EXCESS = 1.6
"""Variance of what the plain model leaves of sound recordings, over that of their noise in the air."""


@dataclass(frozen=True)
class MarkerEquations:
    """W of one recording's markers, in the form in which it is applied."""

    tracks: MarkerTracks
    weight: Float[np.ndarray, " n"]
    rigid: Float[np.ndarray, "n 3 6"]
    stiffness: Float[np.ndarray, " n"]
    gel: Float[np.ndarray, "f n 3"]
    along: Float[np.ndarray, "n m"]
    motions: tuple[np.ndarray, bool]
    fruit_moves: bool

    @classmethod
    def of(cls, tracks: MarkerTracks, *, scale_sd: float, fruit_moves: bool) -> "MarkerEquations":
        """`scale_sd`: relative scale errors of markers; `fruit_moves`: nothing holds the fruit."""
        weight = marker_weight(tracks) / MARKER_EXCESS
        rigid = rigid_motion(tracks.place_mm)
        gel = about_episode_mean(tracks.gel_displacement_mm, tracks.episode)
        stiffness = np.einsum("n,tnx,tnx->n", weight, gel, gel, optimize=True) + 1 / scale_sd**2
        turned = np.einsum("n,nxl,tnx->ntl", weight, rigid, gel, optimize=True).reshape(len(weight), -1)
        normal = motion_equations(rigid, weight, tracks.episode)
        normal -= turned.T @ (turned / stiffness[:, None])
        normal[np.diag_indices_from(normal)] += 1 / GAUGE_SD_MM**2
        return cls(tracks, weight, rigid, stiffness, gel, turned, cho_factor(normal), fruit_moves)

    def weighed(self, field: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """W phi, 1/mm for a field in mm; its sum with another field is their product."""
        own = about_episode_mean(field, self.tracks.episode)
        return np.asarray(self.weight[:, None] * (own - self._explained(own)))

    def left(self, field: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """What motions, scales and places leave of a field, mm."""
        own = about_episode_mean(field, self.tracks.episode)
        return np.asarray(own - self._explained(own))

    def _explained(self, own: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """What motions and scales explain of a field whose contacts' means are zero."""
        weighted = self.weight[:, None] * own
        seen = np.einsum("tnx,tnx->n", weighted, self.gel)
        if not self.fruit_moves:
            return np.asarray((seen / self.stiffness)[:, None] * self.gel)
        right = np.einsum("nxl,tnx->tl", self.rigid, weighted, optimize=True).ravel()
        motion = cho_solve(self.motions, right - self.along.T @ (seen / self.stiffness))
        scale = (seen - self.along @ motion) / self.stiffness
        moved = np.einsum("nxl,tl->tnx", self.rigid, motion.reshape(-1, 6), optimize=True)
        return about_episode_mean(moved, self.tracks.episode) + scale[:, None] * self.gel


SHIFT_SD_MM, TURN_SD_DEG, UNEVEN = 0.5, 0.15, 1e-3
"""A priori: pads' places, their turns, and the share of force that scales of single markers leave uneven."""


@dataclass(frozen=True)
class BalanceEquations:
    """W of the six sums of force and moment of a fruit that nothing but its pads holds.

    Noise is that of all markers' forces together. Nuisances: each pad a little elsewhere and turned, and an
    imbalance that grows with the load, from the scales of single markers.
    """

    measured: Float[np.ndarray, "f 6"]
    weight: Float[np.ndarray, "6"]
    nuisances: Float[np.ndarray, "k f 6"]
    inverse: Float[np.ndarray, "k k"]

    @classmethod
    def of(cls, seen: Seen) -> "BalanceEquations":
        """From the recording's own forces."""
        position, force = seen.tracks.position_mm, seen.force_N
        centre = position.mean(axis=(0, 1))
        columns, spreads = [], []
        for pad in range(len(seen.links)):
            own = np.where((seen.pad_of_marker == pad)[None, :, None], force, 0.0)
            total = own.sum(axis=1)
            for way in np.eye(3):
                columns.append(np.hstack([np.zeros_like(total), np.cross(way, total) / ARM_MM]))
                columns.append(wrench(np.cross(way, own), position, centre_mm=centre) * np.pi / 180)
                spreads += [SHIFT_SD_MM, TURN_SD_DEG]
        load = np.linalg.norm(force, axis=2).sum(axis=1) / len(seen.links)
        for way in np.eye(6):
            columns.append(load[:, None] * way)
            spreads.append(UNEVEN)
        noise = max(pad.force_sd_N for pad in seen.case.history.pads)
        around = np.abs(position - centre).reshape(-1, 3)
        reach = np.sqrt(np.array([np.mean(np.delete(around, k, axis=1) ** 2) * 2 for k in range(3)])) / ARM_MM
        count = len(seen.pad_of_marker) * variance_inflation(seen.tracks.lag1[:1])[0]
        weight = 1 / (noise**2 * count * np.concatenate([np.ones(3), reach**2]))
        nuisances = np.stack(columns)
        flat = nuisances.reshape(len(columns), -1)
        weighted = (nuisances * weight).reshape(len(columns), -1)
        inverse = np.linalg.inv(weighted @ flat.T + np.diag(np.array(spreads) ** -2.0))
        return cls(wrench(force, position, centre_mm=centre), weight, nuisances, inverse)

    def weighed(self, field: Float[np.ndarray, "f 6"]) -> Float[np.ndarray, "f 6"]:
        """W phi, 1/N for a field in N."""
        weighted = self.weight * field
        amounts = self.inverse @ np.tensordot(self.nuisances, weighted, axes=2)
        return np.asarray(weighted - self.weight * np.tensordot(amounts, self.nuisances, axes=1))
