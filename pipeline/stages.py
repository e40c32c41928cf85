"""One fruit, start to end: the whole product on one page.

photos -> mesh -> pit inside it -> pads on its surface -> flesh as finite elements -> modulus -> record
"""

import resource
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from fem.failure import FemFailure
from fem.solver import solver_name
from pipeline.elasticity import fruit_modulus, modulus_record
from pipeline.flesh import error_budget, flesh_mesh, poisson_ratio
from pipeline.grasp import PlacedGrasp, foreign, grasp_record, place_grasp, touched_by_pad
from pipeline.layout import write_whole
from pipeline.outcome import FruitEnded, Outcome
from pipeline.records import FleshRecord, FruitRecord, GraspRecord, write_record
from pipeline.shape import Shape, embedded_pit, fruit_shape, other_height, write_meshes
from pipeline.task import FruitTask
from recon.failure import ReconFailure
from reports.mesh_picture import mesh_picture
from tactile.failure import TactileFailure

FOOT_MM = 0.5
"""Skin up to this height above the lowest point is meshed finely where a base holds the fruit."""


@dataclass
class Diary:
    """What is known of the fruit so far: a fruit that ends with a reason loses none of it."""

    report: Callable[[str], None]
    known: dict[str, object] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Says that a stage begins, and keeps how long it took."""
        self.report(name)
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = round(time.perf_counter() - started, 2)


def grade_fruit(task: FruitTask, report: Callable[[str], None]) -> FruitRecord:
    """Grades one fruit and writes its record; a fruit that cannot be graded ends with its reason."""
    diary = Diary(report)
    outcome, reason = Outcome.GRADED.code, ""
    task.results.forget()
    with threadpool_limits(1):
        try:
            _grade(task, diary)
        except (ReconFailure, TactileFailure, FemFailure) as failure:
            outcome, reason = failure.problem.value, failure.detail
        except FruitEnded as ended:
            outcome, reason = ended.outcome.code, str(ended)
        except MemoryError as error:
            outcome, reason = Outcome.OUT_OF_MEMORY.code, Outcome.OUT_OF_MEMORY.sentence(str(error))
        except Exception as error:  # noqa: BLE001 - a fault of ours costs this fruit, and what is known is kept
            write_whole(task.results.traceback, traceback.format_exc())
            particulars = f"{type(error).__name__}: {error}"
            outcome, reason = Outcome.INTERNAL.code, Outcome.INTERNAL.sentence(particulars)
    record = FruitRecord.model_validate(
        {
            **diary.known,
            "fruit_id": task.fruit_id,
            "outcome": outcome,
            "reason": reason,
            "key": task.key,
            "given": task.given,
            "warnings": diary.warnings,
            "seconds": diary.seconds,
            "peak_memory_MiB": _peak_memory_MiB(),
        }
    )
    write_record(task.results.record, record)
    return record


def _grade(task: FruitTask, diary: Diary) -> None:
    known = diary.known
    with diary.stage("mesh"):
        shape = fruit_shape(task)
        known["mesh"] = shape.record
        diary.warnings += [*shape.warnings, *other_height(task, shape)]
    with diary.stage("pit"):
        pit = embedded_pit(task, shape)
        known["pit"] = pit.record
        write_meshes(task.results, shape, pit)
    placed, failures = _placed(task, shape, diary)
    failed = [GraspRecord(grasp=name, failure=str(failure)) for name, failure in failures.items()]
    known["grasps"] = tuple(failed)
    if not placed:
        write_whole(task.results.picture, mesh_picture(shape.vertices, shape.faces))
        raise _why_no_grasp(task, list(failures.values()))
    nu, nu_sd, source = poisson_ratio(task.settings, task.prior)
    with diary.stage("flesh"):
        mesh = flesh_mesh(task, pit, _where_fine(placed, shape))
        known["flesh"] = FleshRecord(
            nodes=len(mesh.nodes_mm),
            tets=len(mesh.tets),
            poisson_ratio=nu,
            poisson_ratio_sd=nu_sd,
            poisson_ratio_source=source,
            solver=solver_name(),
        )
    with diary.stage("modulus"):
        try:
            found = fruit_modulus(task, placed, mesh, poisson_ratio=nu, budget=error_budget(task, shape))
        except ExceptionGroup as none:
            reasons = [str(failure) for failure in none.exceptions]
            records = [GraspRecord(grasp=g.name, failure=r) for g, r in zip(placed, reasons, strict=True)]
            known["grasps"] = tuple(sorted([*failed, *records], key=lambda r: r.grasp))
            if not failed and len(records) == 1:
                raise none.exceptions[0] from None
            raise FruitEnded(Outcome.ALL_GRASPS_FAILED, "; ".join(reasons)) from none
        records = [*failed, *map(grasp_record, placed, found.grasps)]
        known["grasps"] = tuple(sorted(records, key=lambda r: r.grasp))
        known["modulus"] = modulus_record(found.modulus)
        for grasp, own in zip(placed, found.grasps, strict=True):
            if isinstance(own, FemFailure):
                diary.warnings.append(f"not used: {grasp.name}: {own.detail}")
            else:
                diary.warnings += [f"{grasp.name}: {warning}" for warning in own.warnings]
        diary.warnings += found.modulus.warnings
    with diary.stage("picture"):
        write_whole(
            task.results.picture,
            mesh_picture(
                shape.vertices,
                shape.faces,
                pit_vertices=pit.vertices,
                pit_faces=pit.faces,
                contacts_mm=touched_by_pad(placed),
            ),
        )


def _placed(
    task: FruitTask, shape: Shape, diary: Diary
) -> tuple[list[PlacedGrasp], dict[str, TactileFailure]]:
    """Every recording that can be used, and the failure of each that cannot."""
    placed, failures = [], {}
    with diary.stage("contact"):
        for path in task.folder.grasp_files():
            try:
                grasp = place_grasp(path, shape.vertices, shape.faces)
                placed.append(grasp)
                diary.warnings += foreign(grasp, task.fruit_id, task.settings.category)
            except TactileFailure as failure:
                failures[path.stem] = failure
                diary.warnings.append(f"not used: {failure.detail}")
    return placed, failures


def _where_fine(placed: list[PlacedGrasp], shape: Shape) -> Float[np.ndarray, "p 3"]:
    """Where elements must be small: under every pad, and at the foot of a fruit that stands on a base."""
    points = [points for grasp in placed for points in grasp.touched_mm.values()]
    if any(grasp.recording.support == "base" for grasp in placed):
        height = shape.vertices[:, 2] - shape.vertices[:, 2].min()
        points.append(shape.vertices[height < FOOT_MM])
    return np.vstack(points)


def _why_no_grasp(task: FruitTask, failures: list[TactileFailure]) -> Exception:
    """Why a fruit with a mesh has no modulus: its only recording's failure, all of theirs, or none."""
    if len(failures) == 1:
        return failures[0]
    if failures:
        return FruitEnded(Outcome.ALL_GRASPS_FAILED, "; ".join(map(str, failures)))
    raw = task.folder.raw_grasp_folders()
    return FruitEnded(
        Outcome.NO_GRASP,
        f"{raw[0].name}/ holds raw frames, which this version cannot read: convert them to .h5."
        if raw
        else "record one grasp and put its .h5 there.",
    )


def _peak_memory_MiB() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (2**20 if sys.platform == "darwin" else 2**10), 1)
