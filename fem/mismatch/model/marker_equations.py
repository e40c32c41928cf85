"""Least squares over markers in all frames, with unknowns of single markers and frames eliminated.

A marker's place, its scale error and the fruit's rigid motion are unknown in every recording
(fem.estimation.compliance_fit). With them eliminated, normal equations of fields phi consist of the products

    N_ij = phi_i . W phi_j,      W = V - V A (A' V A + L)^-1 A' V

V: inverse variance, after subtraction of the mean over each contact; A: rigid motions and scales, L: their
prior precisions. W does not depend on the fields; one more field costs two passes over the markers.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from fem.estimation.coloured_noise import variance_inflation
from fem.estimation.compliance_fit import (
    GAUGE_SD_MM,
    MarkerTracks,
    about_episode_mean,
    marker_weight,
    mean_radius_mm,
    motion_equations,
    rigid_motion,
)
from fem.mismatch.model.plain_model import ARM_MM, GraspResponse
from fem.mismatch.model.pulling_markers import pull_N

MARKER_VARIANCE_INFLATION = 1.15
"""Variance of the plain model's residual on null recordings, over that of their noise without contact."""
DESIGN_EFFECT = 15.0
"""Design effect: residuals of a model correlate between neighbouring markers and frames, so this many
numbers count as one independent number. Absent effects then gain a few units of log evidence on recordings of
two solvers without mismatch. With a third of it, absent skins and soft jaws gain ten times as much, and a
present effect only twice. On converged truth a quarter of it was tried on few cases (docs/validation.md,
Scope)."""
LEAST_NOISE_SHARE = 0.016
"""Least noise of a marker, over the root mean square of the response; a quieter sensor is assigned this
noise. The plain model's own error is about half of it for any sensor: it then adds a quarter to the variance
at most. Chosen on the blind test's fruit of linear flesh without mismatch: all three with noise below 0.012
were false alarms, two of nine up to 0.024, none of 25 above (`benchmarks/sealed/sealed_proof.py`)."""
_AT_ONCE = 24
"""Fields processed at once, to limit memory."""


