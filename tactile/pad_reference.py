"""The untouched markers that a pad's frames are held against, and the prints that the pictures show."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, UInt8

from tactile.io.pictures import refuse_saturated
from tactile.io.raw_grasp import RawCamera, RawGrasp
from tactile.markers.tracking import FrameMarkers, ReferenceMarkers, places_of, reference_of
from tactile.reference_print import WHAT_TO_DO, ShownPrint, becomes_flatter, shown_print
from tactile.sensors import GelCamera, Sensor
from tactile.square_pixels import with_square_pixels
from tactile.tactile_failure import TactileFailure

LOOKED_AT = 12
"""Frames of a recording in which a print is looked for, evenly spaced: each takes about 0.08 s at 320 x 240
pixels, as two or three frames of tracking do."""


@dataclass(frozen=True, kw_only=True)
class PadReference:
    """The markers at rest; `shown`: the print on their picture."""

    markers: ReferenceMarkers
    shown: ShownPrint
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
        count = min(self.frames, LOOKED_AT)
        self._at = set(np.linspace(0, self.frames - 1, count).round().astype(int).tolist())

    def look(self, t: int, frame: UInt8[np.ndarray, "h w 3"], markers: FrameMarkers) -> None:
        """Keeps how much of a print frame `t` shows, if it is one of those that are looked at."""
        if t in self._at and np.isfinite(markers.position_px[:, 0]).any():
            self.shown[t] = shown_print(
                frame,
                self.reference,
                camera=self.camera,
                described_mm=self.sensor.rest_mm,
                position_px=markers.position_px,
            )

    def over_time(self) -> Float[np.ndarray, " t"] | None:
        """Of every frame, straight between those looked at; None where there are none."""
        if not self.shown:
            return None
        at = sorted(self.shown)
        return np.interp(np.arange(self.frames), at, [self.shown[t].evidence for t in at])

    def flatter_frame(self, known: PadReference) -> int | None:
        """The frame whose gel is clearly flatter than the reference's (`becomes_flatter`)."""
        return next((t for t in sorted(self.shown) if becomes_flatter(known.shown, self.shown[t])), None)


def pad_reference(sensor: Sensor, view: RawCamera, camera: GelCamera, *, source: str) -> PadReference:
    """The markers of the reference's picture.

    Raises TactileFailure: gel-saturated, no-markers where there are too few, wrong-sensor where they are not
    as the description has them.
    """
    refuse_saturated(view.reference, f"{source}: reference")
    markers = reference_of(view.reference, source=f"{source}: reference")
    rest_px = markers.lattice.rest_px
    places_of(camera, rest_px, sensor.rest_mm, shape=markers.shape, source=source)
    shown = shown_print(view.reference, markers, camera=camera, described_mm=sensor.rest_mm)
    notes = () if shown.evidence < 1.0 else (f"{source}: {bears_print_said(shown, view.reference_from)}",)
    return PadReference(markers=markers, shown=shown, notes=notes)


def references_said(raw: RawGrasp) -> list[str]:
    """A sentence on each pad whose reference bears a print; raises as `pad_reference` does."""
    said: list[str] = []
    for pad in with_square_pixels(raw).pads:
        if pad.sensor.camera is not None:
            source = f"{raw.source}/{pad.name}"
            try:
                reference = pad_reference(pad.sensor, pad.view, pad.sensor.camera, source=source)
            except TactileFailure as failure:
                read = f"drupe read {pad.view.reference_from} and {pad.described_in}"
                raise TactileFailure(failure.problem, f"{failure.detail} ({read})") from None
            said += reference.notes
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
