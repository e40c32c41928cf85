"""A batch, opened: settings, fruit, mat and pit prior, every fault of the whole found before work begins."""

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
from recon.priors import PitPrior, load_prior

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Batch:
    """What grading and checking start from; `prior` is None only where every fruit brings its own pit."""

    folder: BatchFolder
    settings: Settings
    rows: tuple[FruitRow, ...]
    mat: Mat | None
    prior: PitPrior | None


def open_batch(root: Path) -> Batch:
    """The batch at `root`; raises BatchRefused with every problem of the batch as a whole."""
    folder = BatchFolder(root)
    problems: list[Problem] = []
    settings = _gather(problems, lambda: read_settings(folder.settings))
    if settings is None and not folder.settings.is_file():
        raise BatchRefused(problems)
    rows = _gather(problems, lambda: read_fruits(folder.table))
    mat = _gather(problems, lambda: read_mat(folder.mat)) if folder.mat.is_file() else None
    if rows is not None and not folder.mat.is_file():
        problems += _without_scale(folder, rows)
    prior = None
    if settings is not None and not _all_bring_pits(folder, rows):
        prior = _gather(problems, lambda: read_prior(folder, settings))
    if settings is not None and settings.recon.geometry_model is not None:
        model = root / settings.recon.geometry_model
        if not model.is_file():
            problems.append(
                Problem(
                    str(folder.settings),
                    f'"recon.geometry_model": found "{settings.recon.geometry_model}", but {model} is no '
                    "file; give the path of an ONNX file relative to the batch, or take the line out.",
                )
            )
    if problems or settings is None or rows is None:
        raise BatchRefused(problems)
    return Batch(folder=folder, settings=settings, rows=rows, mat=mat, prior=prior)


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
        return load_prior(folder.root / named if named.endswith(".toml") else named)
    except ReconFailure as failure:
        raise BatchRefused([Problem(str(folder.settings), failure.detail)]) from None


def _all_bring_pits(folder: BatchFolder, rows: tuple[FruitRow, ...] | None) -> bool:
    return rows is not None and all(folder.fruit(row.fruit_id).pit_ply.is_file() for row in rows)


def _without_scale(folder: BatchFolder, rows: tuple[FruitRow, ...]) -> list[Problem]:
    """Without a mat, at least one photographed fruit must have a height; single gaps cost single fruit."""
    photographed = [row for row in rows if not folder.fruit(row.fruit_id).fruit_ply.is_file()]
    if not photographed or any(row.height_mm is not None for row in photographed):
        return []
    return [
        Problem(
            str(folder.table),
            "no fruit has a height_mm and the batch has no mat.json, so the photos have no scale; add "
            " the column height_mm (mm), or photograph on a marker mat (`drupe mat`) and add its mat.json.",
        )
    ]


def _gather(problems: list[Problem], read: Callable[[], T]) -> T | None:
    try:
        return read()
    except BatchRefused as refused:
        problems.extend(refused.problems)
        return None
