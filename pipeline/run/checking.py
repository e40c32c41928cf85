"""`drupe check`: every problem of a batch at once, and every doubt about E, without computing anything."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from pipeline.batch.confirmed_effects import ConfirmedEffect, effects_on, pit_found
from pipeline.batch.fruits_table import FruitRow, given_of
from pipeline.batch.layout import FruitFolder
from pipeline.batch.named_priors import category_of, named_files
from pipeline.batch.opening import (
    Batch,
    fruit_folders,
    model_faults,
    provider_faults,
    shape_from_photos,
    survey,
)
from pipeline.batch.outcome import Outcome
from pipeline.batch.plausible_numbers import (
    PlausibleRange,
    grading_doubts,
    kind_of,
    mesh_doubt,
    row_doubts,
)
from pipeline.batch.rig_setting import batch_rig, jaw_faults
from pipeline.batch.unused_files import unused_of_batch, unused_of_fruit
from pipeline.files.plain_file import stands
from pipeline.fruit.category_doubts import of_category, of_poisson_ratio, shipped_categories, size_doubts
from pipeline.fruit.fruit_shape import measured
from pipeline.fruit.input_doubts import of_a_given_pit
from pipeline.fruit.placed_grasp import Checked, findings_of
from pipeline.fruit.pressed_fruit import compression_trace
from pipeline.fruit.recording_owner import Owner, in_two_fruit, owner_findings, refuse_copy
from pipeline.fruit.trace_geometry import stated_in_table
from pipeline.problem import Problem
from pipeline.run.photo_checks import at, doubted, photo_problems, tried
from pipeline.safe_start import elsewhere
from recon.pit.placement import embed_pit, place_pit, require_closed
from recon.recon_failure import ReconFailure, ReconProblem
from recon.surface.mesh_file import read_mesh
from tactile.consistency.finding import Finding
from tactile.correction import corrected
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import Recording, read_recording, recording_digest
from tactile.reference_print import references_said
from tactile.rig.rig_curve import RigCurve

Mesh = tuple[Float[np.ndarray, "_n 3"], Int[np.ndarray, "_m 3"]]
Read = dict[str, list[tuple[FruitRow, Path]]]
"""Usable recordings by their content (tactile.readers.recording), which identifies copies."""


def check(
    root: Path, *, quick: bool = False, report: Callable[[str], None] = lambda _: None
) -> Iterator[Problem]:
    """Everything that would stop the batch or a fruit, and (`doubtful`) everything that would put an E in
    doubt, as far as the files show. The batch comes first, then each fruit; `report` gets its name before.
    `quick`: reads photos without the checks of blur, light, tags of the mat and missing sides, which take
    seconds for each fruit.
    """
    batch, read = survey(root), Read()
    yield from batch.problems
    if batch.listed:
        folder = batch.folder
        for doubt in of_poisson_ratio(batch.settings, batch.prior):
            sentence = f"{doubt.sentence} Every E will be in doubt."
            yield Problem(str(folder.settings), sentence, doubtful=True)
        for name in fruit_folders(folder):
            if name not in batch.row_of:
                sentence = f'is not in fruits.csv; add a row "{name}", or move the folder away.'
                yield Problem(str(folder.fruits / name), sentence)
        yield from unused_of_batch(folder, named_files(folder, batch.settings))
        for name in batch.row_of:
            yield from unused_of_fruit(folder.fruit(name))
    yield from _model_problems(batch, report)
    for number, row in enumerate(batch.rows, 1):
        report(f"{row.fruit_id} ({number} of {len(batch.rows)})")
        yield from _CheckedFruit(batch=batch, row=row, read=read).problems(quick=quick)
    if batch.listed:
        yield from _in_two_fruit(batch, read)


def implausible(batch: Batch, row: FruitRow, *, box_mm: Sequence[float] | None = None) -> str:
    """The sentences on one fruit's numbers, and on the size of its ready mesh, outside the range of the
    category; empty if there are none.

    `box_mm`: the mesh's sides, if known; otherwise this function reads the mesh.
    """
    kind = kind_of(category_of(row, batch.known))
    doubts = list(row_doubts(row, kind, said=batch.column_doubts))
    if box_mm is None:
        mesh, _ = _closed_mesh(row, batch.folder.fruit(row.fruit_id).fruit_ply)
        # grading of the fruit reports a fault of the mesh
        box_mm = None if mesh is None else np.ptp(mesh[0], axis=0).tolist()
    if box_mm is not None and (doubt := mesh_doubt(box_mm, kind)):
        doubts.append(doubt)
    return " ".join(doubts)


def implausible_batch(batch: Batch) -> dict[str, list[str]]:
    """By fruit, the sentences on implausible numbers of the whole batch that concern it: limits of classes,
    and columns in which it has a number.
    """
    classes = list(grading_doubts(batch.settings.grading, kind_of(batch.known)))
    columns = batch.column_doubts.items()
    return {
        row.fruit_id: [*classes, *(said for name, said in columns if getattr(row, name) is not None)]
        for row in batch.rows
        if not row.reference
    }


@dataclass(frozen=True, kw_only=True)
class _CheckedFruit:
    """A fruit of a batch under check. `read` gets its usable recordings."""

    batch: Batch
    row: FruitRow
    read: Read

    @cached_property
    def kind(self) -> PlausibleRange:
        return kind_of(category_of(self.row, self.batch.known))

    @cached_property
    def folder(self) -> FruitFolder:
        return self.batch.folder.fruit(self.row.fruit_id)

    def effects(self) -> tuple[ConfirmedEffect, ...]:
        return effects_on(self.batch.settings.mismatch, self.row.fruit_id)

    def rig(self) -> RigCurve | None:
        return batch_rig(self.batch.folder.root, self.batch.settings)

    def problems(self, *, quick: bool) -> Iterator[Problem]:
        """What stops the grading of the fruit, and what puts its E in doubt; `quick` as in `check`."""
        batch, row, folder = self.batch, self.row, self.folder
        implausible = list(row_doubts(row, self.kind, said=batch.column_doubts))
        for sentence in implausible:
            named = f"{row.fruit_id}: {sentence}"
            yield Problem(str(batch.folder.table), named, fruit_id=row.fruit_id, implausible=True)
        if not folder.root.is_dir():
            yield at(row, folder.root, "does not exist; create it, with photos/ and grasps/ inside.")
            return
        mesh, broken = _closed_mesh(row, folder.fruit_ply)
        yield from broken
        if mesh is not None:
            yield from self._of_ready_mesh(mesh)
            if not implausible and not _size_doubt(mesh, self.kind):
                yield from self._contradicted(mesh)
        elif not broken and folder.without_shape():
            for path in folder.grasp_files():
                yield from tried(row, path, partial(self._of_pressed, path))
            return
        elif not broken and shape_from_photos(folder, row):
            yield from photo_problems(batch, row, folder, quick=quick)
        grasps, raw = folder.grasp_files(), folder.raw_grasp_folders()
        if not grasps and not raw:
            sentence = "needs at least one recording (.h5, .hdf5, .mat) or folder of gel frames; found none."
            yield at(row, folder.grasps, sentence)
        for path in grasps:
            yield from tried(row, path, partial(self._of_recording, path, mesh))
        for path in raw:
            yield from self._of_raw_grasp(path)

    def _of_recording(self, path: Path, mesh: Mesh | None) -> list[Problem]:
        """The findings of grading's checks on the recording; raises TactileFailure if they refuse it."""
        rig = self.rig()
        of_the_gripper = jaw_faults(self.effects(), rig)
        recorded = read_recording(path)
        owner_doubts = self._of_owner(recorded, source=path.name)
        recording = corrected(recorded, of_the_gripper, source=path.name)
        vertices, faces = (None, None) if mesh is None else mesh
        sensor = self.batch.settings.sensor
        checked = Checked(E_range_MPa=self.kind.ranges.E_MPa, rig=rig, sensor=sensor)
        recording_doubts = findings_of(
            recording, vertices, faces, path.name, checked, corrected_for=len(of_the_gripper)
        )
        self._once(path, recording_digest(recorded))
        return self._doubted(
            path, [finding for finding in (*owner_doubts, *recording_doubts) if not finding.remark]
        )

    def _of_pressed(self, path: Path) -> list[Problem]:
        """The same for a recording of a fruit whose diameters are its shape."""
        trace = compression_trace(
            path,
            stated=stated_in_table(given_of(self.row)),
            prior=self.batch.prior,
            body=self.batch.body,
            rig=self.rig(),
            admit=partial(self._of_owner, source=""),
        )
        self._once(path, trace.digest)
        return self._doubted(path, trace.findings)

    def _of_raw_grasp(self, path: Path) -> Iterator[Problem]:
        """Why a raw grasp cannot be used, or to which fruit it may belong."""
        said: list[str] = []

        def read() -> list[Problem]:
            raw = read_raw_grasp(path)
            said.extend(references_said(raw))
            return self._doubted(
                path, self._of_owner(raw.recording, source=path.name, field="fruit_id in grasp.toml")
            )

        yield from tried(self.row, path, read)
        yield from (doubted(self.row, path, sentence) for sentence in said)

    def _of_owner(
        self, recorded: Recording, *, source: str, field: str = "attribute fruit_id"
    ) -> list[Finding]:
        """Findings if the recording names another fruit, as in grading (pipeline.fruit.grasped.owner_of)."""
        category = None if self.row.reference else self.batch.category
        owner = Owner(
            fruit_id=self.row.fruit_id, category=category, batch_fruits=frozenset(self.batch.row_of)
        )
        return owner_findings(recorded.fruit_id, recorded.category, owner, source=source, field=field)

    def _once(self, path: Path, digest: str) -> None:
        """Adds the recording to `read`; raises TactileFailure if another file of the fruit is its copy."""
        same = self.read.setdefault(digest, [])
        refuse_copy(path.name, next((other.name for row, other in same if row == self.row), None))
        same.append((self.row, path))

    def _doubted(self, path: Path, findings: Iterable[Finding]) -> list[Problem]:
        return [doubted(self.row, path, f"{path.name}: {finding.sentence}.") for finding in findings]

    def _of_ready_mesh(self, mesh: Mesh) -> Iterator[Problem]:
        """Problems of a closed mesh as this fruit's, and of the pit inside it."""
        batch, row, folder = self.batch, self.row, self.folder
        broken = []
        if said := _size_doubt(mesh, self.kind):
            broken.append(Problem(str(folder.fruit_ply), said, fruit_id=row.fruit_id, implausible=True))
        pit, wrong = _closed_mesh(row, folder.pit_ply)
        broken += wrong
        if pit is not None and not broken:
            broken += tried(row, folder.pit_ply, partial(_pit_sized, folder.pit_ply, pit, self.kind))
        yield from broken
        if broken or row.reference:
            return
        if pit is None and not batch.settings.pit.none:
            box_mm = np.ptp(mesh[0], axis=0).tolist()
            for doubt in of_category(box_mm, batch.prior, others=shipped_categories()):
                yield doubted(row, folder.fruit_ply, doubt.sentence)
        yield from tried(row, folder.fruit_ply, partial(self._of_pit, mesh, pit))

    def _of_pit(self, fruit: Mesh, pit: Mesh | None) -> list[Problem]:
        """Grading's doubts about the fruit's own pit, if it has one; raises ReconFailure if none fits."""
        placed = pit if pit is not None else _usual_pit(self.batch, fruit)
        if placed is None:
            return []
        embedded = embed_pit(*fruit, pit_found(self.effects()).moved(placed[0]), placed[1])
        path, doubts = self.folder.pit_ply, of_a_given_pit(fruit[0], *embedded.pit, self.batch.prior)
        return [
            at(self.row, path, Outcome.IMPLAUSIBLE_PIT.sentence(doubt.sentence))
            if doubt.refused
            else doubted(self.row, path, doubt.sentence)
            for doubt in (doubts if pit is not None else ())
        ]

    def _contradicted(self, mesh: Mesh) -> Iterator[Problem]:
        """Sizes and mass of fruits.csv, and of the category, that the ready mesh contradicts."""
        prior = None if self.row.reference else self.batch.prior
        on_mat, mesh_record = self.batch.mat is not None, measured(*mesh, source="fruit.ply")
        for said in size_doubts(given_of(self.row), mesh_record, prior, on_mat=on_mat, body=self.kind.body):
            yield Problem(str(self.folder.fruit_ply), said, fruit_id=self.row.fruit_id, remark=True)


