"""The plain model of the fruit and of its recordings, with the fields that effects change.

A recording's forces are projected on patterns f_r (fem.estimation.prepared_grasp), and the model solves for
each pattern once,

    U_r = K0^-1 L f_r,        c(t) = sum_r a_r(t) L' U_r,        U(t) = sum_r a_r(t) U_r

with L of fem.solid.pad_link: c is the displacement of the markers for E = 1 MPa, U that of the whole flesh.
Every effect inside the fruit is a function of U.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from fem.elements.assembly import assemble
from fem.estimation.compliance_fit import MarkerTracks
from fem.estimation.denoised_force import DenoisedForce
from fem.estimation.finer_patterns import FinerPatterns, with_finer_patterns
from fem.estimation.prepared_grasp import FEWEST_PRESSED, prepared_grasp, thinned_grasp
from fem.estimation.unit_response import tracks_of
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory
from fem.mismatch.mismatch_case import GraspCase, MismatchCase
from fem.parallel_map import parallel_map
from fem.solid.linear_solid import Support, UnitModulusSolid
from fem.solid.pad_link import PadLink, pad_link

PROBES = 8
"""Random draws of single markers' force errors, to estimate the scatter of displacement by them."""
ARM_MM = 20.0
"""Length by which moments are divided to compare with forces."""
Fields: TypeAlias = Sequence[Float[np.ndarray, "_f _n 3"]]
"""One field of the markers for each recording."""


