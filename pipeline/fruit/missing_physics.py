"""Screens one fruit for missing physics, cached by content; a failure never costs the fruit its grade."""

import traceback
from collections.abc import Mapping, Sequence
from dataclasses import astuple, replace

from fem.estimation.fruit_modulus import FruitInference
from fem.estimation.grasp_model import GraspModel
from fem.estimation.modulus import ModulusEstimate
from fem.fem_failure import FemFailure
from fem.mismatch.mismatch_case import MismatchCase
from fem.mismatch.screen import Screened, screen
from fem.solid.linear_solid import Support, UnitModulusSolid
from pipeline.batch.cache import StageRecord, cached, content_hash, stage_key
from pipeline.batch.confirmed_effects import keyed
from pipeline.batch.layout import write_whole
from pipeline.batch.outcome import Outcome, ending_of
from pipeline.batch.records import AmountRecord, ScreenRecord, SuspectedRecord
from pipeline.batch.task import FruitTask
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
    """What the recordings show beyond the model with which E was inferred, or why the screen failed.

    `solids`: those that grading has just factorised, if any.
    """
    plain = [grasp.name for grasp in fruit.placed if grasp.plain_jaw]
    if plain:
        return ScreenRecord(failure=ONE_GEL.format(", ".join(plain)))
    usable = [
        (grasp, model)
        for grasp, model, estimate in zip(fruit.placed, inference.models, inference.grasps, strict=True)
        if isinstance(model, GraspModel) and isinstance(estimate, ModulusEstimate)
    ]
    placed = [grasp for grasp, _ in usable]
    confirmed = in_the_model(task.settings.mismatch)
    case = MismatchCase(
        mesh=fruit.mesh,
        grasps=tuple(
            replace(grasp_case(grasp), correction=model.displacement_correction if confirmed else None)
            for grasp, model in usable
        ),
        poisson_ratio=fruit.poisson_ratio,
        budget=fruit.budget,
    )
    # With confirmed effects, grading's correction includes finite strain. Without any, the finder's own
    # columns fit better: they spread the traction as the signatures do (docs/decisions/0014).
    holds_it = any(effect.spec.holds_large_deformation for effect in confirmed)
    at_finite_strain = bool(confirmed) and (task.settings.flesh.model == "neo-hookean" or holds_it)

    def compute() -> KeptScreen:
        try:
            said = screen(case, solids=solids, beyond_small_strain=not at_finite_strain)
        except FemFailure as failure:
            return KeptScreen(screen=ScreenRecord(failure=failure.detail))
        return KeptScreen(screen=_record(said, fruit.placed, placed))

    key = stage_key(
        STAGE,
        files=[],
        settings=[
            content_hash(case.mesh, case.grasps),
            [grasp.name for grasp in placed],
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
        amounts=tuple(AmountRecord(**vars(amount)) for amount in said.amounts),
        suspected=tuple(
            SuspectedRecord(effect=name, E_ratio=ratio, added_sd=sd)
            for name, (ratio, sd) in said.moduli.items()
        ),
        note="; ".join(part for part in (without, said.note) if part),
    )
