"""One fruit, start to end: the whole product on one page.

photos -> mesh -> pit inside it -> pads on its surface -> flesh as finite elements -> modulus
       -> screen for missing physics -> record

A fruit with neither photos nor mesh, between bare plates, is graded by pressed_fruit.py instead.
"""

import resource
import sys
import traceback
from collections.abc import Callable

from threadpoolctl import threadpool_limits

from fem.estimation.fruit_modulus import FruitInference
from fem.fem_failure import FemFailure
from fem.solid.linear_solid import Support, UnitModulusSolid
from pipeline.batch.confirmed_effects import in_words
from pipeline.batch.layout import write_whole
from pipeline.batch.outcome import FruitEnded, Outcome, ending_of
from pipeline.batch.records import FruitRecord, write_record
from pipeline.batch.task import FruitTask
from pipeline.batch.unused_files import unused_of_fruit
from pipeline.files.limited_memory import return_freed_memory
from pipeline.files.plain_file import printable
from pipeline.fruit.elasticity import at_small_strain, modulus_record
from pipeline.fruit.flesh_effects import unused_warnings, used
from pipeline.fruit.grasped import GraspedFruit, grasped_fruit
from pipeline.fruit.input_doubts import causes_alone, expected_E_MPa, relative_sd
from pipeline.fruit.missing_physics import STAGE as SCREEN
from pipeline.fruit.missing_physics import screened_fruit
from pipeline.fruit.placed_grasp import grasp_record, patch_residuals, touched_by_pad
from pipeline.fruit.repeated_modulus import effect_spread, with_plain_jaws
from pipeline.fruit.sensor_scale import sensor_scale
from pipeline.fruit.stage_log import StageLog
from recon.recon_failure import ReconFailure
from reports.fruit_scene import SceneSurface, fruit_scene
from reports.grasp_record import GraspRecord
from reports.skin_layer import residual_layer
from reports.skin_picture import mesh_picture
from tactile.tactile_failure import TactileFailure


def grade_fruit(task: FruitTask, report: Callable[[str], None]) -> FruitRecord:
    """Grades one fruit and writes its record; a fruit that cannot be graded ends with its reason."""
    log = StageLog(report)
    outcome, reason = Outcome.GRADED.code, ""
    task.results.claim()
    task.results.forget()
    log.warnings += [printable(problem.sentence) for problem in unused_of_fruit(task.folder)]
    with threadpool_limits(1):
        try:
            if task.folder.without_shape():
                # Only such a fruit needs the module for bare curves.
                from pipeline.fruit.pressed_fruit import grade_pressed

                grade_pressed(task, log)
                if log.facts.modulus is not None:
                    _refuse_implausible(task, log.facts.modulus.E_MPa)
            else:
                _grade(task, log)
        except (ReconFailure, TactileFailure, FemFailure) as failure:
            outcome, reason = failure.problem.value, failure.detail
        except FruitEnded as ended:
            outcome, reason = ended.outcome.code, str(ended)
        except Exception as error:  # noqa: BLE001 - a fault costs this fruit alone, and what is known is kept
            ending, particulars = ending_of(error)
            if ending is Outcome.INTERNAL:
                write_whole(task.results.traceback, traceback.format_exc())
            outcome, reason = ending.code, ending.sentence(particulars)
    record = FruitRecord(
        fruit_id=task.fruit_id,
        outcome=outcome,
        reason=task.named_in_batch(reason),
        key=task.key,
        given=task.given,
        **vars(log.facts),
        warnings=tuple(log.warnings),
        seconds=log.seconds,
        peak_memory_MiB=_peak_memory_MiB(),
    )
    write_record(task.results.record, record)
    return record