@dataclass(frozen=True, kw_only=True)
class GraspResponse:
    """One recording projected on the plain model, in its frames `used`.

    `solid`: the flesh with this recording's support. `prepared`: the recording with the forces and contacts
    that drive the model. `tracks`: markers of all pads side by side, with c(t) as `unit_displacement`.
    `force_N`: their forces (fem.estimation.denoised_force), `force_sd_N`: remaining noise of one component,
    `patterns` and `shares` (f r): the factors of these forces. `moved`: U_r of the whole flesh, mm MPa,
    `response`: L' U_r, at the markers. `pose`: of each pad in these frames. `load`: total force over its
    greatest, frame by frame. `uneven`: standard deviation of each marker's displacement (times E, mm MPa) at
    the greatest load from errors of single markers' forces: their scales, and the noise in the patterns.
    `kept`: the share of the loaded frames that are used. `denoised`: how each pad's forces were denoised.
    `finer`: which of the patterns are smoothed, and how. `finer_noise`: responses of the finer mesh to draws
    of the forces' noise, by pattern (fem.mismatch.model.force_noise); None without that mesh.
    """

    case: GraspCase
    solid: UnitModulusSolid
    prepared: GraspHistory
    used: Bool[np.ndarray, " t"]
    links: tuple[PadLink, ...]
    tracks: MarkerTracks
    force_N: Float[np.ndarray, "f n 3"]
    force_sd_N: float
    patterns: Float[np.ndarray, "r n 3"]
    shares: Float[np.ndarray, "f r"]
    moved: Float[np.ndarray, "r m 3"]
    response: Float[np.ndarray, "r n 3"]
    pose: Float[np.ndarray, "p f 4 4"]
    load: Float[np.ndarray, " f"]
    uneven: Float[np.ndarray, "n 3"]
    denoised: tuple[DenoisedForce, ...]
    finer: FinerPatterns
    kept: float = 1.0
    finer_noise: Float[np.ndarray, "p q n 3"] | None = None

    @property
    def time_s(self) -> Float[np.ndarray, " f"]:
        """Times of the frames used."""
        return np.asarray(self.case.history.time_s[self.used])

    @property
    def pad_of_marker(self) -> Int[np.ndarray, " n"]:
        """The number of each marker's pad."""
        return self.case.history.pad_of_marker

    @property
    def pad_names(self) -> tuple[str, ...]:
        """Names of the pads in order."""
        return tuple(pad.name for pad in self.case.history.pads)

    @property
    def leading(self) -> Int[np.ndarray, " r"]:
        """Indices of the patterns for which other laws of flesh are solved: all but the finer ones."""
        after = self.finer.first + self.finer.count
        return np.asarray(np.r_[: self.finer.first, after : len(self.patterns)])

    @property
    def touching(self) -> Bool[np.ndarray, "f n"]:
        """Which markers touch, in the frames used."""
        return self.tracks.episode >= 0

    def excess(
        self, compliance: float, unit: Float[np.ndarray, "f n 3"] | None = None
    ) -> Float[np.ndarray, "f n 3"]:
        """The markers' positions less their places and s c, mm; `unit`: c (default: the plain model's).

        The fruit's rigid motion is included.
        """
        moved = compliance * (self.tracks.unit_displacement if unit is None else unit)
        return np.asarray(self.tracks.position_mm - self.tracks.place_mm - moved)

    def loads(self, force_N: Float[np.ndarray, "r n 3"]) -> Float[np.ndarray, "r m 3"]:
        """Forces on the markers as forces on all nodes of the flesh."""
        return nodal_loads(self.links, self.solid, force_N)

    def at_markers(self, moved: Float[np.ndarray, "r m 3"]) -> Float[np.ndarray, "r n 3"]:
        """Displacement of the markers for a displacement of all nodes."""
        return self.seen(moved[:, self.solid.contact_nodes])

    def seen(self, on_skin: Float[np.ndarray, "r c 3"]) -> Float[np.ndarray, "r n 3"]:
        """Displacement of the markers for a displacement of the contact nodes."""
        return seen(self.links, on_skin)

    def response_to(self, force_N: Float[np.ndarray, "r n 3"]) -> Float[np.ndarray, "r n 3"]:
        """Displacement (times E) of all markers under any forces on the markers."""
        return self.at_markers(self.solid.displacement(self.loads(force_N)))

    def over_time(self, by_pattern: Float[np.ndarray, "r n 3"]) -> Float[np.ndarray, "f n 3"]:
        """Responses to the first patterns, summed in each frame with the recording's shares."""
        return np.asarray(np.tensordot(self.shares[:, : len(by_pattern)], by_pattern, axes=(1, 0)))

    @property
    def added(self) -> Float[np.ndarray, "f n 3"]:
        """What c(t) has beyond the patterns' `response`, mm MPa: a finer mesh, and confirmed effects."""
        return np.asarray(self.tracks.unit_displacement - self.over_time(self.response))

    def whole(self, by_pattern: Float[np.ndarray, "r n 3"]) -> Float[np.ndarray, "f n 3"]:
        """c(t) of another law with these responses to all patterns on this mesh."""
        return np.asarray(self.over_time(by_pattern) + self.added)

    def over_all_frames(self, values: Float[np.ndarray, "f ..."]) -> Float[np.ndarray, "t ..."]:
        """Values of the frames used, extended to all frames for laws with a history: zero without contact,
        interpolated in between, constant before the first and after the last known frame.
        """
        time = self.case.history.time_s
        touching = np.any([(pad.episode >= 0).any(axis=1) for pad in self.case.history.pads], axis=0)
        known = self.used | ~touching
        whole = np.zeros((len(time), *values.shape[1:]))
        whole[self.used] = values
        at = np.flatnonzero(known)
        for frame in np.flatnonzero(~known):
            after = int(np.searchsorted(at, frame))
            a, b = at[max(after - 1, 0)], at[min(after, len(at) - 1)]
            share = (time[frame] - time[a]) / (time[b] - time[a]) if b > a else 0.0
            whole[frame] = (1 - share) * whole[a] + share * whole[b]
        return whole

    def own_markers(self, pad: int | str) -> Bool[np.ndarray, "1 n 1"]:
        """Mask of one pad's markers (by number or name), to broadcast to fields; False for an absent pad."""
        names = np.array(self.pad_names)[self.pad_of_marker]
        mine = names == pad if isinstance(pad, str) else self.pad_of_marker == pad
        return np.asarray(mine)[None, :, None]

    def turn_of(self, pad: int) -> Float[np.ndarray, "3 3"]:
        """Pad axes in the fruit frame, as columns, at the greatest force."""
        greatest = int(np.argmax(np.linalg.norm(self.force_N, axis=2).sum(axis=1)))
        return np.asarray(self.pose[pad, greatest, :3, :3])

    def pad_force(self, pad: int) -> Float[np.ndarray, "f 3"]:
        """Total force of one pad on the fruit, N."""
        return np.asarray(self.force_N[:, self.pad_of_marker == pad].sum(axis=1))

    @property
    def centre_mm(self) -> Float[np.ndarray, "3"]:
        """The markers' mean position, about which moments are taken."""
        return np.asarray(self.tracks.position_mm.mean(axis=(0, 1)))

    def wrench(
        self, force_N: Float[np.ndarray, "f n 3"], position_mm: Float[np.ndarray, "*f n 3"] | None = None
    ) -> Float[np.ndarray, "f 6"]:
        """Sums of forces (N) and of their moments about `centre_mm` over ARM_MM (N); at the markers' own
        positions unless given.
        """
        position = self.tracks.position_mm if position_mm is None else position_mm
        moment = np.cross(position - self.centre_mm, force_N).sum(axis=1)
        return np.hstack([force_N.sum(axis=1), moment / ARM_MM])


