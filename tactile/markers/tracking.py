"""Tracks markers through a sequence with one frame in memory, and identifies them in the description."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import cKDTree

from tactile.gel.gel_sides import GelOutline
from tactile.gel_camera import on_gel, project
from tactile.markers.marker_detection import (
    OUTSIDE,
    Blobs,
    MarkerLook,
    centred,
    contrast,
    disc_radius_px,
    find_blobs,
    find_look,
    grey,
    inside,
    markers_of,
    spacing_of,
    uncut,
)
from tactile.markers.marker_lattice import Lattice, lattice_of, neighbours_say, whole_displacement
from tactile.markers.matching import match, relabelled
from tactile.sensors import GelCamera
from tactile.tactile_failure import TactileProblem

FEWEST_MARKERS = 9
"""Fewest markers on the reference for a field of displacement: three by three. Set by hand."""
BLOB_CONTRAST = 0.3
"""Least peak of a blob in a later frame, over the median marker's on the reference."""
FAINT = 0.35
"""Least peak of a marker sought where its neighbours predict it, over its own on the reference."""
FAINT_REACH = 0.3
"""Largest distance of such a marker from its predicted place, in spacings."""
TORN = 0.6
"""Difference from its neighbours' motion, in spacings, above which a marker is lost."""
REACH = 0.4
"""Largest distance of a marker from its described place, in spacings."""
ENOUGH = 0.8
"""Least share of the markers within REACH."""


@dataclass(frozen=True, kw_only=True)
class TrackedMarkers:
    """Places of all markers in all frames of one camera, px; pixel (0, 0) is the centre of the first one.

    `reference_px`: markers in the unloaded image, with the lens's distortion; `position_px`: NaN if a marker
    is lost or hidden. `rest_mm`: each marker's place on the undeformed gel, gel frame; the sensor's own if it
    states them. `certainty`: the least of the frames so far (FrameMarkers); None: unknown.
    """

    time_s: Float[np.ndarray, " t"]
    reference_px: Float[np.ndarray, "n 2"]
    position_px: Float[np.ndarray, "t n 2"]
    rest_mm: Float[np.ndarray, "n 3"]
    certainty: Float[np.ndarray, " t"] | None = None

    @property
    def torn(self) -> Bool[np.ndarray, " n"]:
        """Markers missing in the last frame, if it shows more than half of all."""
        lost = ~np.isfinite(self.position_px[-1, :, 0])
        return np.asarray(lost & bool(lost.mean() < 0.5))


@dataclass(frozen=True)
class ReferenceMarkers:
    """The unloaded gel as a camera sees it; `disc_px` is the markers' radius."""

    look: MarkerLook
    markers: Blobs
    lattice: Lattice
    shape: tuple[int, int]
    disc_px: float


@dataclass(frozen=True)
class FrameMarkers:
    """One frame: `position_px` (NaN if lost) of every marker of the reference.

    `blobs_px`: all candidates, from which later frames can correct the labels. `certainty`: 0 if the markers
    could as well be a pitch of their grid further, 1 if they could not.
    """

    position_px: Float[np.ndarray, "n 2"]
    blobs_px: Float[np.ndarray, "m 2"]
    certainty: float


def reference_of(frame: UInt8[np.ndarray, "h w *c"], *, source: str) -> ReferenceMarkers:
    """The markers of an unloaded gel; `source` names the frame in a failure.

    Raises TactileFailure (no-markers) for fewer than nine.
    """
    intensity = grey(frame)
    look = find_look(intensity)
    shown = contrast(intensity, look)
    markers = markers_of(shown, look)
    count = len(markers.peak)
    if count < FEWEST_MARKERS:
        raise TactileProblem.NO_MARKERS.failure(
            f"{source}: found {count} markers, expected at least {FEWEST_MARKERS}; use a picture of "
            "the untouched gel, in focus and with its lights on.",
        )
    shape = (intensity.shape[0], intensity.shape[1])
    spacing = spacing_of(markers.centre_px)
    lattice = lattice_of(markers.centre_px, spacing, shape=shape, margin_px=look.radius_px)
    return ReferenceMarkers(look, markers, lattice, shape, disc_radius_px(shown, markers))


def follow(
    reference: ReferenceMarkers, frames: Iterable[UInt8[np.ndarray, "h w *c"]]
) -> Iterator[FrameMarkers]:
    """Every frame's markers, in the frames' order.

    Blobs are detected in each frame separately, so errors do not accumulate; earlier frames determine only
    which blob is which marker. The first frame may already be loaded.
    """
    rest = reference.lattice.rest_px
    moved, speed = np.zeros_like(rest), np.zeros_like(rest)
    for frame in frames:
        markers = _markers_in(reference, frame, moved, speed)
        now = whole_displacement(reference.lattice, markers.position_px)
        moved, speed = now, now - moved
        yield markers


def track(
    reference: ReferenceMarkers, frames: Iterable[UInt8[np.ndarray, "h w *c"]]
) -> Float[np.ndarray, "t n 2"]:
    """Positions (px, NaN if lost) over all frames, with labels corrected by later frames."""
    return labelled_places(reference, list(follow(reference, frames)))


def labelled_places(reference: ReferenceMarkers, rows: Sequence[FrameMarkers]) -> Float[np.ndarray, "t n 2"]:
    """Positions (px, NaN if lost) in these frames, with labels corrected by later frames."""
    before = np.array([row.position_px for row in rows]).reshape(-1, *reference.lattice.rest_px.shape)
    return relabelled(reference.lattice, before, [row.blobs_px for row in rows])


