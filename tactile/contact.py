"""When and where the pads touch: no-contact frames, onset per marker, contact patch, phases, total force."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from tactile.consistency.faults import print_without_force
from tactile.noise import FEWEST_NO_CONTACT_FRAMES, MOST_LAG1, Noise, no_contact_noise, noise_in_contact
from tactile.readers.recording import GelPad, Recording
from tactile.reference_print import WHAT_TO_DO
from tactile.tactile_failure import TactileFailure, TactileProblem

BEYOND_NOISE = 4.0
"""A marker touches when its normal force exceeds this many standard deviations (3e-5 of a Gaussian)."""
LESSER_OF_TWO = 0.8
"""The lesser of two overlapping means of two frames exceeds so many times BEYOND_NOISE of its own standard
deviations as rarely (3e-5) as a single value exceeds BEYOND_NOISE: bivariate normal, correlation 0.5, which
is that of white noise. Noise that correlates in time exceeds it somewhat more often."""
TOTAL_BEYOND_NOISE = 8.0
"""A pad touches when its total normal force exceeds this many of its own (coloured noise has wide tails)."""
STARTS_IN_CONTACT = 0.2
"""A recording whose quiet first frames carry more than this share of the peak force starts in contact."""
REACH_CELLS = 2.5
"""Markers within this many spacings of touching ones belong to the patch. The rim's force is below the noise
of one marker, not of many; without the rim the fruit is 1-2 % too stiff."""
LAST_FRAMES, LET_GO = 0.05, 0.1
"""Share of the frames, three at least, that measure drift at the end of a recording. Most force there of
formerly pressed markers beyond all others, as a share of the greatest force, if the pad has let go. Set by
hand: it separates drifts that end at 5 to 60 standard deviations of a marker from a broad contact
(tests/tactile/test_contact.py)."""
MEDIAN_SD = 1.2533
"""Standard deviation of the median of many Gaussian numbers over that of their mean: root of pi / 2."""


class Phase(StrEnum):
    """What the machine does in a frame."""

    AIR = "air"
    LOAD = "load"
    HOLD = "hold"
    UNLOAD = "unload"


@dataclass(frozen=True, kw_only=True)
class PadContact:
    """One pad's contact history. Positions and forces are in the fruit frame, forces without their offset.

    `episode[t, n]` numbers the contacts of marker n from 0, -1 without contact; `onset[n]` is the first frame
    of its first episode, -1 if it never touches. `patch`: the markers that carry force.
    """

    name: str
    pose: Float[np.ndarray, "t 4 4"]
    rest_mm: Float[np.ndarray, "n 3"]
    position_mm: Float[np.ndarray, "t n 3"]
    gel_displacement_mm: Float[np.ndarray, "t n 3"]
    force_N: Float[np.ndarray, "t n 3"]
    total_normal_N: Float[np.ndarray, " t"]
    episode: Int[np.ndarray, "t n"]
    onset: Int[np.ndarray, " n"]
    patch: Bool[np.ndarray, " n"]
    spacing_mm: float
    displacement_noise: Noise
    force_noise: Noise


@dataclass(frozen=True, kw_only=True)
class Contact:
    """The contact of a whole recording."""

    time_s: Float[np.ndarray, " t"]
    phase: tuple[Phase, ...]
    pads: tuple[PadContact, ...]
    no_contact_frames: int


def find_contact(recording: Recording, *, source: str) -> Contact:
    """Contact histories of all pads of `recording`; `source` names it in failures (the file's name).

    Noise comes from the frames before any pad touches. If these are too few (or a deadband writes exact zeros
    there), it comes from second differences in contact. Raises TactileFailure: no-markers for a bare
    indenter, never-touches if a pad's force stays within its noise in every frame.
    """
    gels = tuple(_require_gel(pad, source=source) for pad in recording.pads)
    no_contact_frames = min(frames_in_air(pad) for pad in gels)
    pads = tuple(_pad_contact(pad, no_contact_frames=no_contact_frames, source=source) for pad in gels)
    touched = np.any([(pad.episode >= 0).any(axis=1) for pad in pads], axis=0)
    closing = -1.0 if recording.loading == "grasp" else 1.0
    return Contact(
        time_s=recording.time_s,
        phase=_phases(closing * recording.aperture_mm, recording.time_s, touched),
        pads=pads,
        no_contact_frames=no_contact_frames,
    )


def contact_said(contact: Contact) -> list[str]:
    """One line on each pad for users: when it touches, how often, and with which force at most."""
    lines = []
    for pad in contact.pads:
        at = np.flatnonzero((pad.episode >= 0).any(axis=1))
        times = 1 + int((np.diff(at) > 1).sum())
        again = f" in {times} contacts" if times > 1 else ""
        first, last = contact.time_s[at[[0, -1]]]
        most = pad.total_normal_N.max()
        lines.append(f"{pad.name}: contact from {first:.2f} to {last:.2f} s{again}, up to {most:.2f} N")
    return lines


def _require_gel(pad: object, *, source: str) -> GelPad:
    if not isinstance(pad, GelPad):
        name = getattr(pad, "name", "?")
        raise TactileProblem.NO_MARKERS.failure(
            f"{source}: pads/{name}: found a bare indenter (force_z_N, no markers), expected marker "
            "displacement and force. Record with a gel with markers on at least one jaw. For plates "
            "around a fruit, remove photos and mesh and give three diameters in fruits.csv.",
        )
    return pad


def frames_in_air(pad: GelPad) -> int:
    """Number of leading frames without contact: their total normal force does not rise above its noise.

    Noise is that of single markers or, if larger, that common to all. A recording that starts in contact has
    0 such frames.
    """
    total = pad.force_N[:, :, 2].sum(axis=1)
    markers = noise_in_contact(pad.force_N).sd * np.sqrt(len(pad.rest_mm))
    common = noise_in_contact(total[:, None, None] * np.ones((1, 1, 3))).sd
    # The drift of a sensor at rest is slow; contact is a rise above the running mean of the frames before.
    running = np.cumsum(total) / np.arange(1, len(total) + 1)
    rises = total[1:] - running[:-1] > max(TOTAL_BEYOND_NOISE * max(markers, common), 1e-9)
    air = int(np.argmax(rises)) + 1 if rises.any() else len(total)
    return 0 if running[air - 1] > STARTS_IN_CONTACT * total.max() > 0 else air


def _pad_contact(pad: GelPad, *, no_contact_frames: int, source: str) -> PadContact:
    """One pad's noise, offset and contact episodes. Raises TactileFailure if it never touches."""
    # One frame of guard: the first touch begins between two frames.
    quiet = slice(0, max(no_contact_frames - 1, 0))
    # A deadband writes exact zeros: such frames show no noise, frames in contact do.
    silent = no_contact_frames > 1 and float((pad.force_N[quiet] == 0.0).mean()) > 0.5
    measure = (
        no_contact_noise
        if no_contact_frames - 1 >= FEWEST_NO_CONTACT_FRAMES and not silent
        else noise_in_contact
    )
    still = quiet if measure is no_contact_noise else slice(None)
    moved, pushed = measure(pad.displacement_mm[still]), measure(pad.force_N[still])
    moved = _with_reference(moved, pad)
    displacement = pad.displacement_mm - moved.offset
    force = pad.force_N - pushed.offset
    total = force[:, :, 2].sum(axis=1)
    spacing, mean = neighbourhood(pad.rest_mm)
    without_drift = force - _drift(force[:, :, 2], pushed.sd)[:, None, None] * np.array([0.0, 0.0, 1.0])
    touching = touching_over_time(without_drift[:, :, 2], measure(without_drift[still]), mean)
    peak = int(np.argmax(total))
    noise_of_total = pushed.sd * np.sqrt(len(pad.rest_mm))
    if not touching.any() or total[peak] <= TOTAL_BEYOND_NOISE * noise_of_total:
        if (contradiction := print_without_force(pad)) is not None:
            raise TactileProblem.IMPLAUSIBLE_RECORDING.failure(
                f"{source}: the {pad.name} pad's {contradiction}."
            )
        raise _never_touches(
            pad.name, total, noise_of_total, source=source, pictured=pad.print_shown is not None
        )
    touched = np.asarray(touching.any(axis=0))
    reach = cKDTree(pad.rest_mm[touched]).query(pad.rest_mm)[0]
    patch = np.asarray(reach) <= REACH_CELLS * spacing
    rotation, shift = pad.pose[:, :3, :3], pad.pose[:, None, :3, 3]
    return PadContact(
        name=pad.name,
        pose=pad.pose,
        rest_mm=pad.rest_mm,
        position_mm=np.einsum("tij,tnj->tni", rotation, pad.rest_mm + displacement) + shift,
        gel_displacement_mm=np.einsum("tij,tnj->tni", rotation, displacement),
        force_N=np.einsum("tij,tnj->tni", rotation, force),
        total_normal_N=total,
        episode=_episodes(touching),
        onset=np.where(touched, touching.argmax(axis=0), -1),
        patch=patch,
        spacing_mm=spacing,
        displacement_noise=moved,
        force_noise=pushed,
    )


def _with_reference(moved: Noise, pad: GelPad) -> Noise:
    """The displacement's noise plus the error of the places at rest, which is the same in all frames."""
    if pad.place_sd_mm == 0.0:
        return moved
    common = pad.place_sd_mm**2
    total = moved.sd**2 + common
    lag1 = min((moved.lag1 * moved.sd**2 + common) / max(total, 1e-30), MOST_LAG1)
    return Noise(offset=moved.offset, sd=float(np.sqrt(total)), lag1=lag1)


def _never_touches(
    pad: str, total_N: Float[np.ndarray, " t"], noise_N: float, *, source: str, pictured: bool
) -> TactileFailure:
    """The failure of a pad that measures no force, or a pull, which is a sensor's wrong sign.

    `pictured`: its force comes from pictures, so that a reference under the same load hides a contact.
    """
    unless = (
        (
            " If it does touch, the reference may be under the same load as the frames, too smoothly to "
            f"see: {WHAT_TO_DO}."
        )
        if pictured
        else ""
    )
    field = f"{source}: pads/{pad}/force_N"
    if -total_N.min() > max(TOTAL_BEYOND_NOISE * noise_N, 1e-9):
        detail = (
            f"{field}: found a total of {total_N.min():.3g} N along the pad's z, expected a push "
            "(positive z). The forces have the sign of the sensor's load; write the force of the gel "
            "on the fruit."
        )
    else:
        detail = (
            f"{field}: found at most {total_N.max():.3g} N in {len(total_N)} frames with noise of "
            f"{noise_N:.3g} N, expected a contact. The pad never touches the fruit: record again and "
            f"close the jaws farther.{unless}"
        )
    return TactileProblem.NEVER_TOUCHES.failure(detail)


def neighbourhood(rest_mm: Float[np.ndarray, "n 3"]) -> tuple[float, csr_array]:
    """Median distance of nearest markers; and the matrix (n, n) whose rows average over the markers within
    1.6 of it (9 on a square grid, the marker itself too).
    """
    tree = cKDTree(rest_mm)
    spacing = float(np.median(np.asarray(tree.query(rest_mm, k=[2])[0])))
    near = tree.query_ball_point(rest_mm, r=1.6 * spacing)
    count = np.array([len(neighbours) for neighbours in near])
    ends = np.concatenate([[0], np.cumsum(count)])
    return spacing, csr_array((np.repeat(1 / count, count), np.concatenate(list(near)), ends))


def _drift(normal_N: Float[np.ndarray, "t n"], sd: float) -> Float[np.ndarray, " t"]:
    """Drift that all markers' normal forces share, N, frame by frame; zero if none remains at the end.

    A force that grows in all markers would otherwise count as contact, and the pad would never seem to let
    go. In each frame the drift is the median of the less loaded half of the markers, between the drift at the
    beginning and that at the end: a broad contact is no drift. At the beginning it is not zero, since the
    frames without contact have a mean of zero.
    """
    most = normal_N.max(axis=0)
    count = max(int(LAST_FRAMES * len(normal_N)), 3)
    last = normal_N[-count:].mean(axis=0)
    start, end = float(np.median(normal_N[:count])), float(np.median(last))
    held = float(np.median(last[most >= most.max() / 2])) - end
    if held > LET_GO * most.max() or abs(end) < BEYOND_NOISE * MEDIAN_SD * sd / np.sqrt(len(last)):
        return np.zeros(len(normal_N))
    level = np.median(normal_N[:, most <= np.median(most)], axis=1)
    return np.asarray(np.clip(level, min(start, end, 0.0), max(start, end, 0.0)))


def touching_over_time(
    normal_N: Float[np.ndarray, "t n"], noise: Noise, mean: csr_array
) -> Bool[np.ndarray, "t n"]:
    """Markers that touch in each frame, by the lesser of two means: of a frame with the one before, and with
    the next.

    The force of a frame alone selects by its own noise: a marker at the rim would count as touching where its
    force is read too large, and the fit would take that for a deeper dent and a skin. `noise`: of one force.
    `mean`: as in touching_markers.
    """
    pairs_N = (normal_N[1:] + normal_N[:-1]) / 2
    lesser_N = np.minimum(np.vstack([normal_N[:1], pairs_N]), np.vstack([pairs_N, normal_N[-1:]]))
    sd_of_pairs_N = noise.sd * ((1 + noise.lag1) / 2) ** 0.5
    return touching_markers(lesser_N, LESSER_OF_TWO * sd_of_pairs_N, mean)


def touching_markers(
    normal_N: Float[np.ndarray, "t n"], sd: float, mean: csr_array
) -> Bool[np.ndarray, "t n"]:
    """Markers beyond the noise whose mean with their neighbours is beyond its noise too.

    `mean`: the matrix of that mean (neighbourhood).
    """
    around = np.asarray(mean @ normal_N.T).T
    floor = max(sd, 1e-9)
    of_mean = floor / np.sqrt(np.diff(mean.indptr))
    return np.asarray((normal_N > BEYOND_NOISE * floor) & (around > BEYOND_NOISE * of_mean))


def _episodes(touching: Bool[np.ndarray, "t n"]) -> Int[np.ndarray, "t n"]:
    """Runs of frames in contact, numbered per marker; a single missing frame does not end a run."""
    bridged = touching.copy()
    bridged[1:-1] |= touching[:-2] & touching[2:]
    starts = bridged & ~np.vstack([np.zeros((1, touching.shape[1]), dtype=bool), bridged[:-1]])
    return np.where(bridged, np.cumsum(starts, axis=0) - 1, -1)


def _phases(
    closing_mm: Float[np.ndarray, " t"], time_s: Float[np.ndarray, " t"], touched: Bool[np.ndarray, " t"]
) -> tuple[Phase, ...]:
    """Phases by the machine's own travel: closing loads, standing still holds, opening unloads, no contact is
    air.

    Still means slower than a twentieth of the greatest speed, on the step to the frame.
    """
    if len(time_s) < 2:
        return tuple(Phase.HOLD if touch else Phase.AIR for touch in touched)
    speed = np.diff(closing_mm) / np.diff(time_s)
    still = 0.05 * np.abs(speed).max()
    arriving = np.concatenate([speed[:1], speed])
    kinds = np.select([~touched, arriving > still, arriving < -still], ["air", "load", "unload"], "hold")
    return tuple(Phase(str(kind)) for kind in kinds)
