"""A fruit prepared for mechanics: its surface, its pit, every recording placed on it, and its mesh."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float

from fem.estimation.error_budget import ErrorBudget
from fem.fem_failure import FemFailure
from fem.mesh.flesh_mesh import FleshMesh
from fem.sparse.solver import solver_name
from pipeline.batch.cache import StageRecord, cached, file_hash, stage_key
from pipeline.batch.layout import in_order, raw_grasp_files, write_whole
from pipeline.batch.outcome import FruitEnded, Outcome
from pipeline.batch.records import FleshRecord
from pipeline.batch.rig_setting import batch_rig, jaw_faults
from pipeline.batch.task import FruitTask
from pipeline.files.limited_memory import return_freed_memory
from pipeline.files.plain_file import printable
from pipeline.files.whole_file import put
from pipeline.fruit.category_doubts import of_category, of_poisson_ratio, shipped_categories
from pipeline.fruit.flesh_model import error_budget, flesh_mesh, poisson_ratio
from pipeline.fruit.fruit_shape import FruitPit, FruitShape, embedded_pit, fruit_shape, write_meshes
from pipeline.fruit.input_doubts import Doubt, of_a_given_pit, of_grasps, remarks_of_grasps
from pipeline.fruit.placed_grasp import Checked, PlacedGrasp, place_grasp
from pipeline.fruit.recording_owner import Owner, owner_findings, refuse_copy, stranger
from pipeline.fruit.stage_log import StageLog
from recon.surface.ray_mesh import SEEN_BY
from reports.grasp_record import GraspRecord
from tactile.consistency.finding import Finding
from tactile.from_frames import recording_of
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import Recording, write_recording
from tactile.tactile_failure import TactileFailure


class KeptRecording(StageRecord):
    """The stage "frames of NAME": SHA-256 of the `.h5` beside it, made from a raw grasp, and notes on how."""

    sha256: str
    notes: tuple[str, ...]


def kept_recording(folder: Path, cache: Path, report: Callable[[str], None]) -> tuple[Path, tuple[str, ...]]:
    """The recording of the raw grasp in `folder`, and notes; made only if its files or the code changed.

    `report` gets each pad's progress. Raises TactileFailure that names the file and the field.
    """
    key = stage_key(
        "raw grasp", files=raw_grasp_files(folder), settings=None, rooms=("tactile", "pipeline/files")
    )

    name = f"frames of {folder.name}"
    path = cache / f"{name}.h5"

    def compute() -> KeptRecording:
        made = recording_of(read_raw_grasp(folder), progress=_in_quarters(folder.name, report))
        with TemporaryDirectory() as scratch:
            draft = Path(scratch) / "grasp.h5"
            write_recording(draft, made.recording)
            put(path, draft.read_bytes())
        return KeptRecording(sha256=file_hash(path), notes=made.notes)

    kept = cached(cache, name, key, compute, record=KeptRecording)
    if file_hash(path) != kept.sha256:  # removed or changed since
        kept = compute()
    return path, kept.notes


def _in_quarters(grasp: str, report: Callable[[str], None]) -> Callable[[str, int, int], None]:
    def progress(pad: str, done: int, total: int) -> None:
        if done in (0, total) or done * 4 // total != (done - 1) * 4 // total:
            report(f"{grasp}: {pad}, frame {done} of {total}")

    return progress


FOOT_MM = 0.5
"""Skin up to this height above the lowest point is meshed finely where a base holds the fruit."""
FLAT_FOOT = 0.5
"""A foot wider than this share of the fruit, both ways, is flat: any mesh has nodes on it. Fine elements
there would take degrees of freedom from the pads. The foot of a ball is 18 % wide for a radius of 30 mm, 29 %
for 12 mm. E of the pressed cube of tests/batch/test_phantoms.py, its faces in 2.5 mm triangles, is 1.7 % too
low with fine elements on its foot, without them 0.8 % (means of three recordings)."""


@dataclass(frozen=True, kw_only=True)
class GraspedFruit:
    """Input of the modulus and of the mismatch finder; `failed`: unusable recordings, and why.

    `doubts`: contradictions in the inputs used.
    """

    shape: FruitShape
    pit: FruitPit
    placed: tuple[PlacedGrasp, ...]
    failed: tuple[GraspRecord, ...]
    mesh: FleshMesh
    poisson_ratio: float
    budget: ErrorBudget
    doubts: tuple[Doubt, ...] = ()


def grasped_fruit(task: FruitTask, log: StageLog, *, explains: bool = False) -> GraspedFruit:
    """From photos or a ready mesh to elements; `log` gets each stage.

    `explains`: for the mismatch finder (pipeline.fruit.placed_grasp.Checked).

    Raises ReconFailure, TactileFailure, FemFailure or FruitEnded if the fruit cannot be graded.
    """
    # Imported here: only this function draws, so that other users of this module do not load Matplotlib.
    from reports.skin_picture import mesh_picture, surface_sd_map

    facts = log.facts
    with log.stage("mesh"):
        shape = fruit_shape(task)
        facts.mesh = shape.record
        log.warnings += shape.warnings
        if shape.sd_mm is not None and shape.views is not None:
            shown = surface_sd_map(shape.vertices, shape.faces, shape.sd_mm, seen=shape.views >= SEEN_BY)
            write_whole(task.results.surface_sd, shown)
    return_freed_memory()
    with log.stage("pit"):
        pit = embedded_pit(task, shape)
        facts.pit = pit.record
        write_meshes(task.results, shape, pit)
        doubts = _pit_doubts(task, shape, pit) + _category_doubts(task, shape)
    placed, failures = _placed(task, shape, replace(_checked(task, shape), explains=explains), log)
    failed = tuple(GraspRecord(grasp=name, failure=str(failure)) for name, failure in failures.items())
    facts.grasps = failed
    if not placed:
        write_whole(task.results.picture, mesh_picture(shape.vertices, shape.faces))
        raise why_no_grasp(list(failures.values()))
    doubts += of_grasps(placed)
    log.warnings[:0] = [doubt.sentence for doubt in doubts]
    log.warnings += remarks_of_grasps(placed)
    facts.doubts = tuple(doubt.sentence for doubt in doubts)
    nu, nu_sd, source = poisson_ratio(task.settings, task.prior)
    with log.stage("flesh"):
        mesh = flesh_mesh(task, pit, where_fine(placed, shape))
        facts.flesh = FleshRecord(
            nodes=len(mesh.nodes_mm),
            tets=len(mesh.tets),
            poisson_ratio=nu,
            poisson_ratio_sd=nu_sd,
            poisson_ratio_source=source,
            solver=solver_name(),
        )
    return_freed_memory()
    budget = error_budget(task, shape, [grasp.recording for grasp in placed])
    if facts.pit is not None:
        facts.pit = facts.pit.model_copy(update={"size_sd": budget.pit_size_sd})
    return GraspedFruit(
        shape=shape,
        pit=pit,
        placed=tuple(placed),
        failed=failed,
        mesh=mesh,
        poisson_ratio=nu,
        budget=budget,
        doubts=tuple(doubts),
    )


def _pit_doubts(task: FruitTask, shape: FruitShape, pit: FruitPit) -> list[Doubt]:
    """Doubts where the fruit's own pit is unlike its category's; raises FruitEnded if E would mean
    nothing."""
    if not task.folder.pit_ply.is_file():
        return []
    doubts = of_a_given_pit(shape.vertices, pit.vertices, pit.faces, task.prior)
    refused = [doubt.sentence for doubt in doubts if doubt.refused]
    if refused:
        raise FruitEnded(Outcome.IMPLAUSIBLE_PIT, " ".join(refused))
    return doubts


def _category_doubts(task: FruitTask, shape: FruitShape) -> list[Doubt]:
    """Doubts where Poisson's ratio or the mesh's size is another category's; a given pit needs no size
    check."""
    doubts = of_poisson_ratio(task.settings, task.prior)
    if task.given.reference or task.settings.pit.none or task.folder.pit_ply.is_file():
        return doubts
    return doubts + of_category(shape.record.box_mm, task.prior, others=shipped_categories())


def _placed(
    task: FruitTask, shape: FruitShape, checked: Checked, log: StageLog
) -> tuple[list[PlacedGrasp], dict[str, TactileFailure]]:
    placed: list[PlacedGrasp] = []
    failures: dict[str, TactileFailure] = {}
    folder, owner = task.folder, owner_of(task)
    strangers = log.facts.strangers
    rig = batch_rig(task.batch_root, task.settings)
    recordings = folder.recordings_by_name()
    recordings |= {path.name: path for path in folder.raw_grasp_folders()}
    with log.stage("contact"):
        for named, path in sorted(
            recordings.items(), key=lambda name_and_path: in_order(Path(name_and_path[0]))
        ):
            name = printable(named)
            field = "attribute fruit_id"
            try:
                if path.is_dir():
                    field = "fruit_id in grasp.toml"
                    path, notes = kept_recording(path, task.results.cache, log.progress)
                    log.warnings += notes
                grasp = place_grasp(
                    path,
                    shape.vertices,
                    shape.faces,
                    name=name,
                    faults=jaw_faults(task.settings.mismatch, rig),
                    sd_mm=shape.sd_mm,
                    mat_from_fruit=shape.mat_from_fruit,
                    checked=replace(checked, rig=rig),
                    admit=partial(admitted, owner, strangers, name=name, field=field),
                )
                refuse_copy(
                    name, next((earlier.name for earlier in placed if earlier.digest == grasp.digest), None)
                )
                placed.append(grasp)
            except TactileFailure as failure:
                failures[name] = failure
                said = failure.detail
                log.warnings.append(f"not used: {said if name in said else f'{name}: {said}'}")
    return placed, failures


def owner_of(task: FruitTask) -> Owner:
    """What a recording in the fruit's folder should name; for a reference body, any category."""
    category = None if task.given.reference else task.category
    return Owner(fruit_id=task.fruit_id, category=category, batch_fruits=task.batch_fruits)


