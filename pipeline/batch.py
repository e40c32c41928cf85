"""A batch, opened: settings, fruit, mat and pit prior; every fault of the whole found before work begins."""

import difflib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pipeline.config import Settings, read_settings
from pipeline.fruits_table import FruitRow, read_fruits
from pipeline.layout import BatchFolder
from pipeline.problem import BatchRefused, Problem
from recon.failure import ReconFailure
from recon.mat import Mat, parse_mat
from recon.measured_pit import load_pit
from recon.mesh_file import SUFFIXES
from recon.priors import PitPrior, known_categories

T = TypeVar("T")
_NO_POISSON_RATIO = (
    'Poisson\'s ratio of the flesh is not known for the category "{}"; add the key poisson_ratio, '
    "for example poisson_ratio = 0.45."
)


@dataclass(frozen=True, kw_only=True)
class Batch:
    """What grading starts from; `prior` is None only where every fruit brings its own pit
    and the settings hold Poisson's ratio.
    """

    folder: BatchFolder
    settings: Settings
    rows: tuple[FruitRow, ...]
    mat: Mat | None
    prior: PitPrior | None


@dataclass(frozen=True, kw_only=True)
class Survey:
    """As much of a batch as could be read, and every problem of the batch as a whole."""

    folder: BatchFolder
    settings: Settings | None
    rows: tuple[FruitRow, ...] | None
    mat: Mat | None
    prior: PitPrior | None
    problems: tuple[Problem, ...]


def open_batch(root: Path) -> Batch:
    """The batch at `root`; raises BatchRefused with every problem of the batch as a whole."""
    found = survey(root)
    if found.problems or found.settings is None or found.rows is None:
        raise BatchRefused(found.problems)
    return Batch(
        folder=found.folder, settings=found.settings, rows=found.rows, mat=found.mat, prior=found.prior
    )


def survey(root: Path) -> Survey:
    """Reads what can be read of the batch at `root`."""
    folder = BatchFolder(root)
    problems: list[Problem] = []
    rows = mat = prior = None
    settings = _gather(problems, lambda: read_settings(folder.settings))
    if root.is_dir():
        told = _gather(problems, lambda: read_fruits(folder.table))
        if told is not None:
            rows, faults = told
            problems += faults
        mat = _gather(problems, lambda: read_mat(folder.mat)) if folder.mat.is_file() else None
    if rows and not folder.mat.is_file():
        problems += _without_scale(folder, rows)
    if settings is not None:
        missing: list[Problem] = []
        prior = _gather(missing, lambda: read_prior(folder, settings))
        if not _all_bring_pits(folder, rows):
            problems += missing
        elif prior is None and settings.poisson_ratio is None:
            problems.append(Problem(str(folder.settings), _NO_POISSON_RATIO.format(settings.category)))
        problems += _without_model(folder, settings)
        problems += _effects_of_strangers(folder, settings, rows)
    return Survey(folder=folder, settings=settings, rows=rows, mat=mat, prior=prior, problems=tuple(problems))


def read_mat(path: Path) -> Mat:
    """The marker mat described in `path`; raises BatchRefused."""
    try:
        mapping = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise BatchRefused(
            [Problem(str(path), f"is not valid JSON ({error}); make one with `drupe mat`.")]
        ) from None
    try:
        return parse_mat(mapping, source=path.name)
    except ReconFailure as failure:
        raise BatchRefused([Problem(str(path), failure.detail)]) from None


def read_prior(folder: BatchFolder, settings: Settings) -> PitPrior:
    """The pit prior that the settings ask for; raises BatchRefused where there is none."""
    named = settings.pit.prior or settings.category
    try:
        is_file = Path(named).suffix.lower() in (".toml", *SUFFIXES)
        return load_pit(folder.root / named if is_file else named, category=settings.category)
    except ReconFailure as failure:
        near = difflib.get_close_matches(named.lower(), known_categories(), n=1, cutoff=0.75)
        sentence = f'found "{named}"; did you mean "{near[0]}"?' if near else failure.detail
        key = "pit.prior" if settings.pit.prior else "category"
        raise BatchRefused([Problem(str(folder.settings), f'"{key}": {sentence}')]) from None


def _all_bring_pits(folder: BatchFolder, rows: tuple[FruitRow, ...] | None) -> bool:
    return bool(rows) and all(folder.fruit(row.fruit_id).pit_ply.is_file() for row in rows or ())


def _without_scale(folder: BatchFolder, rows: tuple[FruitRow, ...]) -> list[Problem]:
    """Without a mat, at least one photographed fruit must have a height; single gaps cost single fruit."""
    photographed = [row for row in rows if not folder.fruit(row.fruit_id).fruit_ply.is_file()]
    if not photographed or any(_has_height(row) for row in photographed):
        return []
    return [
        Problem(
            str(folder.table),
            "no fruit has a height_mm and the batch has no mat.json, so the photos have no scale; add "
            "the column height_mm (mm), or photograph on a marker mat (`drupe mat`) and add its mat.json.",
        )
    ]


def _has_height(row: FruitRow) -> bool:
    """Or would have one, if it could be read."""
    return row.height_mm is not None or "height_mm" in row.unreadable


def _effects_of_strangers(
    folder: BatchFolder, settings: Settings, rows: tuple[FruitRow, ...] | None
) -> list[Problem]:
    """A confirmed effect of single fruit must name fruit of this batch."""
    known = [row.fruit_id for row in rows or ()]
    problems = []
    for one in settings.mismatch if rows is not None else ():
        for fruit_id in one.fruits or ():
            if fruit_id not in known:
                near = difflib.get_close_matches(fruit_id, known, n=1)
                hint = f'did you mean "{near[0]}"?' if near else "take it out."
                sentence = f'"mismatch": {one.effect} is of fruit "{fruit_id}", not in fruits.csv; {hint}'
                problems.append(Problem(str(folder.settings), sentence))
    return problems


def _without_model(folder: BatchFolder, settings: Settings) -> list[Problem]:
    """A geometry model that is asked for must be there."""
    asked = settings.recon.geometry_model
    if asked is None or (folder.root / asked).is_file():
        return []
    return [
        Problem(
            str(folder.settings),
            f'"recon.geometry_model": found "{asked}", but {folder.root / asked} is no file; '
            "give the path of an ONNX file relative to the batch, or take the line out.",
        )
    ]


def _gather(problems: list[Problem], read: Callable[[], T]) -> T | None:
    try:
        return read()
    except BatchRefused as refused:
        problems.extend(refused.problems)
        return None
