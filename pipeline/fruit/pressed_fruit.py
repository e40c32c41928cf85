"""From diameters and compression by plates to the modulus of a fruit without photos or mesh.

recordings -> one law for all curves -> E of linear elasticity -> effects beyond it
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from fem.elements.assembly import LARGEST_POISSON_RATIO
from fem.estimation.sensitivity import POISSON_RATIO
from fem.fem_failure import FemFailure
from fem.indentation.compressed_ellipsoid import Ellipsoid
from fem.indentation.explain_trace import explain_trace, linear_modulus
from fem.indentation.no_contact import first_touch, require_force
from fem.indentation.rig_share import OF_A_BATCH, rig_share
from fem.mismatch.result import NONE, UNKNOWN, Explanation, Modulus
from pipeline.batch.outcome import FruitEnded, Outcome
from pipeline.batch.records import ModulusRecord, PressedRecord, ScreenRecord, suspected_of
from pipeline.batch.rig_setting import batch_rig
from pipeline.batch.task import FruitTask
from pipeline.files.plain_file import printable
from pipeline.fruit.bare_traces import (
    ALONG_STEM,
    BareRecording,
    BareTraces,
    bare_recording,
    is_along_stem,
    is_bare,
    joined_traces,
)
from pipeline.fruit.flesh_model import poisson_ratio
from pipeline.fruit.grasped import admitted, owner_of, why_no_grasp
from pipeline.fruit.input_doubts import DOUBTED, Doubt, of_findings, relative_sd
from pipeline.fruit.recording_owner import refuse_copy
from pipeline.fruit.stage_log import StageLog
from pipeline.fruit.trace_geometry import Stated, stated_in_table
from pipeline.problem import BatchRefused
from recon.pit.priors import PitBody, PitPrior
from reports.grasp_record import CurveRecord, GraspRecord
from tactile.consistency.finding import Finding
from tactile.readers.recording import Recording, read_recording, recording_digest
from tactile.readers.specimen import DIAMETERS
from tactile.rig.rig_curve import RigCurve, without_rig
from tactile.tactile_failure import TactileFailure, TactileProblem

TRACE_SEED = 20261120
"""Seed of the random starts of a curve's fits; any number does, a fixed one makes runs repeat."""
ALONG_SUTURE_SD = 0.15
"""Standard deviation of ln E of a stone fruit compressed from suture to back, in addition to the ellipsoid's:
forces on whole skins are 1.10 to 1.17 times those on ellipsoids (benchmarks/results/diameter_shapes.csv)."""
SHAPE, RECORDINGS = "shape from three diameters", "recordings"
"""Parts of the error bar, besides Poisson's ratio."""
TYPICAL = 0.7
"""Share of the deepest compression at which E's dependence on Poisson's ratio is evaluated (set by hand: the
upper half of the force dominates E, and force varies with the power 1.5 of depth)."""


@dataclass(frozen=True, kw_only=True)
class CompressionTrace:
    """A usable recording, with the law of its geometry and the doubts about it.

    `path`: its file; `digest` as in tactile.readers.recording.
    """

    path: Path
    bare: BareRecording
    fruit: Ellipsoid
    digest: str
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = field(default=())

    @property
    def name(self) -> str:
        """Its name in records."""
        return printable(self.path.stem)


@dataclass(frozen=True, kw_only=True)
class _Compression:
    """All recordings of a fruit along one diameter under one law, and E by each alone."""

    recordings: tuple[CompressionTrace, ...]
    traces: BareTraces
    explanation: Explanation
    alone: tuple[Modulus, ...]

    @property
    def fruit(self) -> Ellipsoid:
        """Its diameters and pit."""
        return self.recordings[0].fruit


def grade_pressed(task: FruitTask, log: StageLog) -> None:
    """Logs E of a fruit that plates compressed, its parts and what else is known.

    Raises TactileFailure, FemFailure or FruitEnded if there is no E.
    """
    facts = log.facts
    nu, nu_sd, _ = poisson_ratio(task.settings, task.prior)
    with log.stage("contact"):
        used = _recordings(task, log)
        doubts = of_findings([(recording.name, recording.findings) for recording in used])
        facts.doubts = tuple(doubt.sentence for doubt in doubts)
        log.warnings[:0] = facts.doubts
    with log.stage("modulus"):
        compression = _explained(used, nu)
        facts.pressed = _pressed_record(compression, task, nu)
        records = [*facts.grasps, *_grasp_records(compression)]
        facts.grasps = tuple(sorted(records, key=lambda record: record.grasp))
        if compression.explanation.withheld:
            raise FruitEnded(Outcome.WITHHELD_MODULUS, compression.explanation.withheld)
        facts.modulus = _modulus_record(compression, facts.pressed.shape_sd, nu, nu_sd, doubts)
        log.warnings += _warnings(compression)
        if task.settings.mismatch:
            names = ", ".join(dict.fromkeys(effect.effect for effect in task.settings.mismatch))
            log.warnings.append(
                f"E excludes the confirmed effects ({names}), because they need the fruit's mesh."
            )
    if task.screen:
        facts.screen = _screen_record(compression.explanation)