@dataclass(frozen=True)
class MarkerEquations:
    """W of one recording's markers, in the form in which it is applied.

    Fields are flat vectors of d numbers: x, y, z of every marker in contact, frame by frame. `member`:
    incidence of numbers in contacts, for each component. `every_frame`: k fields with an unknown amount in
    each frame (f k columns): rigid motion if the fruit moves (`free`), and the response to the noise of each
    force pattern. `marker_fields`: four fields B with an unknown amount for each marker: its gel displacement
    (a scale error), and a shift along x, y, z in proportion to the load (from scale errors of the forces
    around it). `inverse`: (B' V B + L)^-1, L: prior precisions of these amounts; `along`: B' V times
    `every_frame`; `motions`: the Cholesky factor of the normal equations of `every_frame` after elimination
    of B.
    """

    tracks: MarkerTracks
    weight: Float[np.ndarray, " n"]
    member: csr_array
    every_frame: csr_array
    marker_fields: csr_array
    inverse: Float[np.ndarray, "n 4 4"]
    along: Float[np.ndarray, "n4 m"]
    motions: tuple[np.ndarray, bool]
    free: bool

    @classmethod
    def of(
        cls,
        recording: GraspResponse,
        *,
        compliance: float,
        gel_scale_sd: float,
        design_effect: float = DESIGN_EFFECT,
    ) -> "MarkerEquations":
        """`compliance`: 1/E; `gel_scale_sd`: relative scale errors of single markers' displacement.

        `design_effect`: how many numbers count as one; 1 where residuals are compared with noise itself (at
        least LEAST_NOISE_SHARE).
        """
        tracks = recording.tracks
        least_mm = LEAST_NOISE_SHARE * compliance * _root_mean_square(tracks)
        believed = replace(tracks, sd_mm=np.maximum(tracks.sd_mm, least_mm))
        weight = marker_weight(believed) / (MARKER_VARIANCE_INFLATION * design_effect)
        noise_N = recording.force_sd_N * float(np.sqrt(variance_inflation(tracks.lag1).mean()))
        felt = compliance * noise_N * np.moveaxis(recording.response, 0, 2)
        free = recording.case.support == "free"
        every_frame = np.concatenate([rigid_motion(tracks.place_mm), felt], axis=2)[:, :, 0 if free else 6 :]
        frame, marker = np.nonzero(tracks.episode >= 0)
        load = np.broadcast_to(recording.load[:, None, None], tracks.position_mm.shape)
        marker_fields = np.concatenate(
            [
                about_episode_mean(tracks.gel_displacement_mm, tracks.episode)[frame, marker, :, None],
                about_episode_mean(load, tracks.episode)[frame, marker, :, None] * np.eye(3),
            ],
            axis=2,
        )
        of_marker = (weight[marker], (marker, np.arange(len(marker))))
        by_marker = csr_array(of_marker, shape=(len(weight), len(marker)))
        squares = np.einsum("exa,exb->eab", marker_fields, marker_fields, optimize=True).reshape(
            len(marker_fields), -1
        )
        normal = (by_marker @ squares).reshape(-1, 4, 4)
        scale = np.column_stack([np.full(len(weight), gel_scale_sd), compliance * recording.uneven])
        normal[:, np.arange(4), np.arange(4)] += scale**-2
        inverse = np.linalg.inv(normal)
        motion_columns = _sparse_rows(every_frame[marker], frame, len(tracks.position_mm))
        own_columns = _sparse_rows(marker_fields, marker, len(weight))
        each = np.repeat(weight[marker], 3)
        along = (own_columns.T @ (motion_columns * each[:, None])).toarray()
        equations = motion_equations(every_frame, weight, tracks.episode)
        equations -= along.T @ _by_marker(inverse, along)
        prior = np.ones(every_frame.shape[2])
        if free:
            prior[:6] = GAUGE_SD_MM**-2
        equations[np.diag_indices_from(equations)] += np.tile(prior, len(tracks.position_mm))
        contacts = marker * (tracks.episode.max() + 1) + tracks.episode[frame, marker]
        _, contact = np.unique(contacts, return_inverse=True)
        return cls(
            tracks=tracks,
            weight=weight,
            member=_sparse_rows(
                np.tile(np.eye(3), (len(marker), 1, 1)), contact, int(contact.max(initial=-1)) + 1
            ),
            every_frame=motion_columns,
            marker_fields=own_columns,
            inverse=inverse,
            along=along,
            motions=cho_factor(equations),
            free=free,
        )

    def weighed(self, field: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """W phi, 1/mm for a field in mm; its dot product with another field is an entry of N."""
        return np.asarray(self.weight[:, None] * self.residual(field))

    def residual(self, field: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """A field's residual after motions, scales and places are fitted, mm; zero out of contact."""
        touching = self.tracks.episode >= 0
        residual = np.zeros_like(field)
        residual[touching] = self._residual(field[touching].reshape(-1, 1)).reshape(-1, 3)
        return residual

    def weighed_in_contact(self, flat: Float[np.ndarray, "q d"]) -> Float[np.ndarray, "q d"]:
        """`weighed` of several fields laid out flat."""
        weighed = np.empty_like(flat)
        for first in range(0, len(flat), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            weighed[some] = self.weight_in_contact * self._residual(flat[some].T).T
        return weighed

    def turns(self, field: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f 3"]:
        """The fruit's rotation vector in each frame, fitted to a field in mm, rad; zero if the fruit is held.

        It is relative to its mean over a contact, since the markers' places are unknown.
        """
        if not self.free:
            return np.zeros((len(field), 3))
        motion, _ = self._fitted(self._about_mean(field[self.tracks.episode >= 0].reshape(-1, 1)))
        return np.asarray(motion.reshape(len(field), -1)[:, 3:6] / mean_radius_mm(self.tracks.place_mm))

    @cached_property
    def weight_in_contact(self) -> Float[np.ndarray, " d"]:
        """`weight` of each number of a field laid out flat."""
        return np.repeat(self.weight[np.nonzero(self.tracks.episode >= 0)[1]], 3)

    @cached_property
    def _contact_frames(self) -> Float[np.ndarray, "c 1"]:
        return np.asarray(self.member.sum(axis=0))[:, None]

    def _about_mean(self, flat: Float[np.ndarray, "d q"]) -> Float[np.ndarray, "d q"]:
        """`flat` less the mean of each contact."""
        return np.asarray(flat - self.member @ ((self.member.T @ flat) / self._contact_frames))

    def _residual(self, flat: Float[np.ndarray, "d q"]) -> Float[np.ndarray, "d q"]:
        mine = self._about_mean(flat)
        motion, amounts = self._fitted(mine)
        return np.asarray(mine - self._about_mean(self.every_frame @ motion) - self.marker_fields @ amounts)

    def _fitted(
        self, mine: Float[np.ndarray, "d q"]
    ) -> tuple[Float[np.ndarray, "m q"], Float[np.ndarray, "n4 q"]]:
        """Fitted amounts of `every_frame` and of `marker_fields`."""
        weighted = self.weight_in_contact[:, None] * mine
        amounts = _by_marker(self.inverse, self.marker_fields.T @ weighted)
        motion = cho_solve(self.motions, self.every_frame.T @ weighted - self.along.T @ amounts)
        return np.asarray(motion), amounts - _by_marker(self.inverse, self.along @ motion)


def _sparse_rows(
    blocks: Float[np.ndarray, "e 3 k"], column: Int[np.ndarray, " e"], columns: int
) -> csr_array:
    """Sparse matrix of blocks of three rows; block e fills the k columns of number `column[e]`."""
    count, _, wide = blocks.shape
    places = np.repeat(wide * column[:, None] + np.arange(wide), 3, axis=0)
    shape = (3 * count, wide * columns)
    return csr_array((blocks.ravel(), places.ravel(), np.arange(0, blocks.size + 1, wide)), shape=shape)


def _by_marker(matrices: Float[np.ndarray, "n 4 4"], columns: Float[np.ndarray, "n4 q"]) -> np.ndarray:
    """Each marker's matrix times its four rows."""
    return np.asarray((matrices @ columns.reshape(len(matrices), 4, -1)).reshape(columns.shape))


def _root_mean_square(tracks: MarkerTracks) -> float:
    """RMS of a component of the unit response about its contact mean, over touching markers, mm MPa."""
    about = about_episode_mean(tracks.unit_displacement, tracks.episode)
    return float(np.sqrt((about**2).sum() / max(3 * (tracks.episode >= 0).sum(), 1)))


SHIFT_SD_MM, TURN_SD_DEG, UNEVEN = 0.5, 0.15, 1e-3
"""Prior standard deviations: pads' shift and rotation, and the share of force unbalanced by marker scales."""
AT_REST = 1.0
"""Prior standard deviation: share of the markers' displacement that the moment arms omit. It is 0 for real
fruit and 1 at small strain, as in two simulators. A pad sheared by 1.2 mm then gives fruit without mismatch a
moment of 0.3 N at 20 mm, fifteen times the noise."""
CENTRE_SD_MM, NO_WEIGHT_N = 10.0, 1e-6
"""Prior standard deviation of the centre of gravity from the markers' mean position; least weight."""


@dataclass(frozen=True)
class BalanceEquations:
    """W of the six components of resultant force and moment of a fruit that only its pads hold.

    Noise is that of all markers' forces together. Nuisances are a small shift and rotation of each pad, an
    imbalance in proportion to the load (from marker scales), the fruit's weight, and the choice of moment
    arms. These reach to the markers' current positions (large motion) or to those at rest (small motion). If
    gels stick, the force of every pulling marker is added to the noise, as a standard deviation
    (fem.mismatch.model.pulling_markers). The pulled rim is narrower than a marker's square, which counts it
    in full or not at all.
    """

    measured: Float[np.ndarray, "f 6"]
    weight: Float[np.ndarray, "f 6"]
    nuisances: Float[np.ndarray, "k f 6"]
    inverse: Float[np.ndarray, "k k"]

    @classmethod
    def of(
        cls, recording: GraspResponse, *, weight_N: float = 0.0, gels_stick: bool = False
    ) -> "BalanceEquations":
        """From the recording's own forces; the direction of the fruit's weight is unknown."""
        position, force = recording.tracks.position_mm, recording.force_N
        centre = recording.centre_mm
        columns, spreads = [], []
        for pad in range(len(recording.links)):
            pad_force_N = np.where(recording.own_markers(pad), force, 0.0)
            total = pad_force_N.sum(axis=1)
            for way in np.eye(3):
                columns.append(np.hstack([np.zeros_like(total), np.cross(way, total) / ARM_MM]))
                columns.append(recording.wrench(np.cross(way, pad_force_N)) * np.pi / 180)
                spreads += [SHIFT_SD_MM, TURN_SD_DEG]
        load = np.linalg.norm(force, axis=2).sum(axis=1) / len(recording.links)
        for way in np.eye(6):
            columns.append(load[:, None] * way)
            spreads.append(UNEVEN)
        for k, way in enumerate(np.eye(6)):
            columns.append(np.tile(way, (len(force), 1)))
            spreads.append(max(weight_N, NO_WEIGHT_N) * (1.0 if k < 3 else CENTRE_SD_MM / ARM_MM))
        at_rest = np.broadcast_to(recording.tracks.place_mm, position.shape)
        columns.append(recording.wrench(force) - recording.wrench(force, at_rest))
        spreads.append(AT_REST)
        noise = recording.force_sd_N
        around = np.abs(position - centre).reshape(-1, 3)
        reach = np.sqrt(np.array([np.mean(np.delete(around, k, axis=1) ** 2) * 2 for k in range(3)])) / ARM_MM
        count = len(recording.pad_of_marker) * variance_inflation(recording.tracks.lag1[:1])[0]
        pull = pull_N(recording.case)[recording.used] if gels_stick else np.zeros_like(force)
        moment = np.cross(position - centre, pull) / ARM_MM
        between = (np.concatenate([pull, moment], axis=2) ** 2).sum(axis=1)
        weight = 1 / (noise**2 * count * np.concatenate([np.ones(3), reach**2]) + between)
        nuisances = np.stack(columns)
        flat = nuisances.reshape(len(columns), -1)
        weighted = (nuisances * weight).reshape(len(columns), -1)
        inverse = np.linalg.inv(weighted @ flat.T + np.diag(np.array(spreads) ** -2.0))
        return cls(recording.wrench(force), weight, nuisances, inverse)

    def weighed(self, field: Float[np.ndarray, "f 6"]) -> Float[np.ndarray, "f 6"]:
        """W phi, 1/N for a field in N."""
        weighted = self.weight * field
        amounts = self.inverse @ np.tensordot(self.nuisances, weighted, axes=2)
        return np.asarray(weighted - self.weight * np.tensordot(amounts, self.nuisances, axes=1))
