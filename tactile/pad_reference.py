"""The untouched markers that a pad's frames are held against: seen in a picture of it, or estimated.

An estimate is from a picture in which the gel is pressed. The markers around a print lie nearly where they
always do. Fitted to them, the places that the sensor's description has, shifted as a whole, or else a regular
lattice behind a smooth lens (tactile.markers.smooth_lattice), have the others' places as well. Which markers
are unloaded is not known: several parts of the picture are tried, each fit is widened to the markers that
agree with it, and the one that most agree with is kept (as in least median of squares, Rousseeuw 1984). An
unloaded marker stays where it is seen. A grip also moves a gel as a whole, which no picture of the loaded gel
tells from its rest: every place has that spread besides.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, UInt8

from tactile.gel_camera import project
from tactile.io.pictures import Pictures, refuse_saturated
from tactile.io.raw_grasp import RawCamera, RawGrasp
from tactile.markers.marker_lattice import Lattice, lattice_of
from tactile.markers.smooth_lattice import FEWEST, coherent_misfit_px, fitted_lens, lattice_places
from tactile.markers.tracking import FrameMarkers, ReferenceMarkers, places_of, reference_of
from tactile.reference_print import WHAT_TO_DO, ShownPrint, becomes_flatter, shown_print
from tactile.sensors import GelCamera, Sensor
from tactile.square_pixels import with_square_pixels
from tactile.tactile_failure import TactileFailure, TactileProblem

AGREES_SD = 2.5
"""Standard deviations of the unloaded markers' own misfit, up to which one agrees. Set by hand."""
AGREES_LEAST, AGREES_MOST = 0.02, 0.035
"""Bounds of that, in spacings: printed markers are off by 0.006 to 0.014 (root mean square, 43 empty
pictures), so that 2.5 standard deviations are 0.015 to 0.035."""
ROUNDS = 6
"""Of fitting to the markers that agree, each time anew: sets stay the same after about three. Set by hand."""
FEWEST_UNLOADED, LEAST_SHARE = 20, 0.4
"""Markers that must be unloaded, and their share of all: the lens has 11 numbers. Set by hand."""
LARGEST_SD = 0.15
"""Of a marker's place, in spacings: beyond it a place is nearer to a guess than to a measurement. Set by
hand."""
WHOLE_SD = 0.035
"""Spacings by which a grip moves the unloaded markers: of 127 loaded frames of 26 clips whose empty gel is
known (benchmarks/gel_references.py FOLDER --half even)."""
BELOW_PRINT = 5.0
"""Times the fit's own standard deviation that places below a print are off, on the same frames: the lens
follows the markers that move a little."""

_Fit: TypeAlias = Callable[[Bool[np.ndarray, " n"]], tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]]
"""Places of all markers and one standard deviation of each, px, from those that are chosen."""
LOOKED_AT = 12
"""Frames of a recording in which a print is looked for, evenly spaced: each takes about 0.08 s at 320 x 240
pixels, as two or three frames of tracking do."""


@dataclass(frozen=True)
class EstimatedReference:
    """Places (px) of the untouched gel's markers, a standard deviation of each, and which are seen there."""

    rest_px: Float[np.ndarray, "n 2"]
    sd_px: Float[np.ndarray, " n"]
    unloaded: Bool[np.ndarray, " n"]


def estimated_reference(
    lattice: Lattice,
    ideal: Float[np.ndarray, "n 2"],
    known: Bool[np.ndarray, " n"],
    *,
    described_px: Float[np.ndarray, "n 2"] | None = None,
    source: str,
) -> EstimatedReference:
    """The untouched places of the markers that `lattice` has in a picture of the loaded gel.

    `ideal`: their places on a regular grid, in steps; `described_px`: where the sensor's description has
    them, which is taken instead; `known`: the markers of which either is known, the others stay where they
    are seen. Raises TactileFailure (no-markers) where too few markers are unloaded for the others' places.
    """
    fit = _shift(lattice, described_px) if described_px is not None else _lens(lattice, ideal)
    unloaded = _widest(lattice, fit, ideal if described_px is None else described_px, known)
    needed = max(FEWEST_UNLOADED, round(LEAST_SHARE * len(known)))
    if unloaded.sum() < needed:
        raise _refusal(source, int(unloaded.sum()), len(known), needed)
    expected, sd_px = fit(unloaded)
    misfit_px = float(np.sqrt(((lattice.rest_px - expected)[unloaded] ** 2).mean()))
    whole = WHOLE_SD * lattice.spacing_px
    place_sd_px = np.sqrt((BELOW_PRINT * sd_px) ** 2 + misfit_px**2 + whole**2)
    if (place_sd_px[known] > LARGEST_SD * lattice.spacing_px).any():
        raise _refusal(source, int(unloaded.sum()), len(known), needed)
    seen = unloaded | ~known
    rest_px = np.where(seen[:, None], lattice.rest_px, expected)
    return EstimatedReference(rest_px, np.where(seen, whole, place_sd_px), unloaded)


