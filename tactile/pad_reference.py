"""The untouched markers to which a pad's frames are compared, and the imprints in their picture."""

from dataclasses import dataclass

from tactile.markers.tracking import ReferenceMarkers, places_of, reference_of
from tactile.readers.pictures import refuse_saturated
from tactile.readers.raw_grasp import RawCamera, RawGrasp
from tactile.reference_print import WHAT_TO_DO, ShownPrint, shown_print
from tactile.sensors import GelCamera, Sensor
from tactile.square_pixels import with_square_pixels
from tactile.tactile_failure import TactileFailure


@dataclass(frozen=True, kw_only=True)
class PadReference:
    """The markers at rest; `shown`: the imprint in their picture."""

    markers: ReferenceMarkers
    shown: ShownPrint
    notes: tuple[str, ...]


def pad_reference(sensor: Sensor, view: RawCamera, camera: GelCamera, *, source: str) -> PadReference:
    """The markers of the reference's picture.

    Raises TactileFailure: gel-saturated, no-markers if there are too few, wrong-sensor if they are not as the
    description has them.
    """
    refuse_saturated(view.reference, f"{source}: reference")
    markers = reference_of(view.reference, source=f"{source}: reference")
    rest_px = markers.lattice.rest_px
    places_of(camera, rest_px, sensor.rest_mm, shape=markers.shape, source=source)
    shown = shown_print(view.reference, markers, camera=camera, described_mm=sensor.rest_mm)
    note = (
        f"{source}: the reference shows a contact imprint: {shown.seen_by} (in {view.reference_from}). An "
        f"object touched it, or the gel is under load from the first frame: {WHAT_TO_DO}."
    )
    return PadReference(markers=markers, shown=shown, notes=(note,) if shown.evidence >= 1.0 else ())


def references_said(raw: RawGrasp) -> list[str]:
    """A sentence on each pad whose reference shows an imprint; raises as `pad_reference` does."""
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
