"""From placed grasps and the flesh's mesh to the modulus; the dense responses are cached on disk."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import DTypeLike

from fem.elements.assembly import assemble
from fem.estimation.error_budget import DISCRETISATION
from fem.estimation.finite_response import neo_hookean_solid, with_finite_strain
from fem.estimation.fruit_modulus import FruitInference, infer_modulus
from fem.estimation.grasp_model import GraspModel, grasp_model
from fem.estimation.joint_inference import FruitModulus
from fem.estimation.prepared_grasp import PreparedGrasp, prepared_grasp
from fem.estimation.sensitivity import POISSON_RATIO
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import FleshMesh
from fem.mismatch.mismatch_case import MismatchCase
from fem.parallel_map import parallel_map
from fem.solid.finite_strain import FiniteStrainSolid
from fem.solid.linear_solid import Support, UnitModulusSolid
from fem.solid.pad_link import PadPlaces, pad_places
from pipeline.batch.cache import StageRecord, cached, content_hash, stage_key
from pipeline.batch.records import ModulusRecord, PitFoundRecord
from pipeline.batch.task import FruitTask
from pipeline.files.limited_memory import return_freed_memory
from pipeline.fruit.flesh_effects import added, in_the_model, with_corrections
from pipeline.fruit.grasped import GraspedFruit
from pipeline.fruit.input_doubts import DOUBTED
from pipeline.fruit.placed_grasp import PlacedGrasp, grasp_case
from pipeline.fruit.sensor_scale import NO_SCALE, SensorScale

CONFIRMED = "confirmed effects"
"""The part of an error bar that comes from effects in the batch's settings."""

SENSOR = "the sensor's own scale"
"""The part that comes from the scale of the gel's lengths: of its pictures, or as descriptions state it."""

GAIN = "force against the gel's stiffness"
"""The part that comes from a gain of the forces too small for the checks to detect. All fruit share it."""
OWN_GAIN = "noise in force against the gel's stiffness"
"""The part of that gain's error that comes from the noise of the fruit's own recordings."""

PLAIN_JAW = "contact of the plain jaw"
"""The part that comes from the unknown contact width of a jaw without a gel."""
PLAIN_JAW_SD = 0.04
"""Relative standard deviation of E by it. On four simulated fruit E is off by 3.0 % (rms), and one or two of
these are in any recording (benchmarks/one_gel_finger.py FOLDER --count 8 --half even); four are few."""

SMALL_STRAIN = "large deformation left out"
"""The part that comes from recordings for which the large-deformation solve failed."""
SMALL_STRAIN_SD = 0.1
"""Relative standard deviation of E by it, set by hand at the largest difference between both models: E of 20
recordings differs by 0.4 to 10 % (benchmarks/results/finite_strain.csv). Those that do not converge deform
most."""
_WITHOUT_LARGE = (
    "{name}: this recording enters E at small strain, because large deformation could not be solved for "
    "({why}). Its E is probably too high, and the error bar is wider. Check its forces and poses"
)

_Placed = tuple[PreparedGrasp, list[PadPlaces]]
"""A grasp and where its pads' markers are on the mesh."""


def fruit_modulus(
    task: FruitTask,
    fruit: GraspedFruit,
    *,
    stage: str = "response",
    solids: dict[Support, UnitModulusSolid] | None = None,
    workers: int = 1,
) -> FruitInference:
    """The fruit's modulus, and the pit's place if several grasps determine it; raises as infer_modulus does.

    The responses on each mesh that is tried are cached as `stage` and a number. `solids` collects the
    factorisations about the prior's pit for later use; it stays empty if the responses were cached.
    `workers`: grasps modelled at the same time (fem.parallel_map).
    """
    prepared, histories = prepared_histories(fruit.placed)
    number = itertools.count()

    def respond(moved: FleshMesh) -> list[GraspModel | FemFailure]:
        k = next(number)
        on_mesh = replace(fruit, mesh=moved)
        of_prior = solids if k == 0 else None
        return responses(task, f"{stage}-{k}", on_mesh, prepared, solids=of_prior, workers=workers)

    return infer_modulus(histories, fruit.mesh, respond, budget=fruit.budget)


def prepared_histories(
    grasps: Sequence[PlacedGrasp],
) -> tuple[list[PreparedGrasp | FemFailure], list[GraspHistory]]:
    """For each grasp: its prepared form, or why it drives no model; and its history, prepared if it can
    be.
    """
    prepared: list[PreparedGrasp | FemFailure] = []
    histories = []
    for grasp in grasps:
        case = grasp_case(grasp)
        try:
            prepared.append(ready := prepared_grasp(case.history, case.turns))
            histories.append(ready.history)
        except FemFailure as failure:
            prepared.append(failure)
            histories.append(case.history)
    return prepared, histories


