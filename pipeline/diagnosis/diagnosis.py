"""One case in the finder: grasps of a fruit between gel pads, or curves of a bare indenter."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from fem.estimation.grasp_model import GraspModel
from fem.estimation.modulus import ModulusEstimate
from fem.fem_failure import FemFailure
from fem.indentation.explain_trace import explain_trace
from fem.indentation.trace import IndenterTrace
from fem.mesh.flesh_mesh import FleshMesh
from fem.mismatch.mismatch_case import GradedCase, MismatchCase
from fem.mismatch.result import Explanation, Modulus
from fem.solid.linear_solid import Support, UnitModulusSolid
from pipeline.diagnosis.diagnosed_case import Case
from pipeline.diagnosis.notes import doubts_of_modulus, notes_on, notes_on_trace
from pipeline.fruit.bare_traces import BareTraces, bare_recordings, joined_traces
from pipeline.fruit.elasticity import at_small_strain, fruit_modulus
from pipeline.fruit.flesh_model import finer_flesh, poisson_ratio
from pipeline.fruit.grasped import GraspedFruit, grasped_fruit, where_fine
from pipeline.fruit.placed_grasp import grasp_case, touched_by_pad
from pipeline.fruit.pressed_fruit import TRACE_SEED
from pipeline.fruit.sensor_scale import sensor_scale
from pipeline.fruit.stage_log import StageLog
from tactile.tactile_failure import TactileFailure, TactileProblem


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """The explanation, the names of its recordings, where the pads touched, and facts for the page.

    `doubts`: why E cannot be right. `scale_sd`: standard deviation of ln E by the sensors' scales, which no E
    here includes.
    """

    explanation: Explanation
    grasps: tuple[str, ...]
    contacts_mm: Mapping[str, Float[np.ndarray, "_p 3"]] = field(default_factory=dict)
    facts: tuple[tuple[str, str], ...] = ()
    doubts: tuple[str, ...] = ()
    scale_sd: float = 0.0


def finding(case: Case, log: StageLog, *, jobs: int = 1) -> Diagnosis:
    """Explains the case with `jobs` threads, in stages that `log` records; raises as the stages do."""
    bare = bare_recordings(case.task.folder.grasp_files(), case.stated, case.task.prior)
    with threadpool_limits(1):
        diagnosis = (
            _of_grasps(case, log, jobs) if bare is None else _of_traces(case, log, joined_traces(bare))
        )
    return replace(diagnosis, doubts=doubts_of_modulus(case, diagnosis.explanation))


def mismatch_case(case: Case, fruit: GraspedFruit, *, finer_mesh: FleshMesh | None = None) -> MismatchCase:
    """The fruit as the finder's input; `finer_mesh`: for the plain response (`finer_mesh_of`)."""
    fruit = with_stated_surface(case, fruit)
    return MismatchCase(
        mesh=fruit.mesh,
        grasps=tuple(map(grasp_case, fruit.placed)),
        poisson_ratio=fruit.poisson_ratio,
        budget=fruit.budget,
        finer_mesh=finer_mesh,
    )


def finer_mesh_of(case: Case, fruit: GraspedFruit) -> FleshMesh | None:
    """The finder's finer mesh, if it is worth it. Raises FemFailure."""
    fine = where_fine(fruit.placed, fruit.shape)
    return finer_flesh(case.task, fruit.pit, fruit.mesh, fine, grasps=len(fruit.placed))


def with_stated_surface(case: Case, fruit: GraspedFruit) -> GraspedFruit:
    """The fruit with the surface error that the case states, if any."""
    if case.mesh_sd_mm is None:
        return fruit
    return replace(
        fruit,
        budget=replace(fruit.budget, surface_sd_mm=case.mesh_sd_mm),
        placed=tuple(replace(grasp, surface_sd_mm={}) for grasp in fruit.placed),
    )


def graded_case(case: Case, fruit: GraspedFruit, *, jobs: int = 1) -> tuple[GradedCase, list[str]]:
    """E without an effect, as `drupe grade` infers it from these recordings before doubts about the inputs
    widen it. Also the models of that inference, and notes on it. `jobs`: threads. Raises FemFailure.
    """
    fruit = with_stated_surface(case, fruit)
    solids: dict[Support, UnitModulusSolid] = {}
    try:
        inference = fruit_modulus(case.task, fruit, solids=solids, workers=jobs)
    except ExceptionGroup as failures:
        raise next(
            exception for exception in failures.exceptions if isinstance(exception, FemFailure)
        ) from None
    graded = GradedCase(
        modulus=Modulus(value=inference.modulus.E_MPa, sd=inference.modulus.E_sd_MPa),
        models=tuple(
            model if isinstance(model, GraspModel) and isinstance(outcome, ModulusEstimate) else None
            for model, outcome in zip(inference.models, inference.grasps, strict=True)
        ),
        solids=solids,
    )
    lost = [
        f"both values of E (with and without an effect) ignore {grasp.name}: {outcome.detail}."
        for grasp, outcome in zip(fruit.placed, inference.grasps, strict=True)
        if isinstance(outcome, FemFailure)
    ]
    said = [*at_small_strain(fruit.placed, inference), *inference.modulus.warnings]
    return graded, [*lost, *(f"E without an effect: {sentence}." for sentence in said)]


