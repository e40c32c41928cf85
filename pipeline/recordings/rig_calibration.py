"""`drupe calibrate --rigid`: determines the machine compliance of a rig from squeezes of a rigid object."""

import datetime
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.batch.cache import file_hash
from pipeline.problem import refused
from pipeline.recordings.description_file import DescriptionKind, frame_progress
from tactile.from_frames import recording_of
from tactile.readers.load_cell import NO_MARKERS, TABLES, read_trace
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import GelPad, IndenterPad, Recording, read_recording
from tactile.readers.rig_file import FORMAT, VERSION, read_rig
from tactile.readers.trace_columns import TraceWords
from tactile.rig.rig_curve import RigCurve
from tactile.rig.rig_fit import FittedRig, fit_rig
from tactile.rig.rigid_squeeze import RigidPress, gel_give_mm, rigid_squeezes
from tactile.tactile_failure import TactileFailure, TactileProblem

RIG = DescriptionKind("# rig, written by drupe calibrate", "a rig that drupe calibrate wrote")
DIGITS = 6
"""Significant digits of the written curve: a nanometre in a millimetre."""


@dataclass(frozen=True, kw_only=True)
class RigidObject:
    """The squeezed object as the user describes it; `size_mm`: diameter (ball) or thickness (block)."""

    name: str
    shape: Literal["ball", "block"]
    size_mm: float


def calibrate_rig(
    sources: Sequence[Path],
    out: Path,
    rigid: RigidObject,
    *,
    words: TraceWords,
    today: datetime.date,
    report: Callable[[str], None],
) -> tuple[str, ...]:
    """Writes the rig's compliance (its own travel over the force) to `out`; returns a summary in sentences.

    A source is a bare load cell's curve (table or recording without markers), a recording of gel pads, or a
    folder of gel frames. Raises TactileFailure for a source without a squeeze of a rigid object. Raises
    BatchRefused for repeated sources, for sources with and without gels together, or for an `out` that is
    not .toml. It also does so if `out` is an input or a file that drupe calibrate did not write.
    """
    if out.suffix.lower() != ".toml":
        raise refused(out, "is TOML; give a name that ends in .toml.")
    RIG.require_place(out, inputs=sources, folders=[path for path in sources if path.is_dir()])
    twice = {path.resolve() for path in sources}
    if len(twice) < len(sources):
        raise refused(sources[0], "is named twice; name each recording once.")
    squeezes: list[RigidPress] = []
    gels: set[bool] = set()
    said: list[str] = []
    for path in sources:
        recording, notes = _read(path, words, report)
        said += notes
        file_squeezes = _squeezes(recording, rigid, path.name)
        gels.add(isinstance(recording.pads[0], GelPad))
        squeezes += file_squeezes
        held = min(squeeze.held for squeeze in file_squeezes)
        report(
            f"{path.name}: {len(file_squeezes)} squeeze{'s' if len(file_squeezes) > 1 else ''} up to "
            f"{max(squeeze.largest_N for squeeze in file_squeezes):.3g} N, with {1 - held:.0%} loss of force "
            "during the hold"
        )
    if len(gels) > 1:
        sentence = (
            "mixes two kinds of recordings: some have gel pads, others have none; calibrate each "
            "kind separately."
        )
        raise refused(sources[0], sentence)
    whole = fit_rig(squeezes)
    jaws = fit_rig(squeezes, with_gels=False) if gels == {True} else None
    RIG.put(out, _described(whole, jaws, squeezes, rigid, sources, today), read_rig)
    return (*said, *_in_words(whole, jaws, rigid))


def _read(path: Path, words: TraceWords, report: Callable[[str], None]) -> tuple[Recording, tuple[str, ...]]:
    if (path / "grasp.toml").is_file():
        return recording_of(read_raw_grasp(path), progress=frame_progress(report)).recording, ()
    if path.suffix.lower() in TABLES:
        converted = read_trace(
            path, fruit_id="rig", category="rig", indenter="ball", radius_mm=1.0, words=words
        )
        return converted.recording, tuple(note for note in converted.notes if note != NO_MARKERS)
    return read_recording(path), ()


