"""Opens a batch: settings, fruit, mat and pit prior; finds every fault of the whole before work begins."""

import unicodedata
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pydantic import ValidationError

from pipeline.batch.batch_place import batch_around
from pipeline.batch.fruits_table import SAFE_ID, FruitRow, read_fruits
from pipeline.batch.layout import BatchFolder, FruitFolder, is_of_the_system
from pipeline.batch.named_priors import CATEGORY, as_named, read_priors, reference_prior, without_pit
from pipeline.batch.plausible_numbers import grading_doubts, kind_of, table_doubts
from pipeline.batch.rig_setting import batch_rig
from pipeline.batch.settings import Grading, Recon, Settings
from pipeline.batch.settings_file import MOST_BYTES, read_settings
from pipeline.files.plain_file import (
    NO_LFS_FILE,
    NotReadable,
    json_of,
    not_plain,
    read_text,
    stands,
    toml_of,
)
from pipeline.problem import BatchRefused, Problem, gathered, nearest, refused
from pipeline.safe_start import elsewhere
from recon.cameras.printed_mat import Mat, parse_mat
from recon.learned.onnx_file import require_onnx
from recon.pit.priors import STONE_FRUIT, PitBody, PitPrior, load_prior
from recon.recon_failure import ReconFailure
from tactile.tactile_failure import TactileFailure


@dataclass(frozen=True, kw_only=True)
class Batch:
    """A batch as far as its files are readable, and every problem of the batch as a whole (`problems`).

    `rows`: from fruits.csv, or from the fruit folders if the table is not readable (not `listed`). `known`:
    values of the category. `prior`: None if no fruit needs its pit and the settings hold Poisson's ratio, or
    if a problem states why it is missing. `without_scale`: no photographed fruit has a scale, and a problem
    reports this.
    """

    folder: BatchFolder
    settings: Settings
    rows: tuple[FruitRow, ...]
    listed: bool
    mat: Mat | None
    known: PitPrior | None
    prior: PitPrior | None
    without_scale: bool
    problems: tuple[Problem, ...]

    @property
    def category(self) -> str:
        """The category's name, even if the settings give a file."""
        return self.settings.category if self.known is None else self.known.category

    @property
    def body(self) -> PitBody:
        """Usual shape, density and pit size of a whole fruit of the category."""
        return STONE_FRUIT if self.known is None else self.known.body

    @cached_property
    def row_of(self) -> dict[str, FruitRow]:
        """The rows by fruit_id."""
        return {row.fruit_id: row for row in self.rows}

    @cached_property
    def column_doubts(self) -> dict[str, str]:
        """By column: a sentence if all its numbers are outside the category's range."""
        return table_doubts(self.rows, kind_of(self.known))


RowChoice = Callable[[BatchFolder, tuple[FruitRow, ...]], tuple[FruitRow, ...]]
"""Selects the rows that a command reads from those of fruits.csv."""


def open_batch(root: Path, *, force: bool = False, choose: RowChoice | None = None) -> Batch:
    """The batch at `root`; raises BatchRefused with every problem of the batch as a whole.

    With `force` it accepts numbers that are merely implausible; `choose` as in `survey`.
    """
    batch = survey(root, choose=choose)
    if stops := [problem for problem in batch.problems if not (force and problem.implausible)]:
        raise BatchRefused(stops)
    return batch