def find(case: MismatchCase, graded: GradedCase | None, log: StageLog, *, jobs: int) -> Explanation:
    """Runs the finder."""
    from fem.mismatch.procedure import explain

    return explain(case, graded=graded, progress=log.report, workers=jobs)


def _require_gels(fruit: GraspedFruit) -> None:
    """Raises TactileFailure (no-markers) for a grasp with a plain jaw: the finder needs both jaws'
    signals."""
    plain = [grasp.name for grasp in fruit.placed if grasp.plain_jaw]
    if plain:
        raise TactileFailure(
            TactileProblem.NO_MARKERS,
            f"{', '.join(plain)}: found a jaw without a gel, expected gels on both jaws. With one "
            "gel, nothing distinguishes sensor faults from the fruit. Use drupe grade for E, or "
            "record the fruit between two gels and move these recordings away.",
        )


def _of_grasps(case: Case, log: StageLog, jobs: int) -> Diagnosis:
    fruit = grasped_fruit(case.task, log, explains=True)
    _require_gels(fruit)
    finer_mesh, unrefined = None, list[str]()
    with log.stage("finer mesh"):
        try:
            finer_mesh = finer_mesh_of(case, fruit)
        except FemFailure as failure:
            unrefined = [f"the finder uses the mesh of grading for the plain model: {failure.detail}."]
    handed = mismatch_case(case, fruit, finer_mesh=finer_mesh)
    with log.stage("modulus"):
        try:
            graded, of_grading = graded_case(case, fruit, jobs=jobs)
        except FemFailure as failure:
            why = f"grading gives no E for these recordings ({failure.detail})"
            graded, of_grading = None, [f"{why}; E without an effect is the mean of the individual fits."]
    with log.stage("explanation"):
        explanation = find(handed, graded, log, jobs=jobs)
    notes = dict.fromkeys([*unrefined, *of_grading, *explanation.notes, *notes_on(case, fruit, log.warnings)])
    budget, pit = handed.budget, fruit.pit.record
    scale = sensor_scale([grasp.recording for grasp in fruit.placed], case.task.settings.sensor)
    off = f"± {budget.pit_offset_sd_mm:g} mm, ± {100 * budget.pit_size_sd:g} %"
    return Diagnosis(
        explanation=replace(explanation, notes=tuple(notes)),
        grasps=tuple(grasp.name for grasp in fruit.placed),
        contacts_mm=touched_by_pad(fruit.placed),
        scale_sd=scale.sd,
        facts=(
            ("Finite elements", f"{len(fruit.mesh.tets)} tetrahedra, {len(fruit.mesh.nodes_mm)} nodes"),
            ("Poisson's ratio", f"{fruit.poisson_ratio:g} ± {budget.poisson_ratio_sd:g}"),
            ("Pit", "none" if pit is None else pit.source),
            *([] if pit is None else [("Pit's place and size", off)]),
            ("Surface", f"± {budget.surface_sd_mm:.2g} mm"),
            (
                "Common scale of force and gel stiffness",
                f"± {100 * scale.common:.2g} % of E, in addition to its error",
            ),
        ),
    )


def _of_traces(case: Case, log: StageLog, bare: BareTraces) -> Diagnosis:
    nu = poisson_ratio(case.task.settings, case.task.prior)[0]
    with log.stage("explanation"):
        explanation = explain_trace(
            replace(bare.trace, drift_N_per_min=case.drift_N_per_min),
            thickness_mm=bare.known.thickness_mm,
            poisson_ratio=nu,
            rng=np.random.default_rng(TRACE_SEED),
            rig_N_per_mm=case.rig_N_per_mm,
        ).explanation
    notes = dict.fromkeys([*bare.naming(explanation.notes), *bare.notes, *notes_on_trace(case), *case.notes])
    return Diagnosis(
        explanation=replace(explanation, notes=tuple(notes)),
        grasps=bare.names,
        facts=(
            ("Indenter", bare.trace.geometry.said),
            *bare.facts,
            ("Rig", _rig_in_words(case, bare.trace)),
            ("Poisson's ratio", f"{nu:g}"),
        ),
    )


def _rig_in_words(case: Case, trace: IndenterTrace) -> str:
    if trace.rig_give_mm is not None:
        return f"drupe subtracted the rig's own {trace.rig_give_mm.max():.3g} mm at most from the travel"
    return "not known" if case.rig_N_per_mm is None else f"{case.rig_N_per_mm:g} N/mm, not subtracted"
