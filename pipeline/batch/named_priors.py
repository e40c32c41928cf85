"""Category and pit prior that a batch's settings select, and the files that the settings name."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.layout import BatchFolder
from pipeline.batch.settings import NO_PIT, Settings
from pipeline.files.plain_file import listed
from pipeline.problem import BatchRefused, Problem, gathered, nearest, refused
from recon.pit.placement import load_pit
from recon.pit.priors import PitPrior, known_categories, load_prior
from recon.recon_failure import ReconFailure
from recon.surface.mesh_file import SUFFIXES

CATEGORY = "phantom"
"""The category of a reference body, whatever the batch's category is."""
NAME = "reference body"
"""Its name in sentences."""


@cache
def reference_prior(poisson_ratio: float | None = None) -> PitPrior:
    """The prior of a reference body: the category phantom, with the given Poisson's ratio if there is one."""
    known = load_prior(CATEGORY)
    ratio = known.poisson_ratio if poisson_ratio is None else poisson_ratio
    return replace(known, category=NAME, poisson_ratio=ratio)


def category_of(row: FruitRow, category: PitPrior | None) -> PitPrior | None:
    """The category of one row: a reference body's, else the batch's."""
    return reference_prior(row.reference_poisson_ratio) if row.reference else category


_NO_POISSON_RATIO = (
    'Poisson\'s ratio of the flesh is unknown for the category "{}"; add poisson_ratio to '
    "batch.toml, for example poisson_ratio = 0.45."
)
_NO_PITS = (
    'the category "{}" has no default pit, and {} no pit.ply. Add pit.ply beside fruit.ply, or '
    'set [pit] prior to a file such as "core.toml" (or STL, PLY, OBJ in mm). For fruit without a '
    'pit, set prior = "none".'
)


def read_category(folder: BatchFolder, settings: Settings) -> PitPrior:
    """The settings' category, shipped or from the batch's own file; raises BatchRefused if there is none."""
    try:
        return load_prior(as_named(folder.root, settings.category))
    except ReconFailure as failure:
        raise _refused(folder, "category", settings.category, failure, known_categories()) from None


def read_prior(folder: BatchFolder, settings: Settings) -> PitPrior:
    """The pit prior that the settings select; raises BatchRefused if there is none."""
    named = settings.pit.prior
    if named is None or settings.pit.none:
        return read_category(folder, settings)
    try:
        return load_pit(as_named(folder.root, named), category=as_named(folder.root, settings.category))
    except ReconFailure as failure:
        raise _refused(folder, "pit.prior", named, failure, (*known_categories(), NO_PIT)) from None


def own_files(folder: BatchFolder, settings: Settings) -> tuple[Path, ...]:
    """The files for category, pit and rig that the settings name, if they exist inside the batch."""
    named = [
        folder.root / name
        for name in (settings.category, settings.pit.prior, settings.rig)
        if name and _is_file(name)
    ]
    return tuple(path for path in dict.fromkeys(named) if path.is_file() and path.is_relative_to(folder.root))


def named_files(folder: BatchFolder, settings: Settings) -> tuple[Path, ...]:
    """The files of `own_files`, and the path of the geometry model, whether or not it exists."""
    model = settings.recon.geometry_model
    return (*own_files(folder, settings), *([folder.root / model] if model else []))


def _is_file(named: str) -> bool:
    return Path(named).suffix.lower() in (".toml", *SUFFIXES)


def as_named(root: Path, named: str) -> str:
    """The path of a named file, which is relative to `root`; the name of a category as it is."""
    return str(root / named) if _is_file(named) else named


def _refused(
    folder: BatchFolder, key: str, named: str, failure: ReconFailure, known: Sequence[str]
) -> BatchRefused:
    near = "" if _is_file(named) else nearest(named.lower(), known, "", cutoff=0.75)
    sentence = f'found "{named}"; {near}' if near else failure.detail
    return refused(folder.settings, f'"{key}": {sentence}')


def read_priors(
    folder: BatchFolder, settings: Settings, rows: tuple[FruitRow, ...] | None
) -> tuple[PitPrior | None, PitPrior | None, list[Problem]]:
    """The category, the selected pit prior, and what is wrong with either or missing in both.

    An unknown category is accepted if no fruit needs its pit; a file that cannot be used is not.
    """
    unknown: list[Problem] = []
    missing: list[Problem] = []
    category = gathered(unknown, lambda: read_category(folder, settings))
    prior = gathered(missing, lambda: read_prior(folder, settings))
    bare = without_pit(folder, rows)
    problems = unknown if _is_file(settings.category) else []
    if prior is None and (bare or not rows) and not settings.pit.none:
        problems = list(dict.fromkeys([*problems, *missing]))
    elif settings.poisson_ratio is None and not problems and not _know_the_ratio(prior, category):
        name = settings.category if category is None else category.category
        problems.append(Problem(str(folder.settings), _NO_POISSON_RATIO.format(name)))
    if prior is not None and not prior.has_pit and bare and not settings.pit.none:
        lack = f"{listed(bare, 6)} {'has' if len(bare) == 1 else 'have'}"
        problems.append(Problem(str(folder.settings), _NO_PITS.format(prior.category, lack)))
    return category, prior, problems


def _know_the_ratio(prior: PitPrior | None, category: PitPrior | None) -> bool:
    """Whether the prior has a Poisson's ratio, and the category has one or is unknown."""
    left = category is not None and category.poisson_ratio is None
    return prior is not None and prior.poisson_ratio is not None and not left


def without_pit(folder: BatchFolder, rows: tuple[FruitRow, ...] | None) -> list[str]:
    """Names of fruit without a pit mesh that need one. Reference bodies have no pit; a fruit without its own
    mesh needs only the size of a pit.
    """
    fruits = [folder.fruit(row.fruit_id) for row in rows or () if not row.reference]
    return [fruit.root.name for fruit in fruits if not fruit.pit_ply.is_file() and not fruit.without_shape()]
