"""Least squares over markers in all frames, with all that is each marker's or frame's own eliminated.

Where a marker sits, its scale error and the fruit's rigid motion are unknown in every recording (fem.
compliance_fit). With them eliminated, normal equations of fields phi consist of the products

    N_ij = phi_i . W phi_j,      W = V - V A (A' V A + L)^-1 A' V

V: inverse variance, the mean over each contact taken out; A: rigid motions and scales, L their priors. So
much does not depend on the fields; one more field costs two passes over the markers.
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
"""Design effect: residuals of a model correlate between neighbouring markers and frames, so that so many
numbers count as one independent. Effects that are not
there then gain a few units of ln evidence on sound recordings of two solvers; with a third of it skins and
soft jaws gain ten times as much, and one that is there only twice. On truth that is converged a quarter of it
was tried on few cases (docs/validation.md, Scope)."""
LEAST_NOISE_SHARE = 0.016
"""Noise of a marker over the root mean square of the response; a quieter sensor counts as if it had so much.
The plain model's own error is about half of it, however quiet the sensor: it then adds a quarter to the
variance at most. Chosen on sound fruit of linear flesh of the sealed
proof: all three with noise below 0.012 were false alarms, two of nine up to 0.024, none of 25
above (`benchmarks/sealed/sealed_proof.py`)."""
_AT_ONCE = 24
"""Fields at once: memory, nothing else."""


@dataclass(frozen=True)
class MarkerEquations:
    """W of one recording's markers, in the form in which it is applied.

    Fields are laid out flat, d numbers: x, y, z of every marker in contact, frame by frame. `member`: which
    number belongs to which contact of a marker's component. `every_frame`: k fields that each frame has any
    amount of (f k columns): its rigid motion where the fruit moves (`free`), and the response to what noise
    adds to each force pattern. `marker_fields`: four fields B that each marker may have any amount of, with
    their priors' weight in `inverse`: its gel displacement (a scale error), and a shift along x, y, z that
    grows with the load (what scale errors of the forces around it bring). `inverse`: (B' V B + L)^-1;
    `along`: B' V times `every_frame`; `motions`: the Cholesky factor of the normal equations of
    `every_frame`, B out.
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

        `design_effect`: how many numbers count as one; 1 where what is left is held against noise itself (of
        LEAST_NOISE_SHARE at least).
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
        """The fruit's turn in each frame that a field in mm shows, rad, about the axes; zero if it is held.

        About its mean over a contact: no more is known of a marker that may sit anywhere.
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
        """Less the mean over each contact."""
        return np.asarray(flat - self.member @ ((self.member.T @ flat) / self._contact_frames))

    def _residual(self, flat: Float[np.ndarray, "d q"]) -> Float[np.ndarray, "d q"]:
        mine = self._about_mean(flat)
        motion, amounts = self._fitted(mine)
        return np.asarray(mine - self._about_mean(self.every_frame @ motion) - self.marker_fields @ amounts)

    def _fitted(
        self, mine: Float[np.ndarray, "d q"]
    ) -> tuple[Float[np.ndarray, "m q"], Float[np.ndarray, "n4 q"]]:
        """Amounts of what each frame may have any amount of, and of what each marker may."""
        weighted = self.weight_in_contact[:, None] * mine
        amounts = _by_marker(self.inverse, self.marker_fields.T @ weighted)
        motion = cho_solve(self.motions, self.every_frame.T @ weighted - self.along.T @ amounts)
        return np.asarray(motion), amounts - _by_marker(self.inverse, self.along @ motion)


def _sparse_rows(
    blocks: Float[np.ndarray, "e 3 k"], column: Int[np.ndarray, " e"], columns: int
) -> csr_array:
    """Blocks of three rows one below the other, each in the k columns of its own number."""
    count, _, wide = blocks.shape
    places = np.repeat(wide * column[:, None] + np.arange(wide), 3, axis=0)
    shape = (3 * count, wide * columns)
    return csr_array((blocks.ravel(), places.ravel(), np.arange(0, blocks.size + 1, wide)), shape=shape)


def _by_marker(matrices: Float[np.ndarray, "n 4 4"], columns: Float[np.ndarray, "n4 q"]) -> np.ndarray:
    """Each marker's matrix times its four rows."""
    return np.asarray((matrices @ columns.reshape(len(matrices), 4, -1)).reshape(columns.shape))


def _root_mean_square(tracks: MarkerTracks) -> float:
    """Of a component of the unit response about its mean over a contact, where markers touch, mm MPa."""
    about = about_episode_mean(tracks.unit_displacement, tracks.episode)
    return float(np.sqrt((about**2).sum() / max(3 * (tracks.episode >= 0).sum(), 1)))


SHIFT_SD_MM, TURN_SD_DEG, UNEVEN = 0.5, 0.15, 1e-3
"""A priori: pads' places, their turns, and the share of force that scales of single markers leave uneven."""
AT_REST = 1.0
"""A priori: share of the markers' way that the arms of the moments leave out. None of it for real fruit, all
where flesh is taken to move little, as two simulators do: a pad that shears by 1.2 mm then turns a sound
fruit by 0.3 N at 20 mm, fifteen times the noise."""
CENTRE_SD_MM, NO_WEIGHT_N = 10.0, 1e-6
"""How far the centre of weight may lie from the middle between the pads; a weight that is none."""


@dataclass(frozen=True)
class BalanceEquations:
    """W of the six sums of force and moment of a fruit that nothing but its pads holds.

    Noise is that of all markers' forces together. Nuisances: each pad a little elsewhere and turned, an
    imbalance that grows with the load, from the scales of single markers, the fruit's own weight, and whether
    moments balance where the markers are (flesh in large motion) or where they were at rest (small motion).
    Where gels stick, the force of every marker that they pull is added to the noise, as a standard deviation
    (fem.mismatch.model.pulling_markers): a rim of pull is narrower than a marker's square, which counts it in
    full or not at all.
    """

    measured: Float[np.ndarray, "f 6"]
    weight: Float[np.ndarray, "f 6"]
    nuisances: Float[np.ndarray, "k f 6"]
    inverse: Float[np.ndarray, "k k"]

    @classmethod
    def of(
        cls, recording: GraspResponse, *, weight_N: float = 0.0, gels_stick: bool = False
    ) -> "BalanceEquations":
        """From the recording's own forces; the fruit's weight pulls in a direction that nobody says."""
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
