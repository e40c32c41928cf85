"""The screen of one fruit for missing physics, kept by content; it never costs the fruit its grade."""

import traceback
from collections.abc import Mapping, Sequence
from dataclasses import astuple, replace

import numpy as np

from fem.estimation.fruit_modulus import FruitInference
from fem.estimation.grasp_model import GraspModel
from fem.estimation.modulus import ModulusEstimate
from fem.fem_failure import FemFailure
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.screen import Screened, screen
from fem.solid.linear_solid import Support, UnitModulusSolid
from pipeline.batch.cache import cached, stage_key
from pipeline.batch.confirmed_effects import keyed
from pipeline.batch.layout import write_whole
from pipeline.batch.outcome import Outcome, ending_of
from pipeline.batch.records import AmountRecord, ScreenRecord, SuspectedRecord
from pipeline.batch.stage_record import StageRecord
from pipeline.batch.task import FruitTask
from pipeline.fruit.content_hash import content_hash
from pipeline.fruit.flesh_effects import in_the_model
from pipeline.fruit.grasped import GraspedFruit
from pipeline.fruit.placed_grasp import PlacedGrasp, grasp_case

STAGE = "screen"
"""Name of the stage: on the progress line, in the record's times, and of the file that keeps its result."""
ONE_GEL = "one jaw has no gel ({}), so nothing distinguishes sensor faults from the fruit"
INTERNAL = "drupe has an internal error; report it with traceback.txt from this fruit's results"


class KeptScreen(StageRecord):
    """The stage "screen"."""

    screen: ScreenRecord


def screened_fruit(
    task: FruitTask,
    fruit: GraspedFruit,
    inference: FruitInference,
    solids: Mapping[Support, UnitModulusSolid],
) -> ScreenRecord:
    """What the recordings hold beyond the model that E was inferred with, or why that cannot be told.

    `solids`: those that grading has just factorised, where it has.
    """
    plain = [grasp.name for grasp in fruit.placed if grasp.plain_jaw]
    if plain:
        return ScreenRecord(failure=ONE_GEL.format(", ".join(plain)))
    usable = [
        (grasp, model, estimate)
        for grasp, model, estimate in zip(fruit.placed, inference.models, inference.grasps, strict=True)
        if isinstance(model, GraspModel)
        and isinstance(estimate, ModulusEstimate)
        and estimate.form == "first-touch"
    ]
    placed = [grasp for grasp, _, _ in usable]
    case = MismatchCase(
        mesh=fruit.mesh,
        grasps=tuple(map(grasp_case, placed)),
        poisson_ratio=fruit.poisson_ratio,
        budget=fruit.budget,
    )

    confirmed = in_the_model(task.settings.mismatch)
    holds_it = any(effect.spec.holds_large_deformation for effect in confirmed)
    finite = task.settings.flesh.model == "neo-hookean" and not holds_it
    # With nothing confirmed the correction is that of finite strain alone. The finder's own column fits
    # better: it spreads the traction as the signatures do (docs/decisions/0014).
    models = [
        replace(model, displacement_correction=None) if finite and not confirmed else model
        for _, model, _ in usable
    ]

    def compute() -> KeptScreen:
        try:
            said = screen(
                case,
                E_MPa=1 / float(np.median([1 / estimate.E_MPa for _, _, estimate in usable]))
                if usable
                else 1.0,
                models=models,
                solids=solids,
                holds_large_deformation=holds_it,
                at_finite_strain=[
                    grasp.name
                    for grasp, model, _ in usable
                    if finite and confirmed and not model.small_strain_alone
                ],
            )
        except FemFailure as failure:
            return KeptScreen(screen=ScreenRecord(failure=failure.detail))
        return KeptScreen(screen=_record(said, fruit.placed, placed))

    key = stage_key(
        STAGE,
        files=[],
        settings=[
            content_hash(case.mesh, case.grasps),
            [grasp.name for grasp in placed],
            [estimate.E_MPa for _, _, estimate in usable],
            fruit.poisson_ratio,
            astuple(fruit.budget),
            task.settings.flesh.model,
            [effect.effect for effect in confirmed],
            keyed(task.settings.mismatch),
        ],
        rooms=("pipeline", "fem"),
    )
    try:
        return cached(task.results.cache, STAGE, key, compute, record=KeptScreen).screen
    except Exception as error:  # noqa: BLE001 - whatever goes wrong here, the fruit is graded
        ending, particulars = ending_of(error)
        if ending is not Outcome.INTERNAL:
            return ScreenRecord(failure=ending.sentence(particulars), again=True)
        write_whole(task.results.traceback, traceback.format_exc())
        return ScreenRecord(failure=INTERNAL, again=True)


def _record(said: Screened, all_grasps: Sequence[PlacedGrasp], used: Sequence[PlacedGrasp]) -> ScreenRecord:
    lost = [grasp.name for grasp in all_grasps if grasp not in used]
    without = f"without {', '.join(lost)}, which give no E from first contact" if lost else ""
    return ScreenRecord(
        p_value=said.p_value,
        names=said.names,
        statistics=said.statistics,
        gains=said.gains,
        amounts=tuple(
            AmountRecord(
                effect=amount.effect,
                pad=amount.pad,
                parameter=amount.parameter,
                value=amount.value,
                sd=amount.sd,
            )
            for amount in said.amounts
        ),
        suspected=tuple(
            SuspectedRecord(effect=name, E_ratio=ratio, added_sd=sd)
            for name, (ratio, sd) in said.moduli.items()
        ),
        note="; ".join(part for part in (without, said.note) if part),
    )