def _markers_in(
    reference: ReferenceMarkers,
    frame: UInt8[np.ndarray, "h w *c"],
    moved: Float[np.ndarray, "n 2"],
    speed: Float[np.ndarray, "n 2"],
) -> FrameMarkers:
    """Places of all markers in one frame, from their motion and speed (px) in the frame before."""
    look, lattice, usual = reference.look, reference.lattice, reference.markers
    shown = contrast(grey(frame), look)
    blobs = find_blobs(shown, look, least=BLOB_CONTRAST * float(np.median(usual.peak)))
    margin = -OUTSIDE * reference.disc_px
    blobs = replace(blobs, centre_px=uncut(blobs.centre_px, reference.shape, reference.disc_px))
    blobs = blobs.of(inside(blobs.centre_px, reference.shape, margin))
    guesses = [moved + speed, moved, np.zeros_like(moved)]
    best = match(lattice, guesses, blobs.centre_px)
    count = len(lattice.rest_px)
    position = np.full((count, 2), np.nan)
    position[best.matched] = blobs.centre_px[best.blob[best.matched]]
    _look_for_lost(reference, shown, position)
    _give_up_contradicted(lattice, position)
    return FrameMarkers(position, blobs.centre_px, best.certainty)


def _look_for_lost(
    reference: ReferenceMarkers, shown: Float[np.ndarray, "h w"], position: Float[np.ndarray, "n 2"]
) -> None:
    """Fills in the markers that are fainter than a blob but lie where their neighbours predict them."""
    lattice = reference.lattice
    known = np.isfinite(position[:, 0])
    if known.all() or not known.any():
        return
    start = (lattice.rest_px + whole_displacement(lattice, position))[~known]
    tried = centred(shown, start, reference.look)
    radius = reference.disc_px
    tried = replace(tried, centre_px=uncut(tried.centre_px, reference.shape, radius))
    near = np.linalg.norm(tried.centre_px - start, axis=1) < FAINT_REACH * lattice.spacing_px
    clear = tried.peak > FAINT * reference.markers.peak[~known]
    whole = inside(tried.centre_px, reference.shape, -OUTSIDE * radius)
    taken = position[known]
    apart = (
        np.linalg.norm(tried.centre_px[:, None] - taken[None], axis=2).min(axis=1) > 0.4 * lattice.spacing_px
    )
    lost = np.flatnonzero(~known)
    good = near & clear & whole & apart
    position[lost[good]] = tried.centre_px[good]


def _give_up_contradicted(lattice: Lattice, position: Float[np.ndarray, "n 2"]) -> None:
    """Sets markers to NaN whose displacement contradicts the estimate by their neighbours (TORN)."""
    known = np.isfinite(position[:, 0])
    if not known.any():
        return
    displacement = np.where(known[:, None], position - lattice.rest_px, 0.0)
    say = neighbours_say(lattice, displacement, known)
    wrong = known & (np.linalg.norm(displacement - say, axis=1) > TORN * lattice.spacing_px)
    position[wrong] = np.nan


@dataclass(frozen=True)
class Places:
    """The reference's markers that the description has; `kept`: their indices in the reference.

    `described`: their indices in the description; without one, in the reference.
    """

    kept: Int[np.ndarray, " n"]
    described: Int[np.ndarray, " n"]
    rest_mm: Float[np.ndarray, "n 3"]


def places_of(
    camera: GelCamera,
    reference_px: Float[np.ndarray, "n 2"],
    rest_mm: Float[np.ndarray, "m 3"] | None,
    *,
    shape: tuple[int, int],
    source: str,
    outline: GelOutline | None = None,
) -> Places:
    """Each marker's rest place: the described one at which it appears. Without a description, where its ray
    meets the face (of `outline`, else a plane).

    Raises TactileFailure (wrong-sensor) if the image's size (height, width) or the markers' places differ.
    """
    width, height = camera.image_px
    if shape != (height, width):
        raise TactileProblem.WRONG_SENSOR.failure(
            f"{source}: found frames of {shape[1]} x {shape[0]} pixels, expected {width} x {height} "
            "as in the sensor's description; check that the description belongs to this sensor.",
        )
    if rest_mm is None:
        every = np.arange(len(reference_px))
        return Places(every, every, on_gel(camera, reference_px, outline))
    expected_px = project(camera, rest_mm)
    away, which = cKDTree(expected_px).query(reference_px)
    spacing = spacing_of(reference_px)
    near = np.asarray(away) < REACH * spacing
    kept = np.flatnonzero(near)
    single = len(np.unique(np.asarray(which)[kept])) == len(kept)
    spacing_differs = abs(spacing_of(expected_px) / spacing - 1.0) if spacing else np.inf
    if near.mean() < ENOUGH or not single or spacing_differs > REACH:
        raise TactileProblem.WRONG_SENSOR.failure(
            f"{source}: found {int(near.sum())} of {len(near)} markers at their places in the "
            f"sensor's description (spacing {spacing:.1f} px, described {spacing_of(expected_px):.1f} "
            f"px), expected at least {ENOUGH:.0%}. Check that the description belongs to this sensor "
            "and that the pads are not swapped.",
        )
    described = np.asarray(which)[kept]
    return Places(kept, described, rest_mm[described])
