"""Tracks the markers in one camera's frames of a raw grasp and identifies them in the description."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import tee

import numpy as np
from jaxtyping import Bool, Float

from tactile.markers.matching import UNSURE
from tactile.markers.tracking import FrameMarkers, Places, TrackedMarkers, follow, labelled_places, places_of
from tactile.readers.pictures import checked
from tactile.readers.raw_grasp import RawCamera, RawPad
from tactile.reference_print import WHAT_TO_DO, ShownPrint, becomes_flatter, pad_reference, shown_print
from tactile.sensors import GelCamera
from tactile.tactile_failure import TactileProblem

FEWEST_SEEN = 0.5
"""Least share of the markers in a usable frame."""
LOOKED_AT = 12
"""Evenly spaced frames in which drupe searches for an imprint. Each takes about 0.08 s at 320 x 240 pixels,
like two or three frames of tracking."""
Progress = Callable[[str, int, int], None]
"""Receives the pad's name, how many of its frames are done, and how many there are."""


@dataclass(frozen=True, kw_only=True)
class PadMarkers:
    """The markers in the description, tracked through all frames; `doubled`: frames that repeat the last one.

    `reference_print`: evidence of an imprint in the picture of the untouched gel, over the detection limit;
    `print_shown`: in each frame, interpolated.
    """

    tracked: TrackedMarkers
    doubled: Bool[np.ndarray, " t"]
    places: Places
    notes: list[str]
    reference_print: float
    print_shown: Float[np.ndarray, " t"] | None


def tracked_markers(
    pad: RawPad, view: RawCamera, camera: GelCamera, source: str, progress: Progress | None
) -> PadMarkers:
    """One camera's markers in all frames. Raises TactileFailure as pad_reference, and for unusable frames."""
    known = pad_reference(pad.sensor, view, camera, source=source)
    reference = known.markers
    rest_px = reference.lattice.rest_px
    places = places_of(
        camera,
        rest_px,
        pad.sensor.rest_mm,
        shape=reference.shape,
        source=source,
        outline=pad.sensor.outline,
    )
    count = len(view.pictures.numbers)
    rows: list[FrameMarkers] = []
    looked_at = set(np.linspace(0, count - 1, min(count, LOOKED_AT)).round().astype(int).tolist())
    shown: dict[int, ShownPrint] = {}
    doubled: list[bool] = []
    before = None
    frames, followed = tee(checked(view.pictures.frames(), source, reference.shape))
    for t, (markers, frame) in enumerate(zip(follow(reference, followed), frames, strict=True)):
        rows.append(markers)
        doubled.append(before is not None and np.array_equal(frame, before))
        before = frame
        if t in looked_at and np.isfinite(markers.position_px[:, 0]).any():
            shown[t] = shown_print(
                frame,
                reference,
                camera=camera,
                described_mm=pad.sensor.rest_mm,
                position_px=markers.position_px,
            )
        seen = float(np.isfinite(markers.position_px[places.kept, 0]).mean())
        if seen < FEWEST_SEEN:
            raise TactileProblem.MARKERS_LOST.failure(
                f"{source}: frame {view.pictures.numbers[t]}: found {seen:.0%} of the markers, "
                f"expected at least {FEWEST_SEEN:.0%}; check whether the gel is torn, or the picture "
                "blurred or dark.",
            )
        if progress is not None:
            progress(pad.name, t + 1, count)
    position = labelled_places(reference, rows)
    certainty = np.minimum.accumulate([row.certainty for row in rows])
    notes = list(known.notes)
    reference_print = known.shown.evidence
    flatter = [t for t, frame_print in shown.items() if becomes_flatter(known.shown, frame_print)]
    if reference_print < 1.0 and flatter:
        notes.append(
            f"{source}: the reference does not show an untouched gel: in frame "
            f"{view.pictures.numbers[flatter[0]]} the gel is flatter. An object pressed the gel in the "
            f"reference: {WHAT_TO_DO}."
        )
        reference_print = 1.0
    if (unsure := np.flatnonzero(certainty < UNSURE)).size:
        k = int(unsure[0])
        notes.append(
            f"{source}: frame {view.pictures.numbers[k]} ({pad.time_s[k]:.3f} s): nearly all markers "
            "move at once, and a shift by one grid pitch fits the picture equally well. Later "
            "displacements may be wrong by a pitch. Close the jaws more slowly, or record at a "
            "higher frame rate."
        )
    unknown = len(rest_px) - len(places.kept)
    if unknown:
        notes.append(f"{source}: drupe ignored {unknown} marks that are not in the sensor's description.")
    tracked = TrackedMarkers(
        time_s=pad.time_s,
        reference_px=rest_px[places.kept],
        position_px=position[:, places.kept],
        rest_mm=places.rest_mm,
        certainty=certainty,
    )
    return PadMarkers(
        tracked=tracked,
        doubled=np.array(doubled, dtype=bool),
        places=places,
        notes=notes,
        reference_print=reference_print,
        print_shown=np.interp(np.arange(count), list(shown), [p.evidence for p in shown.values()])
        if shown
        else None,
    )


def camera_of(pad: RawPad) -> GelCamera:
    """The pad's first camera; raises TactileFailure (wrong-sensor) if its description has none."""
    if pad.sensor.camera is None:
        raise TactileProblem.WRONG_SENSOR.failure(
            f"{pad.name}: found frames of a sensor described as kind {pad.sensor.kind!r} without a camera, "
            "expected markers-mono or markers-stereo.",
        )
    return pad.sensor.camera


def of_frames(tracked: TrackedMarkers, kept: Bool[np.ndarray, " t"]) -> TrackedMarkers:
    """Only the frames in `kept`."""
    return replace(
        tracked,
        time_s=tracked.time_s[kept],
        position_px=tracked.position_px[kept],
        certainty=None if tracked.certainty is None else tracked.certainty[kept],
    )


def of_markers(tracked: TrackedMarkers, markers: list[int]) -> TrackedMarkers:
    """Only these markers, in this order."""
    return replace(
        tracked,
        reference_px=tracked.reference_px[markers],
        position_px=tracked.position_px[:, markers],
        rest_mm=tracked.rest_mm[markers],
    )


def losses_said(tracked: TrackedMarkers, source: str) -> list[str]:
    """Notes on markers that disappeared for good, and on those hidden for a while."""
    lost = ~np.isfinite(tracked.position_px[..., 0])
    torn = tracked.torn
    notes = []
    if torn.any():
        went = tracked.time_s[min(int(np.flatnonzero(~lost[:, n])[-1]) if (~lost[:, n]).any() else 0
                                  for n in np.flatnonzero(torn))]  # fmt: skip
        notes.append(
            f"{source}: {int(torn.sum())} of {len(torn)} markers disappeared (the first at {went:.3f} "
            "s) and did not return (torn, hidden or out of view). drupe uses their neighbours' "
            "displacement."
        )
    passing = lost.any(axis=0) & ~torn
    if passing.any():
        share = float(lost[:, passing].mean())
        notes.append(
            f"{source}: {int(passing.sum())} markers are hidden in {share:.0%} of the frames; drupe "
            "filled them in."
        )
    return notes