def nodal_loads(
    links: Sequence[PadLink], solid: UnitModulusSolid, force_N: Float[np.ndarray, "r n 3"]
) -> Float[np.ndarray, "r m 3"]:
    """Forces on the markers of several pads as forces on all nodes of a solid."""
    parts = np.split(force_N, np.cumsum([len(link.place.point_mm) for link in links])[:-1], axis=1)
    loads = np.zeros((len(force_N), len(solid.mesh.nodes_mm), 3))
    loads[:, solid.contact_nodes] = sum(
        link.nodal_force(part) for link, part in zip(links, parts, strict=True)
    )
    return loads


def seen(links: Sequence[PadLink], on_skin: Float[np.ndarray, "r c 3"]) -> Float[np.ndarray, "r n 3"]:
    """Displacement of the markers of several pads for a displacement of the contact nodes."""
    return np.concatenate([link.at_markers(on_skin) for link in links], axis=1)


@dataclass(frozen=True, kw_only=True)
class PlainModel:
    """The solid for each kind of support, and the recordings projected on it."""

    case: MismatchCase
    solids: dict[Support, UnitModulusSolid]
    grasps: tuple[GraspResponse, ...]

    def displacements(
        self, nodal_N: Sequence[Float[np.ndarray, "_ m 3"]]
    ) -> list[Float[np.ndarray, "_ m 3"]]:
        """Displacement (times E) of the whole flesh under each recording's loads, with its support.

        Solving for all recordings together costs half of solving for one after the other.
        """
        displacements = [np.zeros(0)] * len(nodal_N)
        for support, solid in self.solids.items():
            supported = [k for k, recording in enumerate(self.grasps) if recording.case.support == support]
            moved = solid.displacement(np.concatenate([nodal_N[k] for k in supported]))
            cuts = np.cumsum([len(nodal_N[k]) for k in supported])[:-1]
            for k, part in zip(supported, np.split(moved, cuts), strict=True):
                displacements[k] = part
        return displacements


def plain_model(
    case: MismatchCase, *, solids: Mapping[Support, UnitModulusSolid] | None = None, workers: int = 1
) -> PlainModel:
    """The plain model with all patterns solved; `solids`: factorised before, as in `solids_of`. Raises
    FemFailure as its parts do.
    """
    held = solids_of(case, solids or {})
    return PlainModel(
        case=case,
        solids=held,
        grasps=tuple(
            parallel_map(
                lambda grasp: project_recording(
                    grasp, held[grasp.support], force_scale_sd=case.budget.force_scale_sd
                ),
                case.grasps,
                workers=workers,
            )
        ),
    )


