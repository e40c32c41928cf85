"""A recorded grasp's forces put elsewhere on the fruit: contact, compliance columns, frames in time.

The pads' markers are laid on the skin at the new place along the pads' normals; their forces at a few loads,
brought to MOST_PATTERNS patterns, are solved for once. All protocols of one place and depth share that.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fem.estimation.finer_patterns import FinerPatterns
from fem.estimation.unit_response import tracks_of
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory, PadHistory
from fem.mesh.surface_points import locate
from fem.mismatch.design.candidate_grasps import Place, Protocol
from fem.mismatch.design.loading_course import LOADS, LoadingCourse
from fem.mismatch.mismatch_case import GraspCase, PadMotion
from fem.mismatch.model.baseline import Baseline, GraspResponse
from fem.solid.pad_link import PadLink, pad_link

MOST_PATTERNS = 2
"""Patterns of a candidate's forces: the load, and how the contact grows. Set by hand: a solution each, and of
each of the recordings' other causes."""
PROJECTIONS = 4
"""Steps along the pad's normal to the skin; each leaves a hundredth of a millimetre of the last's few tenths
where the skin is inclined by a tenth."""
MOST_GAP_MM, MOST_INCLINED_DEG = 0.5, 25.0
"""A place is out of reach where markers stay farther from the skin than this, or the skin under a pad is
inclined to it by more: it slides off where friction is below a half. Set by hand."""
MARKERS = 90
"""Of a pad's touching markers at most so many are followed, evenly spread, each for those left out beside it:
fields over a patch are smooth. Set by hand, to bound the time."""
AIR = 8
"""Frames without contact before and after a candidate's contact."""
HOLD_SHARES = (0.1, 0.3, 0.6, 1.0)
"""When, over the hold, there are frames: early ones for what relaxes fast."""