def admitted(
    owner: Owner, strangers: dict[str, bool], recording: Recording, *, name: str, field: str
) -> list[Finding]:
    """Doubts that a recording is its owner's; raises TactileFailure if it is another's.

    `strangers` gets the fruit that it names instead, and whether the batch has that fruit.
    """
    named = recording.fruit_id
    if (other := stranger(named, owner)) is not None:
        strangers[other] = other in (owner.batch_fruits or ())
    return owner_findings(named, recording.category, owner, source=name, field=field)


def _checked(task: FruitTask, shape: FruitShape) -> Checked:
    plausible = None if task.prior is None else task.prior.plausible
    scale = (shape.record.scale_sd or 0.0) * max(shape.record.box_mm) / 2
    return Checked(
        E_range_MPa=None if plausible is None else plausible.E_MPa,
        surface_sd_mm=float(np.hypot(shape.record.surface_sd_mm or 0.0, scale)),
        sensor=task.settings.sensor,
    )


def where_fine(placed: Sequence[PlacedGrasp], shape: FruitShape) -> Float[np.ndarray, "p 3"]:
    """Where elements must be small: under every pad, and at the round foot of a fruit on a base."""
    points = [points for grasp in placed for points in grasp.touched_mm.values()]
    if any(grasp.recording.support == "base" for grasp in placed):
        height = shape.vertices[:, 2] - shape.vertices[:, 2].min()
        foot = shape.vertices[height < FOOT_MM]
        share = np.ptp(foot[:, :2], axis=0) / np.ptp(shape.vertices[:, :2], axis=0)
        if not (share > FLAT_FOOT).all():
            points.append(foot)
    return np.vstack(points)


def why_no_grasp(failures: Sequence[TactileFailure | FemFailure]) -> Exception:
    """Why a fruit has no modulus: its only recording's failure, all failures, or that there is no
    recording."""
    if len(failures) == 1:
        return failures[0]
    if failures:
        return FruitEnded(Outcome.ALL_GRASPS_FAILED, " ".join(map(str, failures)))
    return FruitEnded(Outcome.NO_GRASP, "record one grasp and put its .h5, or its frames, there.")