def _closed_mesh(row: FruitRow, path: Path) -> tuple[Mesh | None, list[Problem]]:
    """The closed mesh at `path`, and what is wrong with it; None and no problem if there is no file."""
    held: list[Mesh] = []

    def read() -> None:
        mesh = read_mesh(path)
        require_closed(*mesh, what=path.name)
        held.append(mesh)

    problems = list(tried(row, path, read)) if stands(path) else []
    return (held[0] if held else None), problems


def _model_problems(batch: Batch, report: Callable[[str], None]) -> Iterator[Problem]:
    """The fault of the batch's own ONNX model that opening it shows; `survey` reports the others.

    Without photos that give a fruit its shape, grading does not open the model, nor does this function.
    """
    folder, settings, recon = batch.folder, batch.settings, batch.settings.recon
    if recon.geometry_model is None or [*model_faults(folder, settings), *provider_faults(settings)]:
        return
    fruit = ((row, folder.fruit(row.fruit_id)) for row in batch.rows)
    if not any(shape_from_photos(files, row) and files.photo_files() for row, files in fruit):
        return
    report("geometry model")
    with elsewhere():
        from recon.learned.usable_model import require_usable
    try:
        require_usable(folder.root / recon.geometry_model, providers=recon.providers)
    except ReconFailure as failure:
        yield Problem(str(folder.settings), f'"recon.geometry_model": {failure.detail}')