def solids_of(
    case: MismatchCase, solids: Mapping[Support, UnitModulusSolid]
) -> dict[Support, UnitModulusSolid]:
    """The solid for each kind of support: from `solids` if it has this case's mesh and Poisson's ratio, else
    factorised here.

    The whole skin counts as contact, which only numbers its nodes. Raises FemFailure.
    """
    skin = np.sort(case.mesh.outer_nodes)
    parts = None
    by_support: dict[Support, UnitModulusSolid] = {}
    for support in dict.fromkeys(grasp.support for grasp in case.grasps):
        solid = solids.get(support)
        if solid is None or solid.mesh is not case.mesh or solid.poisson_ratio != case.poisson_ratio:
            parts = assemble(case.mesh.nodes_mm, case.mesh.tets) if parts is None else parts
            solid = UnitModulusSolid.factorise(
                case.mesh, poisson_ratio=case.poisson_ratio, support=support, parts=parts
            )
        by_support[support] = replace(solid, contact_nodes=skin)
    return by_support


def project_recording(
    case: GraspCase, solid: UnitModulusSolid, *, force_scale_sd: float, most_frames: int | None = None
) -> GraspResponse:
    """One recording projected on a solid; `force_scale_sd`: relative scale errors of single markers' forces;
    `most_frames`: number of loaded frames that are used, evenly spread (None: all).
    """
    history = case.history
    try:
        prepared = prepared_grasp(history, case.turns)
    except FemFailure as failure:
        raise FemFailure(failure.problem, f"{case.name}: {failure.detail}") from failure
    prepared, finer = with_finer_patterns(prepared, history)
    whole = int(prepared.used.sum())
    prepared = prepared if most_frames is None else thinned_grasp(prepared, most_frames)
    used, patterns, shares = prepared.used, prepared.patterns, prepared.shares
    for pad_history in prepared.history.pads:
        if not (pad_history.episode >= 0).any():
            raise FemFailure(
                FemProblem.NO_LOAD,
                f"{case.name}: pad {pad_history.name} never presses at {FEWEST_PRESSED} markers at once; "
                "the finder needs a contact that covers more: press deeper, or use a finer marker grid",
            )
    force = prepared.force_N
    links = tuple(pad_link(pad, solid) for pad in history.pads)
    size = np.linalg.norm(force, axis=2).sum(axis=1)
    rng = np.random.default_rng(0)
    uneven = force_scale_sd * rng.normal(size=(PROBES, force.shape[1], 1))
    uneven = uneven * np.tensordot(shares[size.argmax()], patterns, axes=1)
    uneven += (
        prepared.coloured_sd_N * _noise_of_patterns(shares, size.argmax()) * rng.normal(size=uneven.shape)
    )
    loads = nodal_loads(links, solid, np.concatenate([patterns, uneven]))
    moved, probed = np.split(solid.displacement(loads), [len(patterns)])
    response = seen(links, moved[:, solid.contact_nodes])
    return GraspResponse(
        case=case,
        solid=solid,
        prepared=prepared.history,
        used=used,
        links=links,
        tracks=tracks_of(
            prepared.history,
            used,
            normal=np.vstack([link.place.normal for link in links]),
            unit_displacement=np.tensordot(shares, response, axes=(1, 0))
            + (0.0 if case.correction is None else case.correction[used]),
        ),
        force_N=force,
        force_sd_N=prepared.force_sd_N,
        patterns=patterns,
        shares=shares,
        moved=moved,
        response=response,
        pose=np.stack([pad.pose[used] for pad in case.pads]),
        load=size / size.max(),
        uneven=_spread(links, probed[:, solid.contact_nodes]),
        kept=float(used.sum() / whole),
        denoised=prepared.denoised,
        finer=finer,
    )


def _noise_of_patterns(shares: Float[np.ndarray, "f r"], frame: int) -> float:
    """Noise of one marker's force in a frame after projection on patterns, over its recorded noise.

    The noise of a pattern is that of a mean over the frames in which it acts.
    """
    return float(np.linalg.norm(shares[frame] / np.linalg.norm(shares, axis=0)))


def _spread(links: Sequence[PadLink], moved: Float[np.ndarray, "r c 3"]) -> Float[np.ndarray, "n 3"]:
    """Root mean square, over draws and each pad's markers, of the deviation from the pad's mean."""
    spreads = []
    for link in links:
        recording = link.at_markers(moved)
        deviation = recording - recording.mean(axis=1, keepdims=True)
        spreads.append(np.broadcast_to(np.sqrt((deviation**2).mean(axis=(0, 1))), deviation.shape[1:]))
    return np.concatenate(spreads)