@dataclass(frozen=True, kw_only=True)
class PlacedCourse:
    """A loading course at one place; `kept`: the markers followed, `share`: for how many each stands.

    Forces, gel displacement (fruit frame), contacts at LOADS; `weights` of the patterns at each load. `pads`:
    those of the recording, of the markers followed, on the skin at the new place.
    """

    place: Place
    depth: float
    source: GraspResponse
    course: LoadingCourse
    pads: tuple[PadHistory, ...]
    turns: Float[np.ndarray, "p 3 3"]
    share: float
    force_N: Float[np.ndarray, "k n 3"]
    gel_mm: Float[np.ndarray, "k n 3"]
    touching: Bool[np.ndarray, "k n"]
    links: tuple[PadLink, ...]
    patterns: Float[np.ndarray, "r n 3"]
    weights: Float[np.ndarray, "k r"]
    moved: Float[np.ndarray, "r m 3"]
    response: Float[np.ndarray, "r n 3"]
    uneven: Float[np.ndarray, "n 3"]


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Frames of a protocol in contact: which load (of LOADS), in which cycle, going up or down, when."""

    level: Int[np.ndarray, " f"]
    cycle: Int[np.ndarray, " f"]
    rising: Bool[np.ndarray, " f"]
    time_s: Float[np.ndarray, " f"]

    @property
    def keys(self) -> list[tuple[int, int, bool]]:
        """What a law that knows no time depends on."""
        return list(zip(self.cycle.tolist(), self.level.tolist(), self.rising.tolist(), strict=True))


def placed_course(base: Baseline, place: Place, depth: float) -> PlacedCourse:
    """Raises FemFailure (OFF_SURFACE) where opposing jaws cannot grasp there."""
    source = base.grasps[place.source]
    course = LoadingCourse.of(source).deeper(source, depth)
    whose, pads, kept, turns = source.pad_of_marker, [], [], []
    centre = base.mesh.nodes_mm[base.mesh.outer_nodes].mean(axis=0)
    touched = np.asarray(course.touching.any(axis=0))
    most = max(int(touched[whose == k].sum()) for k in range(len(source.links)))
    every = max(1, -(-most // MARKERS))
    for number, pad in enumerate(source.case.history.pads):
        mine = np.flatnonzero((whose == number) & touched)[::every]
        if len(mine) < len(LOADS):
            raise FemFailure(FemProblem.OFF_SURFACE, f"pad {pad.name} hardly touches")
        numbers = mine - int(np.flatnonzero(whose == number)[0])
        turn = place.rotation @ source.case.turns[number]
        surface = centre + (pad.surface_mm[numbers] - centre) @ place.rotation.T
        on_skin = _on_skin(base, surface, turn[:, 2])
        kept.append(mine)
        turns.append(turn)
        pads.append(
            replace(
                pad,
                rest_mm=pad.rest_mm[numbers],
                surface_mm=on_skin,
                position_mm=pad.position_mm[:, numbers],
                gel_displacement_mm=pad.gel_displacement_mm[:, numbers],
                force_N=pad.force_N[:, numbers],
                episode=pad.episode[:, numbers],
            )
        )
    chosen, axes = np.concatenate(kept), np.stack(turns)
    along = axes[np.repeat(np.arange(len(pads)), [len(markers) for markers in kept])]
    whole = [course.force_N[:, whose == k].sum(axis=1) for k in range(len(pads))]
    parts = [course.force_N[:, markers] for markers in kept]
    # markers left out: those that stay take their force, pad by pad and load by load
    scaled = [
        part
        * (total[:, 2] / np.where(np.abs(part[:, :, 2].sum(axis=1)) > 0, part[:, :, 2].sum(axis=1), 1.0))[
            :, None, None
        ]
        for part, total in zip(parts, whole, strict=True)
    ]
    force = np.einsum("knx,nyx->kny", np.concatenate(scaled, axis=1), along)
    gel = np.einsum("knx,nyx->kny", course.gel_mm[:, chosen], along)
    left, size, right = np.linalg.svd(force.reshape(len(force), -1), full_matrices=False)
    count = min(MOST_PATTERNS, int((size > 0).sum()))
    patterns = right[:count].reshape(count, -1, 3)
    weights = left[:, :count] * size[:count]
    solid = base.solids[source.case.support]
    links = tuple(pad_link(pad, solid) for pad in pads)
    loads = np.zeros((count, len(base.mesh.nodes_mm), 3))
    ends = np.cumsum([len(markers) for markers in kept])[:-1]
    loads[:, solid.contact_nodes] = sum(
        link.nodal_force(pad_patterns)
        for link, pad_patterns in zip(links, np.split(patterns, ends, axis=1), strict=True)
    )
    moved = solid.displacement(loads)
    on_skin = moved[:, solid.contact_nodes]
    uneven = np.linalg.norm(source.uneven[chosen], axis=1, keepdims=True) / np.sqrt(3)
    return PlacedCourse(
        place=place,
        depth=depth,
        source=source,
        course=course,
        pads=tuple(pads),
        turns=axes,
        share=float(every),
        force_N=np.tensordot(weights, patterns, axes=1),
        gel_mm=gel,
        touching=course.touching[:, chosen],
        links=links,
        patterns=patterns,
        weights=weights,
        moved=moved,
        response=np.concatenate([link.at_markers(on_skin) for link in links], axis=1),
        uneven=depth**1.5 * np.repeat(uneven, 3, axis=1),
    )


def _on_skin(
    base: Baseline, points_mm: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 3"]:
    """Points moved along the pad's normal onto the skin; raises FemFailure out of reach."""
    for _ in range(PROJECTIONS):
        near = locate(base.mesh, points_mm)
        points_mm = points_mm + ((near.point_mm - points_mm) @ normal)[:, None] * normal
    near = locate(base.mesh, points_mm)
    inclined = np.rad2deg(np.arccos(np.clip(-near.normal.mean(axis=0) @ normal, -1.0, 1.0)))
    if near.distance_mm.max() > MOST_GAP_MM or inclined > MOST_INCLINED_DEG:
        raise FemFailure(FemProblem.OFF_SURFACE, "the jaws cannot close on the skin there")
    return np.asarray(near.point_mm)


def frames_of(course: LoadingCourse, protocol: Protocol) -> Frames:
    """Loading at the recorded course times its speed, hold, unloading as fast, again."""
    hold = course.hold_s if protocol.hold_s is None else protocol.hold_s
    rise = course.time_s / protocol.speed
    top, levels = len(LOADS) - 1, np.arange(len(LOADS))
    frames: list[tuple[int, int, bool, float]] = []
    begun = 0.0
    for cycle in range(protocol.cycles):
        frames += [(int(k), cycle, True, begun + float(rise[k])) for k in levels]
        peak = begun + float(rise[-1])
        if hold > 0:
            frames += [(top, cycle, True, peak + share * hold) for share in HOLD_SHARES]
        down = peak + hold
        frames += [(int(k), cycle, False, down + float(rise[-1] - rise[k])) for k in levels[-2::-1]]
        begun = down + float(rise[-1]) + course.frame_s
    level, cycle_of, rising, time_s = zip(*frames, strict=True)
    return Frames(
        level=np.array(level), cycle=np.array(cycle_of), rising=np.array(rising), time_s=np.array(time_s)
    )


