"""The untouched markers that a pad's frames are held against: seen in a picture of it, or estimated."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, UInt8

from tactile.gel_camera import project
from tactile.io.frame_checks import refuse_saturated
from tactile.io.pictures import Pictures
from tactile.io.raw_grasp import RawCamera, RawGrasp
from tactile.markers.estimated_reference import estimated_reference
from tactile.markers.marker_lattice import lattice_of
from tactile.markers.reference_places import places_of
from tactile.markers.smooth_lattice import lattice_places
from tactile.markers.tracking import FrameMarkers, ReferenceMarkers, reference_of
from tactile.reference_print import WHAT_TO_DO, ShownPrint, becomes_flatter, shown_print
from tactile.sensors import GelCamera, Sensor
from tactile.square_pixels import with_square_pixels
from tactile.tactile_failure import TactileFailure

LOOKED_AT = 12
"""Frames of a recording in which a print is looked for, evenly spaced: each takes about 0.08 s at 320 x 240
pixels, as two or three frames of tracking do."""


@dataclass(frozen=True, kw_only=True)
class PadReference:
    """The markers at rest; `shown`: the print on their picture, None of an estimate, whose places have the
    standard deviation `sd_px`.
    """

    markers: ReferenceMarkers
    shown: ShownPrint | None
    sd_px: Float[np.ndarray, " n"] | None
    notes: tuple[str, ...]


@dataclass
class PrintWatch:
    """Looks for a print in some of the frames that pass by: `shown[t]`."""

    reference: ReferenceMarkers
    sensor: Sensor
    camera: GelCamera
    frames: int
    shown: dict[int, ShownPrint] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._at = set(looked_at(self.frames))

    def look(self, t: int, frame: UInt8[np.ndarray, "h w 3"], found: FrameMarkers) -> None:
        """Keeps how much of a print frame `t` shows, if it is one of those that are looked at."""
        if t in self._at and np.isfinite(found.position_px[:, 0]).any():
            self.shown[t] = shown_print(
                frame,
                self.reference,
                camera=self.camera,
                described_mm=self.sensor.rest_mm,
                position_px=found.position_px,
            )

    def over_time(self) -> Float[np.ndarray, " t"] | None:
        """Of every frame, straight between those looked at; None where there are none."""
        if not self.shown:
            return None
        at = sorted(self.shown)
        return np.interp(np.arange(self.frames), at, [self.shown[t].evidence for t in at])

    def flatter_frame(self, known: PadReference) -> int | None:
        """The frame whose gel is clearly flatter than the reference's (`becomes_flatter`)."""
        if known.shown is None:
            return None
        return next((t for t in sorted(self.shown) if becomes_flatter(known.shown, self.shown[t])), None)


def looked_at(frames: int) -> list[int]:
    """The numbers of the frames in which a print is looked for."""
    at = np.unique(np.linspace(0, frames - 1, min(frames, LOOKED_AT)).round().astype(int))
    return [int(t) for t in at]


def pad_reference(sensor: Sensor, view: RawCamera, camera: GelCamera, *, source: str) -> PadReference:
    """The markers of the reference's picture, or those estimated from the least loaded of the frames.

    Raises TactileFailure: gel-saturated, no-markers where there are too few or too few unloaded ones,
    wrong-sensor where they are not as the description has them.
    """
    if view.estimated:
        return _estimated(sensor, view, camera, source)
    refuse_saturated(view.reference, f"{source}: reference")
    markers = reference_of(view.reference, source=f"{source}: reference")
    rest_px = markers.lattice.rest_px
    places_of(camera, rest_px, sensor.rest_mm, shape=markers.shape, source=source)
    shown = shown_print(view.reference, markers, camera=camera, described_mm=sensor.rest_mm)
    notes = () if shown.evidence < 1.0 else (f"{source}: {bears_print_said(shown, view.reference_from)}",)
    return PadReference(markers=markers, shown=shown, sd_px=None, notes=notes)


def references_said(raw: RawGrasp) -> list[str]:
    """A sentence on each pad whose reference bears a print; raises as `pad_reference` does."""
    said: list[str] = []
    for pad in with_square_pixels(raw).pads:
        if pad.sensor.camera is not None:
            source = f"{raw.source}/{pad.name}"
            try:
                found = pad_reference(pad.sensor, pad.view, pad.sensor.camera, source=source)
            except TactileFailure as failure:
                read = f"drupe read {pad.view.reference_from} and {pad.described_in}"
                raise TactileFailure(failure.problem, f"{failure.detail} ({read})") from None
            said += found.notes if found.shown is not None else ()
    return said


def bears_print_said(shown: ShownPrint, source: str) -> str:
    """A sentence on a reference that shows a print, where it is from, and what to do."""
    return (
        f"the reference shows a contact imprint: {shown.seen_by} (in {source}). An object touched it, "
        f"or the gel is under load from the first frame: {WHAT_TO_DO}."
    )


def flatter_said(frame: int) -> str:
    """A sentence on a reference that is less flat than a later frame."""
    return (
        f"the reference does not show an untouched gel: in frame {frame} the gel is flatter. An "
        f"object pressed the gel in the reference: {WHAT_TO_DO}."
    )


def _estimated(sensor: Sensor, view: RawCamera, camera: GelCamera, source: str) -> PadReference:
    """From the frame that shows least of a print."""
    best: tuple[float, int, ReferenceMarkers] | None = None
    for t, frame in _frames_at(view.pictures, looked_at(len(view.pictures.numbers))):
        try:
            markers = reference_of(frame, source=f"{source}: frame {t}")
            places_of(camera, markers.lattice.rest_px, sensor.rest_mm, shape=markers.shape, source=source)
        except TactileFailure:
            if t == 0:
                raise
            continue
        shown = shown_print(frame, markers, camera=camera, described_mm=sensor.rest_mm)
        if best is None or shown.evidence < best[0]:
            best = (shown.evidence, t, markers)
    assert best is not None  # frame 0 is one of them, and raises otherwise
    _, t, markers = best
    lattice = markers.lattice
    ideal, known = lattice_places(lattice)
    described_px = None
    if sensor.rest_mm is not None:
        places = places_of(camera, lattice.rest_px, sensor.rest_mm, shape=markers.shape, source=source)
        known = np.isin(np.arange(len(lattice.rest_px)), places.kept)
        described_px = lattice.rest_px.copy()
        described_px[places.kept] = project(camera, sensor.rest_mm)[places.described]
    found = estimated_reference(lattice, ideal, known, described_px=described_px, source=source)
    rest = lattice_of(found.rest_px, lattice.spacing_px, shape=lattice.shape, margin_px=lattice.margin_px)
    spread = float(np.sqrt((found.sd_px**2).mean()))
    note = (
        f"{source}: drupe estimated the untouched gel from frame {view.pictures.numbers[t]}, in which "
        f"{int(found.unloaded.sum())} of {len(found.unloaded)} markers lie outside the imprint. The "
        f"places have a standard deviation of {spread:.1f} px, which the displacement's noise "
        "includes."
    )
    estimated = replace(markers, lattice=rest, markers=replace(markers.markers, centre_px=found.rest_px))
    return PadReference(markers=estimated, shown=None, sd_px=found.sd_px, notes=(note,))


def _frames_at(pictures: Pictures, wanted: list[int]) -> Iterator[tuple[int, UInt8[np.ndarray, "h w 3"]]]:
    among = set(wanted)
    return ((t, frame) for t, frame in enumerate(pictures.frames()) if t in among)