def _recordings(task: FruitTask, log: StageLog) -> list[CompressionTrace]:
    """Usable recordings; `log` gets why others are not usable. Raises as `why_no_grasp` says if none is."""
    used: list[CompressionTrace] = []
    failures: dict[str, TactileFailure | FemFailure] = {}
    stated, rig = stated_in_table(task.given), batch_rig(task.batch_root, task.settings)
    admit = partial(admitted, owner_of(task), log.facts.strangers, field="attribute fruit_id")
    for named, path in task.folder.recordings_by_name().items():
        name = printable(named)
        try:
            trace = compression_trace(
                path,
                stated=stated,
                prior=task.prior,
                body=task.body,
                rig=rig,
                admit=partial(admit, name=name),
            )
            refuse_copy(name, next((other.name for other in used if other.digest == trace.digest), None))
            if used and trace.fruit != used[0].fruit:
                raise _unfit(path, trace.fruit.said, f"{used[0].fruit.said}, as in {used[0].path.name}")
            used.append(trace)
            log.warnings += [note for note in trace.notes if note not in log.warnings]
        except (TactileFailure, FemFailure) as failure:
            failures[name] = failure
            log.warnings.append(f"not used: {failure.detail}")
    log.facts.grasps = tuple(
        GraspRecord(grasp=name, failure=tactile_failure.detail) for name, tactile_failure in failures.items()
    )
    if not used:
        raise why_no_grasp(list(failures.values()))
    return used


def compression_trace(
    path: Path,
    *,
    stated: Stated,
    prior: PitPrior | None,
    body: PitBody,
    rig: RigCurve | None,
    admit: Callable[[Recording], Sequence[Finding]],
) -> CompressionTrace:
    """One recording of plates around the fruit, with the travel of the batch's rig subtracted.

    `stated`: values of fruits.csv, which precede the recording's; `admit` returns the doubts that a recording
    is this fruit's. Raises TactileFailure or FemFailure.
    """
    recording = read_recording(path)
    if not is_bare(recording):
        raise _unfit(path, "pads with markers", "those of plates: a gel's recording needs a mesh or photos")
    findings = tuple(admit(recording))
    digest = recording_digest(recording)
    try:
        bare = bare_recording(recording, source=str(path), stated=stated, prior=prior)
    except BatchRefused as refused:
        said = " ".join(problem.sentence for problem in refused.problems)
        raise TactileFailure(TactileProblem.UNREADABLE_RECORDING, f"{path.name}: {said}") from None
    fruit = bare.known.geometry
    if not isinstance(fruit, Ellipsoid):
        expected = "plates on a fruit; use drupe explain for other indenters"
        raise _unfit(path, fruit.said, expected)
    if is_along_stem(fruit, body):
        raise TactileFailure(TactileProblem.UNREADABLE_RECORDING, f"{path.name}: found {ALONG_STEM}.")
    bare, notes = _without_rig(bare, rig, path)
    require_force(joined_traces([bare]).trace)
    return CompressionTrace(
        path=path,
        bare=bare,
        fruit=fruit,
        digest=digest,
        findings=findings,
        notes=(*(f"{path.name}: {note}." for note in recording.notes), *notes, *bare.known.notes),
    )


def _unfit(path: Path, contents: str, expected: str) -> TactileFailure:
    said = f"{path.name}: found {contents}, expected for a fruit without photos or mesh: {expected}."
    return TactileFailure(TactileProblem.UNREADABLE_RECORDING, said)


def _without_rig(
    bare: BareRecording, rig: RigCurve | None, path: Path
) -> tuple[BareRecording, tuple[str, ...]]:
    """The recording minus the travel of the batch's rig, unless `drupe convert --rig` subtracted one
    before."""
    if rig is None or bare.recording.rig_give_mm is not None:
        return bare, ()
    done = without_rig(bare.recording, rig, source=path.name, named="the batch's rig")
    return replace(bare, recording=done.recording), done.notes


def _explained(used: Sequence[CompressionTrace], nu: float) -> _Compression:
    """One law for all of them; raises FemFailure, or FruitEnded if only some exclude a rig's travel."""
    try:
        traces = joined_traces([recording.bare for recording in used])
    except BatchRefused as refused:
        said = " ".join(problem.sentence for problem in refused.problems)
        raise FruitEnded(Outcome.ALL_GRASPS_FAILED, said) from None
    explanation = explain_trace(
        traces.trace, thickness_mm=None, poisson_ratio=nu, rng=np.random.default_rng(TRACE_SEED)
    ).explanation
    alone = [explanation.before]
    if len(used) > 1:
        alone = [linear_modulus(part, thickness_mm=None, poisson_ratio=nu) for part in traces.trace.parts]
    return _Compression(recordings=tuple(used), traces=traces, explanation=explanation, alone=tuple(alone))