def _squeezes(recording: Recording, rigid: RigidObject, source: str) -> tuple[RigidPress, ...]:
    """The squeezes in a recording, with the gels' travel. Raises TactileFailure if there are none."""
    if recording.rig_give_mm is not None:
        raise TactileFailure(
            TactileProblem.UNREADABLE_RECORDING,
            f"{source}: found a travel that is already corrected for a rig, expected the travel as recorded.",
        )
    closing = -1.0 if recording.loading == "grasp" else 1.0
    force = np.mean(
        [
            pad.force_z_N if isinstance(pad, IndenterPad) else pad.force_N[:, :, 2].sum(axis=1)
            for pad in recording.pads
        ],
        axis=0,
    )
    gels = [pad for pad in recording.pads if isinstance(pad, GelPad)]
    part = sum(gel_give_mm(pad, shape=rigid.shape, size_mm=rigid.size_mm) for pad in gels) if gels else None
    return rigid_squeezes(
        force,
        closing * recording.aperture_mm,
        part_mm=None if part is None else np.asarray(part),
        size_mm=rigid.size_mm,
        source=source,
    )


def _described(
    whole: FittedRig,
    jaws: FittedRig | None,
    squeezes: Sequence[RigidPress],
    rigid: RigidObject,
    sources: Sequence[Path],
    today: datetime.date,
) -> dict[str, Any]:
    of = jaws or whole
    written: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "object": rigid.name,
        "shape": rigid.shape,
        "size_mm": rigid.size_mm,
        "made": today.isoformat(),
        "squeezes": len(squeezes),
        "least_N": _short(whole.least_N),
        "travel": _curve(whole.curve),
    }
    if jaws is not None:
        written["jaws"] = _curve(jaws.curve)
        knots = whole.curve.force_N
        gels = np.maximum.accumulate(np.maximum(whole.curve.give_mm - jaws.curve.give(knots), 0.0))
        written["gels"] = _curve(
            RigCurve(force_N=knots, give_mm=gels, sd_mm=np.hypot(whole.curve.sd_mm, jaws.curve.sd(knots)))
        )
    spreads = ("repeat_mm", "hysteresis_mm", "scatter_mm")
    written["spread"] = {name: _short(getattr(of, name)) for name in spreads}
    written["recordings"] = [
        # a folder's log holds the force and the aperture
        {"name": path.name, "sha256": file_hash(path / "log.csv" if path.is_dir() else path)}
        for path in sources
    ]
    return written


def _curve(curve: RigCurve) -> dict[str, list[float]]:
    return {
        name: [_short(float(x)) for x in getattr(curve, name)] for name in ("force_N", "give_mm", "sd_mm")
    }


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _in_words(whole: FittedRig, jaws: FittedRig | None, rigid: RigidObject) -> tuple[str, ...]:
    of, what = (whole, "rig") if jaws is None else (jaws, "jaws")
    peak, last = of.curve.largest_N, of.curve.last_mm_per_N
    at_peak = float(of.curve.give(np.array(peak)))
    sd = float(of.curve.sd_mm[-1])
    stiffness = f"{1 / last:.3g} N/mm there" if last > 0 else "no compliance in the last readings"
    lines = [
        f"the {what} give{'s' if jaws is None else ''} {at_peak:.3g} ± {sd:.2g} mm at {peak:.3g} N "
        f"({stiffness}), from {of.squeezes} squeeze{'s' if of.squeezes > 1 else ''} of {rigid.name}; "
        f"{of.least_N:.2g} to {peak:.3g} N",
        f"parts of the standard deviation: {of.repeat_mm:.2g} mm between squeezes, "
        f"{abs(of.hysteresis_mm):.2g} mm between loading and unloading, {of.scatter_mm:.2g} mm from the "
        f"readings (residual {of.readings_mm:.2g} mm)",
    ]
    if jaws is not None:
        all_of_it = float(whole.curve.give(np.array(peak)))
        lines.append(
            f"of {all_of_it:.3g} mm in all, {all_of_it - at_peak:.3g} mm belong to the gels, as "
            "their markers show"
        )
    if of.squeezes == 1:
        lines.append(
            "one squeeze shows no repeatability: drupe assumes 5 % of the displacement; squeeze it again"
        )
    if of.hysteresis_mm < -of.readings_mm:
        lines.append(
            "the force is larger during unloading than during loading, which no rig shows; check "
            "that force and travel share one clock. The standard deviation includes the difference"
        )
    if rigid.shape == "ball" and jaws is None:
        lines.append(
            "this includes compressed pads or a tip; an object of another curvature compresses them "
            "differently"
        )
    return tuple(lines)