def modulus_record(
    modulus: FruitModulus,
    *,
    effects_common_sd_MPa: float = 0.0,
    effects_own_sd_MPa: float = 0.0,
    doubted: float = 0.0,
    sensor: SensorScale = NO_SCALE,
    plain_jaws: float = 0.0,
    small_strain: float = 0.0,
) -> ModulusRecord:
    """The record of the fruit's modulus, and of the pit that was fitted with it.

    `effects_common_sd_MPa`, `effects_own_sd_MPa`: what confirmed effects add to its error, those of the whole
    batch and those of this fruit. `doubted`: relative standard deviation for contradictions in the inputs
    (pipeline.fruit.input_doubts). `sensor`: those of the sensors' scales. `plain_jaws`: share of the
    recordings in which one jaw has no gel. `small_strain`: share of those without the large deformation that
    the settings request.
    """
    pit = modulus.pit
    of_effects = float(np.hypot(effects_common_sd_MPa, effects_own_sd_MPa))
    further = {
        CONFIRMED: of_effects,
        DOUBTED: doubted * modulus.E_MPa,
        SENSOR: sensor.pictures * modulus.E_MPa,
        GAIN: sensor.gain * modulus.E_MPa,
        OWN_GAIN: sensor.own_gain * modulus.E_MPa,
        PLAIN_JAW: PLAIN_JAW_SD * plain_jaws * modulus.E_MPa,
        SMALL_STRAIN: SMALL_STRAIN_SD * small_strain * modulus.E_MPa,
    }
    shared = [modulus.parts_sd_MPa.get(part, 0.0) for part in (POISSON_RATIO, DISCRETISATION)]
    shared += [effects_common_sd_MPa, further[SENSOR], further[GAIN]]
    return ModulusRecord(
        E_MPa=modulus.E_MPa,
        E_sd_MPa=float(np.linalg.norm([modulus.E_sd_MPa, *further.values()])),
        common_sd_MPa=float(np.linalg.norm(shared)),
        scale_sd_MPa=sensor.common * modulus.E_MPa,
        parts_sd_MPa=modulus.parts_sd_MPa | {part: sd for part, sd in further.items() if sd},
        pit_found=None
        if pit is None
        else PitFoundRecord(
            offset_mm=tuple(pit.offset_mm.tolist()),
            offset_sd_mm=tuple(pit.sd[:3].tolist()),
            offset_prior_sd_mm=tuple(pit.prior_sd[:3].tolist()),
            size=float(np.exp(pit.ln_size)),
            size_sd=float(np.exp(pit.ln_size) * pit.sd[3]),
            size_prior_sd=float(pit.prior_sd[3]),
            moved=tuple(pit.moved.tolist()),
        ),
    )


def at_small_strain(grasps: Sequence[PlacedGrasp], inference: FruitInference) -> list[str]:
    """A warning for each recording at small strain because its large-deformation solve failed."""
    return [
        _WITHOUT_LARGE.format(name=grasp.name, why=model.small_strain_alone)
        for grasp, model in zip(grasps, inference.final_models, strict=True)
        if isinstance(model, GraspModel) and model.small_strain_alone
    ]


def responses(
    task: FruitTask,
    stage: str,
    fruit: GraspedFruit,
    prepared: Sequence[PreparedGrasp | FemFailure],
    *,
    solids: dict[Support, UnitModulusSolid] | None = None,
    workers: int = 1,
) -> list[GraspModel | FemFailure]:
    """The model of every grasp on the fruit's mesh, or why it has none; one factorisation per support.

    Cached on disk as `stage`, by content, without confirmed effects. `solids` collects the factorisations;
    `workers`: grasps modelled at the same time.
    """
    effects = in_the_model(task.settings.mismatch)
    # A law that includes large deformation must not receive it twice.
    holds_it = any(effect.spec.holds_large_deformation for effect in effects)
    large = task.settings.flesh.model == "neo-hookean" and not holds_it
    supports = [grasp.recording.support for grasp in fruit.placed]
    names = [grasp.name for grasp in fruit.placed]
    assumed = [fruit.poisson_ratio, fruit.budget.gel_scale_sd, large]
    key = stage_key(
        "response",
        files=[],
        settings=[content_hash(fruit.mesh, prepared), supports, names, assumed],
        rooms=("pipeline", "fem"),
    )

    def compute() -> KeptModels:
        return KeptModels.of(_models(fruit, prepared, large=large, solids=solids, workers=workers))

    plain = cached(task.results.cache, stage, key, compute, record=KeptModels).unpacked()
    both = zip(fruit.placed, plain, strict=True)
    modelled = [grasp_case(grasp) for grasp, model in both if isinstance(model, GraspModel)]
    if not effects or not modelled:
        return plain
    case = MismatchCase(
        mesh=fruit.mesh,
        grasps=tuple(modelled),
        poisson_ratio=fruit.poisson_ratio,
        budget=fruit.budget,
    )
    return with_corrections(plain, added(case, effects, at_finite_strain=large or holds_it))


