"""Curves of a bare indenter on one specimen: read, checked for one geometry, joined under one law."""

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from fem.fem_failure import FemFailure
from fem.indentation.compressed_ellipsoid import Ellipsoid
from fem.indentation.contact_curve import Geometry
from fem.indentation.trace import IndenterTrace, joined
from pipeline.fruit.trace_geometry import Stated, TraceGeometry, combined, geometry_of
from pipeline.problem import refused
from recon.pit.priors import PitBody, PitPrior
from tactile.readers.recording import IndenterPad, Recording, read_recording
from tactile.readers.specimen import DIAMETERS
from tactile.tactile_failure import TactileFailure
from tactile.trace_thinning import thin

MOST_FRAMES = 1200
"""Of all curves of a specimen together, as of one (tactile/trace_thinning.py): time grows with them."""
FEWEST_KEPT = 60
"""Of each of many curves (set by hand: three times what a fit needs)."""
ALONG_STEM = (
    "plates along diameter c (from stem to tip), which touch the rim of the stem's hollow and "
    "make E 1.4 to 2.1 times too large; expected plates across the cheeks (axis b) or from "
    "suture to back (axis a). If the diameters are in another order, write them as a (suture to "
    "back), b (across the cheeks), c (stem to tip)"
)
"""Of a stone fruit; the factors are in benchmarks/results/diameter_shapes.csv."""
NUMBERED = re.compile(r"^Recording (\d+)")
"""Start of the finder's notes on a single recording among several."""
DEEP = "case.toml and drupe convert give no thickness_mm: drupe assumes a thick specimen."


@dataclass(frozen=True, kw_only=True)
class BareRecording:
    """A recording whose only pad is a bare indenter (two plates become one with their mean force), and its
    geometry. `source`: its name in sentences.
    """

    source: str
    recording: Recording
    known: TraceGeometry

    @property
    def pad(self) -> IndenterPad:
        """The indenter."""
        (pad,) = (pad for pad in self.recording.pads if isinstance(pad, IndenterPad))
        return pad


@dataclass(frozen=True, kw_only=True)
class BareTraces:
    """`trace`: all of them joined (`fem.indentation.trace.joined`); `facts` for the page."""

    names: tuple[str, ...]
    trace: IndenterTrace
    known: TraceGeometry
    notes: tuple[str, ...] = field(default=())

    def naming(self, notes: Iterable[str]) -> list[str]:
        """Notes of the finder with each recording's name after its number."""
        names = dict(enumerate(self.names, 1))
        return [NUMBERED.sub(lambda match: f"{match[0]} ({names[int(match[1])]})", note) for note in notes]

    @property
    def facts(self) -> tuple[tuple[str, str], ...]:
        """Facts of a slab for the page."""
        thick = self.known.thickness_mm
        if not self.known.of_slab:
            return ()
        return (("Specimen", f"{thick:g} mm" if thick else "thick against the dent"),)


def bare_recordings(
    paths: Iterable[Path], stated: Stated, prior: PitPrior | None
) -> list[BareRecording] | None:
    """Every readable recording of a case; None if one has pads with markers, or if none is readable.

    Raises BatchRefused as `bare_recording` does.
    """
    readable: dict[str, Recording] = {}
    for path in paths:
        with suppress(TactileFailure):
            readable[str(path)] = read_recording(path)
    if not readable or not all(map(is_bare, readable.values())):
        return None
    return [
        bare_recording(recording, source=source, stated=stated, prior=prior)
        for source, recording in readable.items()
    ]


def is_bare(recording: Recording) -> bool:
    """Whether every pad of it is a bare indenter's."""
    return all(isinstance(pad, IndenterPad) for pad in recording.pads)


def bare_recording(
    recording: Recording, *, source: str, stated: Stated, prior: PitPrior | None
) -> BareRecording:
    """The pad and its geometry; two bare jaws around one specimen become one pad with the mean of both
    forces. The geometry is that of the recording's own fields, with the user's in their place.

    Raises BatchRefused for two bare pads that are not two plates, and if no law is known for the geometry; it
    names what is missing.
    """
    pads = [pad for pad in recording.pads if isinstance(pad, IndenterPad)]
    if len(pads) > 1 and any(pad.indenter != "plate" for pad in pads):
        said = " and ".join(pad.indenter for pad in pads)
        sentence = f"has two bare pads, {said}; a contact law exists for two plates around one specimen only."
        raise refused(source, sentence)
    pad = replace(pads[0], force_z_N=np.mean([pad.force_z_N for pad in pads], axis=0))
    specimen, notes = combined(pad.specimen, stated, source=Path(source).name)
    try:
        known = geometry_of(
            pad.indenter,
            pad.radius_mm,
            specimen,
            source=source,
            name_of=stated.name_of,
            pit_share=_pit_share(prior),
        )
    except FemFailure as failure:
        raise refused(source, failure.detail) from None
    if prior is not None and is_along_stem(known.geometry, prior.body):
        notes.append(f"Found {ALONG_STEM}.")
    known = replace(known, notes=(*notes, *known.notes))
    return BareRecording(source=source, recording=replace(recording, pads=(pad,)), known=known)