def _lens(lattice: Lattice, ideal: Float[np.ndarray, "n 2"]) -> _Fit:
    """A regular grid behind a smooth lens."""

    def fit(chosen: Bool[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
        lens = fitted_lens(ideal[chosen], lattice.rest_px[chosen], lattice.shape)
        return lens.places_px(ideal), lens.sd_px(ideal)

    return fit


def _shift(lattice: Lattice, described_px: Float[np.ndarray, "n 2"]) -> _Fit:
    """The description's places, shifted as a whole."""

    def fit(chosen: Bool[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
        off = (lattice.rest_px - described_px)[chosen]
        middle = np.median(off, axis=0)
        sd = float(np.sqrt(((off - middle) ** 2).mean() / max(1, len(off))))
        return described_px + middle, np.full(len(described_px), sd)

    return fit


def _widest(
    lattice: Lattice, fit: _Fit, ideal: Float[np.ndarray, "n 2"], known: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """The markers of the fit that most agree with."""
    best = np.zeros(len(known), dtype=bool)
    if known.sum() < FEWEST:
        return best
    for start in _parts(ideal, known):
        chosen = start
        for _ in range(ROUNDS):
            if chosen.sum() < FEWEST:
                break
            agreeing = known & _agrees(lattice, lattice.rest_px - fit(chosen)[0], chosen)
            if agreeing.sum() > best.sum():
                best = agreeing
            if (agreeing == chosen).all():
                break
            chosen = agreeing
    return best


def _agrees(
    lattice: Lattice, off_px: Float[np.ndarray, "n 2"], chosen: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Markers that are no further off by themselves, and less so together with their neighbours.

    The median of a two-dimensional normal misfit is sqrt(2 ln 2) standard deviations of one coordinate.
    """
    size = np.linalg.norm(off_px, axis=1)
    usual = AGREES_SD * float(np.median(size[chosen])) / np.sqrt(2.0 * np.log(2.0)) / lattice.spacing_px
    most = float(np.clip(usual, AGREES_LEAST, AGREES_MOST)) * lattice.spacing_px
    common = np.linalg.norm(coherent_misfit_px(lattice, off_px), axis=1)
    return np.asarray((size < most * np.sqrt(2.0)) & (common < most))


def _parts(
    ideal: Float[np.ndarray, "n 2"], known: Bool[np.ndarray, " n"]
) -> Iterator[Bool[np.ndarray, " n"]]:
    """All markers, the outer ones, and two thirds and half of them to each side and corner."""
    yield known
    away = ideal - np.median(ideal[known], axis=0)
    across = away / np.maximum(np.abs(away[known]).max(axis=0), 1e-9)
    for rim in (0.45, 0.7):
        yield known & (np.abs(across).max(axis=1) > rim)
    for angle in np.arange(8) * np.pi / 4:
        side = across @ [np.cos(angle), np.sin(angle)]
        yield known & (side > np.quantile(side[known], 1.0 / 3.0))
        yield known & (side > np.quantile(side[known], 0.5))


def _refusal(source: str, unloaded: int, markers: int, needed: int) -> TactileFailure:
    return TactileFailure(
        TactileProblem.NO_MARKERS,
        f"{source}: found {unloaded} of {markers} markers outside the imprint, expected at least "
        f"{needed} to estimate the untouched gel. Name a picture or clip of it (reference = ... in "
        "grasp.toml), or record one with the jaws open.",
    )


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
                reference = pad_reference(pad.sensor, pad.view, pad.sensor.camera, source=source)
            except TactileFailure as failure:
                read = f"drupe read {pad.view.reference_from} and {pad.described_in}"
                raise TactileFailure(failure.problem, f"{failure.detail} ({read})") from None
            said += reference.notes if reference.shown is not None else ()
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
    estimate = estimated_reference(lattice, ideal, known, described_px=described_px, source=source)
    rest = lattice_of(estimate.rest_px, lattice.spacing_px, shape=lattice.shape, margin_px=lattice.margin_px)
    spread = float(np.sqrt((estimate.sd_px**2).mean()))
    note = (
        f"{source}: drupe estimated the untouched gel from frame {view.pictures.numbers[t]}, in which "
        f"{int(estimate.unloaded.sum())} of {len(estimate.unloaded)} markers lie outside the imprint. The "
        f"places have a standard deviation of {spread:.1f} px, which the displacement's noise "
        "includes."
    )
    estimated = replace(markers, lattice=rest, markers=replace(markers.markers, centre_px=estimate.rest_px))
    return PadReference(markers=estimated, shown=None, sd_px=estimate.sd_px, notes=(note,))


def _frames_at(pictures: Pictures, wanted: list[int]) -> Iterator[tuple[int, UInt8[np.ndarray, "h w 3"]]]:
    among = set(wanted)
    return ((t, frame) for t, frame in enumerate(pictures.frames()) if t in among)