def candidate_recording(
    placed: PlacedCourse, protocol: Protocol, *, name: str, compliance: float, rng: np.random.Generator
) -> GraspResponse:
    """The recording that such a grasp would give of the plain model at 1/E = `compliance`.

    Each cycle counts for as many numbers as that of the recording that it is made of. In the air each force
    is noise alone.
    """
    course, source = placed.course, placed.source
    frames = frames_of(course, protocol)
    apart = course.frame_s / protocol.speed
    air = apart * np.arange(1, AIR + 1)
    first = float(frames.time_s[0])
    gaps = [frames.time_s[k] - apart / 2 for k in np.flatnonzero(np.diff(frames.cycle)) + 1]
    contact = np.sort(np.concatenate([frames.time_s, gaps]))
    time = np.concatenate([first - air[::-1], contact, contact[-1] + air])
    used = np.isin(time, frames.time_s)
    at = np.flatnonzero(used)
    phase = np.full(len(time), "air", dtype=object)
    phase[at] = np.where(frames.rising, "load", "unload")
    held = np.r_[False, (frames.level[1:] == len(LOADS) - 1) & (frames.level[:-1] == len(LOADS) - 1)]
    phase[at[held]] = "hold"
    shares = placed.weights[frames.level]
    touching = placed.touching[frames.level]
    episode = np.full((len(time), touching.shape[1]), -1, dtype=np.int64)
    episode[at] = np.where(touching, frames.cycle[:, None], -1)
    force, gel = (np.zeros((len(time), touching.shape[1], 3)) for _ in range(2))
    force[at], gel[at] = placed.force_N[frames.level], placed.gel_mm[frames.level]
    response = np.tensordot(shares, placed.response, axes=(1, 0))
    ends = np.cumsum([len(pad.rest_mm) for pad in placed.pads])[:-1]
    quiet = np.setdiff1d(np.arange(len(time)), at)
    pads, motions, poses = [], [], []
    for number, (pad, own_force, own_gel, own_episode, pad_response) in enumerate(
        zip(
            placed.pads,
            np.split(force, ends, axis=1),
            np.split(gel, ends, axis=1),
            np.split(episode, ends, axis=1),
            np.split(response, ends, axis=1),
            strict=True,
        )
    ):
        felt = own_force.copy()
        felt[quiet] = pad.force_sd_N * rng.normal(size=felt[quiet].shape)
        position = np.broadcast_to(pad.surface_mm, own_force.shape).copy()
        position[at] += compliance * pad_response
        pads.append(
            replace(
                pad,
                position_mm=position,
                gel_displacement_mm=own_gel,
                force_N=felt,
                episode=own_episode,
            )
        )
        pose = _pose(placed, number, frames, time, at, protocol.speed)
        poses.append(pose)
        motions.append(
            PadMotion(
                name=pad.name,
                pose=pose,
                normal_N=(felt @ placed.turns[number][:, 2]).sum(axis=1),
                markers=len(pad.rest_mm),
                gel_N_per_mm=source.case.pads[number].gel_N_per_mm,
            )
        )
    history = GraspHistory(time_s=time, phase=tuple(map(str, phase)), pads=tuple(pads))
    case = GraspCase(name=name, history=history, pads=tuple(motions), support=source.case.support)
    tracks = tracks_of(
        history,
        used,
        normal=np.vstack([link.place.normal for link in placed.links]),
        unit_displacement=response,
    )
    size = np.linalg.norm(force[at], axis=2).sum(axis=1)
    # each frame and marker stands for several of those recorded: with it fewer numbers count as one
    share = len(at) / (course.frames * protocol.cycles)
    return GraspResponse(
        case=case,
        prepared=history,
        used=used,
        links=placed.links,
        tracks=replace(tracks, lag1=np.full(len(tracks.sd_mm), float(source.tracks.lag1.mean()))),
        force_N=force[at],
        force_sd_N=source.force_sd_N * float(np.sqrt(share * placed.share)),
        patterns=placed.patterns,
        shares=shares,
        moved=placed.moved,
        response=placed.response,
        pose=np.stack([pose[at] for pose in poses]),
        load=size / size.max(),
        uneven=placed.uneven,
        denoised=(),
        finer=FinerPatterns.none(len(placed.patterns)),
        kept=source.kept * share / placed.share,
    )


def _pose(
    placed: PlacedCourse,
    pad: int,
    frames: Frames,
    time: Float[np.ndarray, " t"],
    at: Int[np.ndarray, " f"],
    speed: float,
) -> Float[np.ndarray, "t 4 4"]:
    """Of one pad: it travels along its normal as in the recorded loading, at constant speed in the air."""
    travel = placed.course.travel_mm[pad]
    way = np.interp(time, time[at], travel[frames.level])
    before, after = np.maximum(time[at[0]] - time, 0.0), np.maximum(time - time[at[-1]], 0.0)
    way -= placed.course.speed_mm_per_s[pad] * speed * (before + after)
    pose = np.tile(np.eye(4), (len(time), 1, 1))
    turn = placed.turns[pad]
    middle = placed.pads[pad].surface_mm.mean(axis=0) - turn @ placed.pads[pad].rest_mm.mean(axis=0)
    pose[:, :3, :3] = turn
    pose[:, :3, 3] = middle + way[:, None] * turn[:, 2]
    return pose