def survey(root: Path, *, choose: RowChoice | None = None) -> Batch:
    """Reads the batch at `root` as far as it is readable.

    With `choose` the table may be empty or missing. `choose` returns the fruit: fewer than the table's rows,
    or more (`unlisted_fruit`).
    """
    folder = BatchFolder(root)
    problems: list[Problem] = []
    read = gathered(problems, lambda: read_settings(folder.settings))
    salvaged = _salvaged(folder) if read is None else read
    settings = Settings(category="unknown") if salvaged is None else salvaged
    rows, mat, unscaled = tuple[FruitRow, ...](), None, list[Problem]()
    listed = root.is_dir() and batch_around(root) is None
    if listed:
        if choose is None or stands(folder.table):
            units, empty = None if salvaged is None else settings.columns, choose is not None
            table = gathered(problems, lambda: read_fruits(folder.table, units=units, may_be_empty=empty))
            listed = table is not None
            rows, faults = table or ((), [])
            problems += faults
        if choose is not None and listed:
            rows = choose(folder, rows)
        if stands(folder.mat):
            mat = gathered(problems, lambda: read_mat(folder.mat))
        elif rows:
            unscaled = _without_scale(folder, rows)
            problems += unscaled
    known, prior = None, None
    if read is None:
        with suppress(ReconFailure):
            known = load_prior(as_named(folder.root, settings.category))
    else:
        known, prior, wrong = read_priors(folder, settings, rows if listed else None)
        problems += wrong
        problems += _references(folder, settings, rows)
        problems += [
            Problem(str(folder.settings), sentence)
            for sentence in (
                *_without_rig(folder, settings),
                *model_faults(folder, settings),
                *provider_faults(settings),
                *(_effects_of_strangers(settings, rows) if listed else ()),
                *_effects_without_pit(folder, settings, rows),
            )
        ]
    problems += _implausible(folder, settings.grading, rows, known)
    if not listed:
        rows = tuple(FruitRow(fruit_id=name, unreadable=("height_mm",)) for name in fruit_folders(folder))
    return Batch(
        folder=folder,
        settings=settings,
        rows=rows,
        listed=listed,
        mat=mat,
        known=known,
        prior=prior,
        without_scale=bool(unscaled),
        problems=tuple(problems),
    )


def fruit_folders(folder: BatchFolder) -> list[str]:
    """The names in fruits/ that can be fruit_ids, composed (NFC) and sorted."""
    places = folder.fruits.iterdir() if folder.fruits.is_dir() else ()
    names = (path.name for path in places if path.is_dir() and not is_of_the_system(path.name))
    return sorted(filter(SAFE_ID.fullmatch, {unicodedata.normalize("NFC", name) for name in names}))


def unlisted_fruit(folder: BatchFolder, rows: Sequence[FruitRow]) -> list[FruitRow]:
    """Rows for the folders in fruits/ that the table does not name, sorted by name."""
    known = {row.fruit_id for row in rows}
    return [FruitRow(fruit_id=name) for name in fruit_folders(folder) if name not in known]


def _implausible(
    folder: BatchFolder, grading: Grading, rows: tuple[FruitRow, ...], known: PitPrior | None
) -> list[Problem]:
    """Numbers of batch.toml and of whole columns of fruits.csv outside the category's range."""
    kind = kind_of(known)
    said = [(folder.settings, sentence) for sentence in grading_doubts(grading, kind)]
    said += [(folder.table, sentence) for sentence in table_doubts(rows, kind).values()]
    hint = "If the value is right, run `drupe grade --force`."
    return [Problem(str(path), f"{sentence} {hint}", implausible=True) for path, sentence in said]


def _salvaged(folder: BatchFolder) -> Settings | None:
    """Category, classes and the user's columns of faulty settings, so that one run also finds the faults of
    other files. None if the file is no TOML.
    """
    settings = Settings(category="unknown")
    try:
        table = toml_of(read_text(folder.settings, most_bytes=MOST_BYTES))
    except NotReadable:
        return None
    with suppress(ValidationError):
        settings = Settings.model_validate({"category": table.get("category")})
    with suppress(ValidationError):
        grading = Grading.model_validate(table.get("grading", {}))
        settings = settings.model_copy(update={"grading": grading})
    if isinstance(declared := table.get("columns"), dict):
        units = {name: str(unit) for name, unit in declared.items()}
        settings = settings.model_copy(update={"columns": units})
    return settings


def read_mat(path: Path) -> Mat:
    """The marker mat described in `path`; raises BatchRefused."""
    try:
        mapping = json_of(read_text(path, most_bytes=MOST_BYTES))
    except NotReadable as error:
        pointer = str(error) == NO_LFS_FILE
        hint = "" if not_plain(path) or pointer else "; make one with `drupe mat`"
        raise refused(path, f"{error}{hint}.") from None
    try:
        return parse_mat(mapping, source=path.name)
    except ReconFailure as failure:
        raise refused(path, failure.detail) from None


def _effects_without_pit(
    folder: BatchFolder, settings: Settings, rows: tuple[FruitRow, ...]
) -> Iterator[str]:
    bare = without_pit(folder, rows) if settings.pit.none else []
    for effect in settings.mismatch:
        for fruit_id in bare if effect.spec.of_the_pit else ():
            if effect.fruits is None or fruit_id in effect.fruits:
                yield (
                    f'"mismatch": {effect.effect} is an effect of the pit, but {fruit_id} has no pit '
                    '(pit.prior is "none"); name other fruit, or remove the entry.'
                )