def _in_two_fruit(batch: Batch, read: Read) -> Iterator[Problem]:
    """Recordings that several fruit have, with one problem for each of the fruit."""
    for same in read.values():
        for row, path in same if len(same) > 1 else ():
            others = (other.relative_to(batch.folder.root) for other_row, other in same if other_row != row)
            yield doubted(row, path, in_two_fruit(path.name, map(str, others)))


def _size_doubt(mesh: Mesh, kind: PlausibleRange) -> str:
    return mesh_doubt(np.ptp(mesh[0], axis=0).tolist(), kind)


def _usual_pit(batch: Batch, fruit: Mesh) -> Mesh | None:
    """The category's pit, placed in a fruit without its own; None if the category has none."""
    if batch.settings.pit.none or batch.prior is None or not batch.prior.has_pit:
        return None
    return place_pit(*fruit, batch.prior)


def _pit_sized(path: Path, pit: Mesh, kind: PlausibleRange) -> None:
    longest, (least, most) = float(np.ptp(pit[0], axis=0).max()), kind.body.pit_mm
    if not least <= longest <= most:
        sentence = (
            f"{path.name} is {longest:.3g} mm long; a pit of {kind.a_fruit} has {least:g} to {most:g} mm"
        )
        raise ReconFailure(ReconProblem.BAD_PRIOR, f"{sentence}: is it in mm?")
