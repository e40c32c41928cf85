"""Converts a raw grasp's frames to the recording that everything else reads."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay

from tactile.gel.fields import fields_of
from tactile.markers.gaps import at_times, filled, poses_at
from tactile.markers.pad_frames import (
    Progress,
    camera_of,
    losses_said,
    of_frames,
    of_markers,
    tracked_markers,
)
from tactile.markers.tracking import TrackedMarkers
from tactile.readers.pictures import gaps_said, unusable
from tactile.readers.raw_grasp import RawGrasp, RawPad
from tactile.readers.recording import Converted, GelPad, IndenterPad
from tactile.sensors import gel_constants
from tactile.square_pixels import with_square_pixels

MUCH_AT_EDGE = 0.2
"""If an outermost marker has more than this share of the largest marker's push, the contact extends beyond
it."""


@dataclass(frozen=True)
class _PadFields:
    time_s: Float[np.ndarray, " t"]
    kept: Bool[np.ndarray, " s"]
    pad: GelPad
    notes: list[str]


def recording_of(raw: RawGrasp, *, progress: Progress | None = None) -> Converted:
    """Displacement and force of every marker of every pad, at the first pad's frames.

    Frames that repeat the one before are left out; other pads' fields are interpolated at the first pad's
    times. Raises TactileFailure: no-markers or gel-saturated (reference or frames), wrong-sensor (the markers
    are not where the description has them), markers-lost, and whatever the frames' readers refuse.
    """
    raw = with_square_pixels(raw)
    read = [_fields(raw, pad, progress) for pad in raw.pads]
    start, end = (
        max(pad_fields.time_s[0] for pad_fields in read),
        min(pad_fields.time_s[-1] for pad_fields in read),
    )
    first = read[0]
    within = (first.time_s >= start) & (first.time_s <= end)
    when = first.time_s[within]
    rows = np.flatnonzero(first.kept)[within]
    if len(when) < 2:
        fault = "pads whose frames do not overlap in time"
        raise unusable(raw.source, fault, "one grasp in both; set time_offset_s")
    notes = [note for pad_fields in read for note in pad_fields.notes]
    if len(read) > 1 and not any(pad.sensor.serial for pad in raw.pads):
        notes.append(
            f"{raw.source}: no sensor has a serial number, so drupe cannot detect swapped pads with "
            "similar markers."
        )
    wrench_N = raw.recording.wrench_N
    recording = replace(
        raw.recording,
        time_s=when,
        aperture_mm=raw.recording.aperture_mm[rows],
        wrench_N=None if wrench_N is None else wrench_N[rows],
        pads=_with_jaw(tuple(_resampled(pad_fields, when) for pad_fields in read), raw, rows),
    )
    return Converted(recording=recording, notes=tuple(notes))


def _with_jaw(
    gels: tuple[GelPad, ...], raw: RawGrasp, rows: Int[np.ndarray, " t"]
) -> tuple[GelPad | IndenterPad, ...]:
    """The pads by name, with a plain jaw if any; its force is the gel's, equal and opposite."""
    if raw.plain_jaw is None:
        return gels
    pose, gel = raw.plain_jaw.pose[rows], gels[0]
    on_fruit = np.einsum("tij,tj->ti", gel.pose[:, :3, :3], gel.force_N.sum(axis=1))
    jaw = IndenterPad(
        name=raw.plain_jaw.name,
        pose=pose,
        force_z_N=-np.einsum("tj,tj->t", pose[:, :3, 2], on_fruit),
        indenter="plate",
        radius_mm=None,
    )
    return tuple(sorted((*gels, jaw), key=lambda pad: pad.name))


def _fields(raw: RawGrasp, pad: RawPad, progress: Progress | None) -> _PadFields:
    """One pad's tracked markers and their displacement and force, in every frame that is not a repetition."""
    source = f"{raw.source}/{pad.name}"
    camera = camera_of(pad)
    found_markers = tracked_markers(pad, pad.view, camera, source, progress)
    tracked, places, notes = found_markers.tracked, found_markers.places, found_markers.notes
    kept = ~found_markers.doubled
    second = None
    if pad.second is not None and pad.sensor.second_camera is not None:
        other = tracked_markers(
            pad, pad.second, pad.sensor.second_camera, f"{source} (second camera)", progress
        )
        kept &= ~other.doubled
        both = np.isin(places.described, other.places.described)
        order = {int(k): i for i, k in enumerate(other.places.described)}
        second = of_markers(other.tracked, [order[int(k)] for k in places.described[both]])
        tracked = of_markers(tracked, np.flatnonzero(both).tolist())
        notes += other.notes
    tracked = of_frames(tracked, kept)
    second = None if second is None else of_frames(second, kept)
    notes += losses_said(tracked, source)
    pictures = pad.view.pictures
    numbers = np.array(pictures.numbers, dtype=np.int64) if pictures.numbered else None
    notes += gaps_said(pad.time_s, source, numbers=numbers)
    if not kept.all():
        notes.append(f"{source}: {int((~kept).sum())} frames repeat the one before; drupe left them out.")
    fields = fields_of(pad.sensor, tracked, second=second)
    push_N = fields.force_N[:, :, 2]
    share = edge_share(fields.rest_mm, push_N[int(push_N.sum(axis=1).argmax())])
    if share > MUCH_AT_EDGE:
        notes.append(
            f"{source}: the contact reaches the edge of the markers ({share:.0%} of the maximum push "
            "there). The force beyond is missing: press closer to the middle, or less."
        )
    gel = GelPad(
        name=pad.name,
        pose=pad.pose[kept],
        rest_mm=fields.rest_mm,
        displacement_mm=filled(fields.rest_mm, fields.displacement_mm),
        force_N=fields.force_N,
        certainty=_least(tracked, second),
        reference_print=found_markers.reference_print,
        print_shown=None if found_markers.print_shown is None else found_markers.print_shown[kept],
        **gel_constants(pad.sensor),
    )
    return _PadFields(tracked.time_s, kept, gel, notes)


def _least(first: TrackedMarkers, second: TrackedMarkers | None) -> Float[np.ndarray, " t"] | None:
    """Certainty of each frame by the camera with the lower one."""
    if first.certainty is None or second is None or second.certainty is None:
        return first.certainty
    return np.asarray(np.minimum(first.certainty, second.certainty))


def _resampled(fields: _PadFields, when: Float[np.ndarray, " t"]) -> GelPad:
    """One pad's fields at the grasp's common times (s)."""
    pad = fields.pad
    return replace(
        pad,
        pose=poses_at(when, fields.time_s, pad.pose),
        displacement_mm=at_times(when, fields.time_s, pad.displacement_mm),
        force_N=at_times(when, fields.time_s, pad.force_N),
        certainty=None if pad.certainty is None else at_times(when, fields.time_s, pad.certainty),
        print_shown=None if pad.print_shown is None else at_times(when, fields.time_s, pad.print_shown),
    )


def edge_share(rest_mm: Float[np.ndarray, "n 3"], push_N: Float[np.ndarray, " n"]) -> float:
    """Greatest push of an outermost marker over the greatest of all; 0 where nothing pushes."""
    if push_N.max() <= 0:
        return 0.0
    mesh = Delaunay(rest_mm[:, :2])
    rows, across = np.nonzero(mesh.neighbors == -1)
    outermost = np.unique(np.concatenate([mesh.simplices[rows, (across + k) % 3] for k in (1, 2)]))
    return float(push_N[outermost].max() / push_N.max())