class KeptFailure(StageRecord):
    """Why a grasp has no model."""

    problem: FemProblem
    detail: str


class KeptModels(StageRecord):
    """The stages "response-N": one model of each grasp, in single precision, or why there is none."""

    models: tuple[GraspModel | KeptFailure, ...]

    @classmethod
    def of(cls, models: Sequence[GraspModel | FemFailure]) -> "KeptModels":
        """The models as stored; only the lower triangle of a compliance counts."""
        return cls(
            models=tuple(
                KeptFailure(problem=model.problem, detail=model.detail)
                if isinstance(model, FemFailure)
                else _in(model, np.float32)
                for model in models
            )
        )

    def unpacked(self) -> list[GraspModel | FemFailure]:
        """The models to compute with, in double precision."""
        return [
            FemFailure(model.problem, model.detail)
            if isinstance(model, KeptFailure)
            else _in(model, np.float64)
            for model in self.models
        ]


def _in(model: GraspModel, precision: DTypeLike) -> GraspModel:
    compliance, correction = model.compliance, model.displacement_correction
    return replace(
        model,
        compliance=(np.tril(compliance) + np.tril(compliance, -1).T).astype(precision),
        sensitivity=replace(model.sensitivity, values=model.sensitivity.values.astype(precision)),
        displacement_correction=None if correction is None else correction.astype(precision),
    )


def _models(
    fruit: GraspedFruit,
    prepared: Sequence[PreparedGrasp | FemFailure],
    *,
    large: bool,
    solids: dict[Support, UnitModulusSolid] | None,
    workers: int,
) -> list[GraspModel | FemFailure]:
    """Models of every grasp on its support; `large`: with large deformation; `solids` as in `responses`."""
    models: dict[int, GraspModel | FemFailure] = {}
    placed: dict[int, _Placed] = {}
    for k, grasp in enumerate(prepared):
        if isinstance(grasp, FemFailure):
            models[k] = grasp
            continue
        try:
            placed[k] = grasp, [pad_places(pad, fruit.mesh) for pad in grasp.history.pads]
        except FemFailure as failure:
            models[k] = failure
    parts = assemble(fruit.mesh.nodes_mm, fruit.mesh.tets)
    supports = [grasp.recording.support for grasp in fruit.placed]
    for support in dict.fromkeys(supports[k] for k in placed):
        on_it = {k: grasp for k, grasp in placed.items() if supports[k] == support}
        try:
            solid = UnitModulusSolid.factorise(
                fruit.mesh, poisson_ratio=fruit.poisson_ratio, support=support, parts=parts
            )
        except FemFailure as failure:
            models |= dict.fromkeys(on_it, failure)
            continue
        return_freed_memory()
        if solids is not None:
            solids[support] = solid
        finite = neo_hookean_solid(solid) if large else None
        model = partial(_model, solid=solid, finite=finite, gel_scale_sd=fruit.budget.gel_scale_sd)
        models |= dict(zip(on_it, parallel_map(model, on_it.values(), workers=workers), strict=True))
    return [models[k] for k in range(len(prepared))]


def _model(
    placed: _Placed, *, solid: UnitModulusSolid, finite: FiniteStrainSolid | None, gel_scale_sd: float
) -> GraspModel | FemFailure:
    """The model of one grasp, with the compliance of its own contact nodes: motion where another grasp
    touches is of no use to either. If `finite` finds no equilibrium, the model is at small strain.
    """
    grasp, places = placed
    nodes = np.unique(np.concatenate([at.nodes for at in places]))
    touched = replace(solid, contact_nodes=nodes)
    try:
        small = grasp_model(grasp.history, touched, places=places)
    except FemFailure as failure:
        return failure
    if finite is None:
        return small
    try:
        return with_finite_strain(
            small,
            grasp.history,
            finite,
            recorded=grasp.recorded,
            force_sd_N=grasp.force_sd_N,
            scale_sd=gel_scale_sd,
        )
    except FemFailure as failure:
        return replace(small, small_strain_alone=failure.detail)