def _references(folder: BatchFolder, settings: Settings, rows: tuple[FruitRow, ...]) -> Iterator[Problem]:
    """Problems of reference bodies: no body to correct by, no Poisson's ratio, or a pit."""
    bodies = [row for row in rows if row.reference]
    if settings.reference.correct and rows and not bodies:
        sentence = (
            '"reference.correct" is true, but fruits.csv lists no reference body; write true into '
            "the column reference of its row, or remove the line."
        )
        yield Problem(str(folder.settings), sentence)
    for row in bodies:
        if reference_ratio(row, settings) is None:
            sentence = (
                f'reference_poisson_ratio of "{row.fruit_id}" is empty; expected the Poisson\'s ratio '
                "of the reference body, for example 0.48 for silicone."
            )
            yield Problem(str(folder.table), sentence)
        for effect in settings.mismatch:
            if effect.spec.of_the_pit and row.fruit_id in (effect.fruits or ()):
                sentence = (
                    f'"mismatch": {effect.effect} is an effect of the pit, but the reference body '
                    f"{row.fruit_id} has none; remove it from the entry's fruits."
                )
                yield Problem(str(folder.settings), sentence)
        pit = folder.fruit(row.fruit_id).pit_ply
        if stands(pit):
            sentence = (
                "gives a pit for a reference body, which must be solid; remove the file, or use another body."
            )
            yield Problem(str(pit), sentence, fruit_id=row.fruit_id)


def reference_ratio(row: FruitRow, settings: Settings) -> float | None:
    """Poisson's ratio of a reference body; None if unknown. Source, by priority: its row, the category of
    phantoms, the settings of a batch of phantoms.
    """
    said = reference_prior(row.reference_poisson_ratio).poisson_ratio
    return settings.poisson_ratio if said is None and settings.category == CATEGORY else said


def _without_scale(folder: BatchFolder, rows: tuple[FruitRow, ...]) -> list[Problem]:
    """The problem that no photographed fruit has a height; single gaps stop only single fruit."""
    photographed = [row for row in rows if shape_from_photos(folder.fruit(row.fruit_id), row)]
    if not photographed or any(row.has_height for row in photographed):
        return []
    sentence = (
        "no fruit has a height_mm and the batch has no mat.json, so the photos have no scale. Add the column "
        "height_mm (mm), or photograph on a marker mat (`drupe mat`) and add its mat.json."
    )
    return [Problem(str(folder.table), sentence)]


def shape_from_photos(folder: FruitFolder, row: FruitRow) -> bool:
    """Whether photos must give the fruit's shape: it has no mesh, and diameters do not replace one."""
    if folder.fruit_ply.is_file() or folder.without_shape():
        return False
    empty = not (folder.photos.exists() or folder.grasp_files() or folder.raw_grasp_folders())
    return not (empty and any(row.diameters))


def _effects_of_strangers(settings: Settings, rows: tuple[FruitRow, ...]) -> Iterator[str]:
    known = [row.fruit_id for row in rows]
    for effect in settings.mismatch:
        for fruit_id in effect.fruits or ():
            if fruit_id not in known:
                yield (
                    f'"mismatch": {effect.effect} names fruit "{fruit_id}", which is not in fruits.csv; '
                    f"{nearest(fruit_id, known, 'remove it.')}"
                )


def _without_rig(folder: BatchFolder, settings: Settings) -> Iterator[str]:
    try:
        batch_rig(folder.root, settings)
    except TactileFailure as failure:
        yield f'"rig": {failure.detail}'


def model_faults(folder: BatchFolder, settings: Settings) -> Iterator[str]:
    """The fault of the batch's own ONNX model that shows without opening it, if it has one."""
    asked = settings.recon.geometry_model
    if asked is None:
        return
    if not (folder.root / asked).is_file():
        yield (
            f'"recon.geometry_model": found "{asked}", but {folder.root / asked} is not a '
            "file; give the path of an ONNX file relative to the batch, or remove the line."
        )
        return
    try:
        require_onnx(folder.root / asked)
    except ReconFailure as failure:
        yield f'"recon.geometry_model": {failure.detail}'


def provider_faults(settings: Settings) -> Iterator[str]:
    """The fault of the batch's own list of ONNX Runtime providers, if it has one."""
    if settings.recon.providers == Recon().providers:
        return
    with elsewhere():
        from recon.learned.onnx_session import providers_fault
    if fault := providers_fault(settings.recon.providers):
        yield f'"recon.providers": {fault}'
