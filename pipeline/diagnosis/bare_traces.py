"""The traces of a case whose recordings are those of a bare indenter: one specimen, one tool, one law."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from fem.fem_failure import FemFailure
from fem.indentation.trace import IndenterTrace, joined
from pipeline.diagnosis.diagnosed_case import Case
from pipeline.fruit.trace_geometry import KEYS, TraceGeometry, combined, geometry_of
from pipeline.problem import BatchRefused, Problem
from recon.pit.priors import PitPrior
from tactile.io.recording import IndenterPad, Recording, read_recording
from tactile.tactile_failure import TactileFailure
from tactile.trace_thinning import thin

MOST_FRAMES = 1200
"""Of all traces of a case together, as of one (tactile/trace_thinning.py): time and memory grow with them."""
FEWEST_KEPT = 60
"""Of each of many traces (set by hand: three times what a fit asks for)."""
DEEP = "No thickness_mm is given (in case.toml, or to drupe convert): the specimen is taken as thick."


@dataclass(frozen=True, kw_only=True)
class BareTraces:
    """`trace`: all of them joined (`fem.indentation.trace.joined`); `facts` for the page."""

    names: tuple[str, ...]
    trace: IndenterTrace
    thickness_mm: float | None
    notes: tuple[str, ...]
    facts: tuple[tuple[str, str], ...]


def bare_traces(case: Case) -> BareTraces | None:
    """Every trace of the case, thinned where it is long; None where pads have markers.

    Raises BatchRefused where traces are of different geometries, or one's is not known.
    """
    found: list[tuple[Path, Recording, IndenterPad]] = []
    for path in case.task.folder.grasp_files():
        try:
            recording = read_recording(path)
        except TactileFailure:
            continue
        pads = [pad for pad in recording.pads if isinstance(pad, IndenterPad)]
        if len(pads) != len(recording.pads):
            return None
        found.append((path, recording, _one_of(path, pads)))
    if not found:
        return None
    known = [_geometry(case, path, pad) for path, _, pad in found]
    for (path, _, _), one in zip(found[1:], known[1:], strict=True):
        if (one.geometry, one.thickness_mm) != (known[0].geometry, known[0].thickness_mm):
            raise BatchRefused(
                [
                    Problem(
                        str(path),
                        f"is of {one.geometry.said}, but {found[0][0].name} of {known[0].geometry.said}; a "
                        "case holds one specimen under one tool: make a case of each, or correct the fields.",
                    )
                ]
            )
    _require_one_rig(found)
    notes = [note for one in known for note in one.notes]
    traces = []
    for path, recording, pad in found:
        most = max(MOST_FRAMES // len(found), FEWEST_KEPT) if len(found) > 1 else None
        trace, said = _trace(path, recording, pad, known[0], most=most)
        traces.append(trace)
        notes += said
    thick = known[0].thickness_mm
    of_slab = known[0].geometry.tool != "plate"
    if of_slab and thick is None:
        notes.append(DEEP)
    return BareTraces(
        names=tuple(path.stem for path, _, _ in found),
        trace=joined(traces),
        thickness_mm=thick,
        notes=tuple(dict.fromkeys(notes)),
        facts=(("Specimen", f"{thick:g} mm" if thick else "thick against the dent"),) if of_slab else (),
    )


def _require_one_rig(found: list[tuple[Path, Recording, IndenterPad]]) -> None:
    """Refuses traces of which some have the rig's own travel taken off and others not."""
    without = [path for path, recording, _ in found if recording.rig_give_mm is None]
    if 0 < len(without) < len(found):
        said = (
            "has the rig's own travel in it, but other recordings of the case have not: convert all of them "
            "with the same --rig, or none."
        )
        raise BatchRefused([Problem(str(without[0]), said)])


def _one_of(path: Path, pads: list[IndenterPad]) -> IndenterPad:
    """The pad, or of two bare jaws round one specimen one with the mean of both forces."""
    if len(pads) == 1:
        return pads[0]
    if any(pad.indenter != "plate" for pad in pads):
        said = " and ".join(pad.indenter for pad in pads)
        raise BatchRefused(
            [Problem(str(path), f"has two bare pads, {said}; only two plates squeeze one specimen by a law.")]
        )
    return replace(pads[0], force_z_N=np.mean([pad.force_z_N for pad in pads], axis=0))


def _geometry(case: Case, path: Path, pad: IndenterPad) -> TraceGeometry:
    specimen, notes = combined(pad.specimen, case.specimen, source=path.name)
    try:
        known = geometry_of(
            pad.indenter,
            pad.radius_mm,
            specimen,
            source=str(path),
            name_of=KEYS,
            pit_share=_pit_share(case.task.prior),
        )
    except FemFailure as failure:
        raise BatchRefused([Problem(str(path), failure.detail)]) from None
    return TraceGeometry(
        geometry=known.geometry, thickness_mm=known.thickness_mm, notes=(*notes, *known.notes)
    )


def _pit_share(prior: PitPrior | None) -> float | None:
    """Of the fruit's diameter, the geometric mean over the axes; None where the category says none."""
    if prior is None or prior.axis_ratios is None:
        return None
    return float(np.cbrt(np.prod(prior.axis_ratios)))


def _trace(
    path: Path, recording: Recording, pad: IndenterPad, known: TraceGeometry, *, most: int | None
) -> tuple[IndenterTrace, list[str]]:
    closing = -1.0 if recording.loading == "grasp" else 1.0
    travel = closing * recording.aperture_mm
    thinned = thin(recording.time_s, travel, pad.force_z_N)
    kept = np.arange(len(travel)) if thinned is None else thinned.kept
    said = [] if thinned is None else [thinned.said(path.name)]
    if most is not None and len(kept) > most:
        said.append(
            f"{path.name}: {most} of {len(kept)} frames are used beside the case's other traces, spread over "
            "time, force and travel equally."
        )
        kept = kept[_spread(recording.time_s[kept], travel[kept], pad.force_z_N[kept], most)]
    trace = IndenterTrace(
        time_s=recording.time_s[kept],
        force_N=pad.force_z_N[kept],
        travel_mm=travel[kept] - travel[0],
        geometry=known.geometry,
        rig_give_mm=None if recording.rig_give_mm is None else recording.rig_give_mm[kept],
        rig_sd_mm=None if recording.rig_sd_mm is None else recording.rig_sd_mm[kept],
    )
    return trace, said


def _spread(
    time_s: Float[np.ndarray, " t"],
    travel_mm: Float[np.ndarray, " t"],
    force_N: Float[np.ndarray, " t"],
    most: int,
) -> Int[np.ndarray, " k"]:
    """Frames at equal steps of the path that time, travel and force go together, in shares of each."""
    steps = [np.abs(np.diff(one)) for one in (time_s, travel_mm, force_N)]
    path = np.r_[0.0, np.cumsum(sum(step / max(float(step.sum()), 1e-300) for step in steps))]
    return np.unique(np.searchsorted(path, np.linspace(0, path[-1], most)).clip(0, len(path) - 1))