def is_along_stem(geometry: Geometry, body: PitBody) -> bool:
    """Whether plates compress a fruit with stem and suture from stem to tip."""
    return isinstance(geometry, Ellipsoid) and body.stem_and_suture and DIAMETERS[geometry.axis] == "c"


def joined_traces(recordings: Sequence[BareRecording]) -> BareTraces:
    """All recordings as one curve, thinned if they are long.

    Raises BatchRefused if their geometries differ, or if only some exclude a rig's travel.
    """
    first = recordings[0]
    for bare in recordings[1:]:
        if bare.known != first.known:
            sentence = (
                f"has the geometry {bare.known.geometry.said}, but {Path(first.source).name} has "
                f"{first.known.geometry.said}; a case holds one specimen under one tool. Make a "
                "case of each, or correct the fields."
            )
            raise refused(bare.source, sentence)
    _require_one_rig(recordings)
    notes = [note for bare in recordings for note in (*bare.known.notes, *bare.known.assumed)]
    most = max(MOST_FRAMES // len(recordings), FEWEST_KEPT) if len(recordings) > 1 else None
    traces = []
    for bare in recordings:
        trace, said = _trace(bare, most=most)
        traces.append(trace)
        notes += said
    if first.known.of_slab and first.known.thickness_mm is None:
        notes.append(DEEP)
    return BareTraces(
        names=tuple(Path(bare.source).stem for bare in recordings),
        trace=joined(traces),
        known=first.known,
        notes=tuple(dict.fromkeys(notes)),
    )


def _require_one_rig(recordings: Sequence[BareRecording]) -> None:
    """Refuses curves if the rig's own travel is subtracted from some, but not from all."""
    without = [bare for bare in recordings if bare.recording.rig_give_mm is None]
    if 0 < len(without) < len(recordings):
        said = (
            "includes the rig's own travel, but other recordings of the fruit do not: convert all of "
            "them with the same --rig, or none."
        )
        raise refused(without[0].source, said)


def _pit_share(prior: PitPrior | None) -> float | None:
    """Share of the fruit's diameter, the geometric mean over the axes; None if the category has none."""
    if prior is None or prior.axis_ratios is None:
        return None
    return float(np.cbrt(np.prod(prior.axis_ratios)))


def _trace(bare: BareRecording, *, most: int | None) -> tuple[IndenterTrace, list[str]]:
    recording, name = bare.recording, Path(bare.source).name
    closing = -1.0 if recording.loading == "grasp" else 1.0
    travel = closing * recording.aperture_mm
    thinned = thin(recording.time_s, travel, bare.pad.force_z_N)
    kept = np.arange(len(travel)) if thinned is None else thinned.kept
    said = [] if thinned is None else [thinned.said(name)]
    if most is not None and len(kept) > most:
        said.append(
            f"{name}: drupe uses {most} of {len(kept)} frames together with the other curves, spread "
            "evenly over time, force and travel."
        )
        kept = kept[spread(recording.time_s[kept], travel[kept], bare.pad.force_z_N[kept], most)]
    trace = IndenterTrace(
        time_s=recording.time_s[kept],
        force_N=bare.pad.force_z_N[kept],
        travel_mm=travel[kept] - travel[0],
        geometry=bare.known.geometry,
        rig_give_mm=None if recording.rig_give_mm is None else recording.rig_give_mm[kept],
        rig_sd_mm=None if recording.rig_sd_mm is None else recording.rig_sd_mm[kept],
    )
    return trace, said


def spread(
    time_s: Float[np.ndarray, " t"],
    travel_mm: Float[np.ndarray, " t"],
    force_N: Float[np.ndarray, " t"],
    most: int,
) -> Int[np.ndarray, " k"]:
    """Frames at equal steps of the path length of time, travel and force, each over its total."""
    steps = [np.abs(np.diff(each)) for each in (time_s, travel_mm, force_N)]
    path = np.r_[0.0, np.cumsum(sum(step / max(float(step.sum()), 1e-300) for step in steps))]
    return np.unique(np.searchsorted(path, np.linspace(0, path[-1], most)).clip(0, len(path) - 1))