def measured_fruit(
    task: FruitTask, log: StageLog, *, solids: dict[Support, UnitModulusSolid] | None = None
) -> tuple[GraspedFruit, FruitInference]:
    """E of a fruit with photos or a mesh, without the screen: facts, doubts and warnings go to `log`.

    `solids` collects the factorisations, by support. Raises ReconFailure, TactileFailure, FemFailure or
    FruitEnded if there is no E.
    """
    facts = log.facts
    fruit = grasped_fruit(task, log)
    failed, placed = fruit.failed, fruit.placed
    with log.stage("modulus"):
        try:
            fruit, inference = with_plain_jaws(task, fruit, solids=solids)
            placed = fruit.placed
        except ExceptionGroup as none:
            reasons = [str(failure) for failure in none.exceptions]
            records = [GraspRecord(grasp=g.name, failure=r) for g, r in zip(placed, reasons, strict=True)]
            facts.grasps = tuple(sorted([*failed, *records], key=lambda r: r.grasp))
            if not failed and len(records) == 1:
                raise none.exceptions[0] from None
            raise FruitEnded(Outcome.ALL_GRASPS_FAILED, "; ".join(reasons)) from none
        records = [*failed, *map(grasp_record, placed, inference.grasps)]
        facts.grasps = tuple(sorted(records, key=lambda r: r.grasp))
        without_large = at_small_strain(placed, inference)
        spread = effect_spread(task, fruit, inference.modulus.E_MPa)
        facts.modulus = modulus_record(
            inference.modulus,
            effects_common_sd_MPa=spread.common_sd_MPa,
            effects_own_sd_MPa=spread.own_sd_MPa,
            doubted=relative_sd(fruit.doubts),
            sensor=sensor_scale([placed_grasp.recording for placed_grasp in placed], task.settings.sensor),
            plain_jaws=sum(grasp.plain_jaw for grasp in placed) / len(placed),
            small_strain=len(without_large) / len(placed),
        )
        _refuse_implausible(task, inference.modulus.E_MPa)
        facts.mismatch = in_words(used(task.settings.mismatch)) or None
        log.warnings += [*unused_warnings(task.settings.mismatch), *spread.doubts]
        for grasp, estimate in zip(placed, inference.grasps, strict=True):
            if isinstance(estimate, FemFailure):
                log.warnings.append(f"not used: {grasp.name}: {estimate.detail}")
            else:
                log.warnings += [
                    f"{grasp.name}: {warning.sentence}" for warning in causes_alone(grasp, estimate.warnings)
                ]
        log.warnings += [*without_large, *inference.modulus.warnings]
    return fruit, inference


def _grade(task: FruitTask, log: StageLog) -> None:
    solids: dict[Support, UnitModulusSolid] = {}
    fruit, inference = measured_fruit(task, log, solids=solids if task.screen else None)
    shape, pit, placed = fruit.shape, fruit.pit, fruit.placed
    return_freed_memory()
    if task.screen:
        with log.stage(SCREEN):
            log.facts.screen = screened_fruit(task, fruit, inference, solids)
    solids.clear()
    with log.stage("picture"):
        write_whole(
            task.results.picture,
            mesh_picture(
                shape.vertices,
                shape.faces,
                pit_vertices=pit.vertices,
                contacts_mm=touched_by_pad(placed),
            ),
        )
        write_whole(
            task.results.scene,
            fruit_scene(
                SceneSurface(shape.vertices, shape.faces),
                SceneSurface(pit.vertices, pit.faces) if len(pit.faces) else None,
                touched_by_pad(placed),
                residual_layer(shape.vertices, patch_residuals(placed, inference.grasps)),
                photo=shape.skin,
                stem_and_suture=task.body.stem_and_suture,
            ),
        )


def _refuse_implausible(task: FruitTask, E_MPa: float) -> None:
    limits = expected_E_MPa(task.prior)
    if limits is not None and not limits[0] <= E_MPa <= limits[1]:
        said = f"{E_MPa:.3g} MPa (expected {limits[0]:g} to {limits[1]:g} MPa)"
        raise FruitEnded(Outcome.IMPLAUSIBLE_MODULUS, said)


def _peak_memory_MiB() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (2**20 if sys.platform == "darwin" else 2**10), 1)