def _pressed_record(compression: _Compression, task: FruitTask, nu: float) -> PressedRecord:
    fruit, axis = compression.fruit, DIAMETERS[compression.fruit.axis]
    recorded_pit_share = compression.recordings[0].bare.pad.specimen.pit_share
    source = "fruits.csv" if task.given.pit_share is not None else "the recording"
    if task.given.pit_share is None and recorded_pit_share is None:
        source = "none given" if not fruit.pit_share else f"prior for {task.category}"
    of_suture = ALONG_SUTURE_SD if task.body.stem_and_suture and axis == "a" else 0.0
    return PressedRecord(
        diameters_mm=fruit.diameters_mm,
        compressed_along=(axis,),
        pit_share=fruit.pit_share,
        pit_source=source,
        shape_sd=float(np.hypot(fruit.shape_sd(nu), of_suture)),
    )


def _grasp_records(compression: _Compression) -> list[GraspRecord]:
    """The results of each recording alone; the curve from its first touch."""
    records = []
    for trace, recording, modulus in zip(
        compression.traces.trace.parts, compression.recordings, compression.alone, strict=True
    ):
        force, touch = trace.force_N, max(first_touch(trace) - 1, 0)
        records.append(
            GraspRecord(
                grasp=recording.name,
                digest=recording.digest,
                E_MPa=modulus.value,
                E_sd_MPa=modulus.sd,
                E_least_squares_MPa=modulus.value,
                E_least_squares_sd_MPa=modulus.sd,
                peak_force_N=float(force.max()),
                travel_mm=float(trace.travel_mm.max() - trace.travel_mm[touch]),
                frames_used=len(force),
                curves=[
                    CurveRecord(
                        pad="plates",
                        travel_mm=np.round(trace.travel_mm[touch:] - trace.travel_mm[touch], 4).tolist(),
                        force_N=np.round(force[touch:], 4).tolist(),
                    )
                ],
            )
        )
    return records


def _modulus_record(
    compression: _Compression, shape_sd: float, nu: float, nu_sd: float, doubts: Sequence[Doubt]
) -> ModulusRecord:
    E = compression.explanation.before
    parts = {
        RECORDINGS: E.sd,
        SHAPE: E.value * shape_sd,
        POISSON_RATIO: E.value * abs(_per_ratio(compression, nu, nu_sd)),
        DOUBTED: E.value * relative_sd(doubts),
    }
    return ModulusRecord(
        E_MPa=E.value,
        E_sd_MPa=float(np.linalg.norm(list(parts.values()))),
        common_sd_MPa=parts[POISSON_RATIO],
        parts_sd_MPa={name: sd for name, sd in parts.items() if sd},
    )


def _per_ratio(compression: _Compression, nu: float, nu_sd: float) -> float:
    """Change of ln E over one standard deviation of Poisson's ratio."""
    if not nu_sd:
        return 0.0
    depth = np.array(TYPICAL * float(np.ptp(compression.traces.trace.travel_mm)))
    low, high = max(nu - nu_sd, 0.0), min(nu + nu_sd, LARGEST_POISSON_RATIO)
    forces = [
        float(compression.fruit.curve(thickness_mm=None, poisson_ratio=ratio).force_N_per_MPa(depth))
        for ratio in (low, high)
    ]
    return float(np.log(forces[0] / forces[1]) * nu_sd / (high - low))


def _screen_record(explanation: Explanation) -> ScreenRecord:
    """What the curves show beyond linear elasticity, the likeliest names first."""
    verdict = explanation.verdict
    verdict = (verdict,) if isinstance(verdict, str) else verdict
    names = tuple(name for name in verdict if name != NONE) if explanation.detected else ()
    known = names and UNKNOWN not in names
    return ScreenRecord(
        p_value=explanation.p_value,
        p_nominal=True,
        names=names,
        suspected=suspected_of("|".join(names), explanation.before, explanation.after) if known else (),
    )


def _warnings(compression: _Compression) -> list[str]:
    """Warnings about E: recordings left out, a compliant rig, effects."""
    explanation, trace = compression.explanation, compression.traces.trace
    said = compression.traces.naming(explanation.notes[: len(explanation.left_out)])
    if all(part.rig_give_mm is None for part in trace.parts):
        said += rig_share(trace, rig_N_per_mm=None, made_known=OF_A_BATCH).notes
    before, after = explanation.before, explanation.after
    if explanation.verdict != NONE and abs(after.value - before.value) > before.sd + after.sd:
        said.append(
            f"With effects beyond linear elasticity, E is {after.value:.3g} ± {after.sd:.2g} MPa "
            "(drupe explain). The ranking uses linear elasticity, to treat all fruit alike."
        )
    return said
