"""The input of `drupe explain`: a mismatch case, or one fruit of a batch, as the task of one fruit."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from fem.elements.assembly import LARGEST_POISSON_RATIO
from fem.indentation.compressed_ellipsoid import LARGEST_PIT
from pipeline.batch.fruits_table import Given
from pipeline.batch.layout import BatchFolder, CaseFolder, FruitResults, Results
from pipeline.batch.named_priors import as_named
from pipeline.batch.opening import Batch, open_batch
from pipeline.batch.settings import Name, PitSettings, Relative, Settings, Shift, Strict
from pipeline.batch.settings_file import read_toml
from pipeline.batch.task import FruitTask, fruit_task
from pipeline.files.plain_file import composed, listed
from pipeline.fruit.trace_geometry import KEYS, Stated, stated_in_table
from pipeline.problem import BatchRefused, Problem, known_names, nearest, refused
from pipeline.run.checking import implausible
from recon.pit.priors import LEAST_POISSON_RATIO, STONE_FRUIT, PitPrior, known_categories, load_prior
from recon.recon_failure import ReconFailure
from tactile.readers.specimen import PressedSpecimen

ASSUMED_POISSON_RATIO_SD = 0.015
"""Spread of Poisson's ratio if a case states the ratio alone: it is assumed, not measured."""
Length = Annotated[float, Field(ge=0.1, le=500)]
"""mm, of a specimen between plates."""


class CaseSettings(Strict):
    """case.toml: assumptions about the fruit. Keys beyond these are ignored, with a note."""

    model_config = ConfigDict(extra="allow", frozen=True, populate_by_name=True, allow_inf_nan=False)

    category: Name
    poisson_ratio: Annotated[float, Field(ge=LEAST_POISSON_RATIO, le=LARGEST_POISSON_RATIO)] | None = None
    poisson_ratio_sd: Annotated[float, Field(ge=0, le=0.2)] = ASSUMED_POISSON_RATIO_SD
    offset_sd_mm: Shift | None = None
    size_sd: Relative | None = None
    mesh_sd_mm: Annotated[float, Field(ge=1e-3, le=10)] | None = None
    thickness_mm: Annotated[float, Field(ge=0.1, le=200)] | None = None
    rig_N_per_mm: Annotated[float, Field(ge=0.01, le=1e6)] | None = None
    drift_N_per_min: Annotated[float, Field(gt=0, le=1e3)] | None = None
    specimen: Literal["cylinder", "fruit"] | None = None
    height_mm: Length | None = None
    diameter_mm: Length | None = None
    ends: Literal["bonded", "lubricated"] | None = None
    diameters_mm: tuple[Length, Length, Length] | None = None
    axis: Literal["a", "b", "c"] | None = None
    pit_share: Annotated[float, Field(ge=0, le=LARGEST_PIT)] | None = None

    @property
    def of_specimen(self) -> PressedSpecimen:
        """The specimen under a bare indenter, as far as case.toml states it."""
        return PressedSpecimen(**{name: getattr(self, key) for name, key in KEYS.items()})


@dataclass(frozen=True, kw_only=True)
class Case:
    """One fruit to explain. `batch`: the batch it belongs to, None for a case of its own."""

    name: str
    task: FruitTask
    batch: Batch | None
    stated: Stated
    mesh_sd_mm: float | None = None
    rig_N_per_mm: float | None = None
    drift_N_per_min: float | None = None
    notes: tuple[str, ...] = ()

    def input_files(self) -> tuple[Path, ...]:
        """Every file of the fruit that the answer depends on, its settings first."""
        folder = self.task.folder
        settings = (folder.settings,) if isinstance(folder, CaseFolder) else ()
        return settings + folder.input_files()


def open_case(path: Path, *, fruit_id: str | None, work: Path, out: Path | None) -> Case:
    """The case at `path`, or the fruit of the batch at `path` (or whose folder `path` is).

    A case of its own keeps its stages in `work`; a batch's fruit keeps them in the batch's results (`out`, or
    the default). Raises BatchRefused with every problem found.
    """
    if not path.is_dir():
        is_file = f"is a file; give the folder of a case: {_HOLDS}."
        raise refused(path, is_file if path.exists() else "does not exist; give the folder of a case.")
    fruit_id = None if fruit_id is None else composed(fruit_id)
    if BatchFolder(path).settings.is_file():
        if fruit_id is None:
            raise refused(path, _which_fruit(path))
        return _of_batch(path, fruit_id, out)
    if CaseFolder(path).settings.is_file():
        if fruit_id is not None:
            raise refused(path, "is a single case, but --fruit applies to batches; remove --fruit.")
        return _of_its_own(CaseFolder(path), work)
    place = path.resolve()
    if place.parent.name.lower() != "fruits":
        raise refused(path, f"has neither case.toml nor batch.toml; a case holds {_HOLDS}.")
    root = place.parents[1]
    if not BatchFolder(root).settings.is_file():
        sentence = f"lies in fruits/, but {root} has no batch.toml; add batch.toml with the batch's category."
        raise refused(path, sentence)
    if fruit_id not in (None, name := composed(place.name)):
        raise refused(path, f'The path is fruit "{name}" but --fruit says "{fruit_id}"; remove one.')
    return _of_batch(root, name, out)


_HOLDS = (
    'recordings (*.h5), a case.toml with at least the line category = "nectarine", and fruit.ply '
    "(a load cell's curves need none)"
)
_NO_CASE = f"case.toml: does not exist; a case holds {_HOLDS}."


def _which_fruit(root: Path) -> str:
    folder = BatchFolder(root).fruits
    known = sorted(p.name for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []
    return f"is a batch; choose a fruit with --fruit ({listed(known, 6) or 'it has none yet'})."


def _of_its_own(folder: CaseFolder, work: Path) -> Case:
    said = read_toml(folder.settings, CaseSettings, missing=_NO_CASE)
    notes = _left_aside(folder.settings, said)
    prior = _prior(folder, said)
    settings = Settings(
        category=said.category,
        poisson_ratio=said.poisson_ratio,
        poisson_ratio_sd=said.poisson_ratio_sd if said.poisson_ratio is not None else None,
        pit=PitSettings(offset_sd_mm=said.offset_sd_mm, size_sd=said.size_sd),
    )
    name = folder.root.resolve().name
    task = FruitTask(
        fruit_id=name,
        folder=folder,
        batch_root=folder.root,
        results=FruitResults(work),
        settings=settings,
        mat=None,
        category=said.category if prior is None else prior.category,
        body=STONE_FRUIT if prior is None else prior.body,
        prior=prior,
        given=Given(),
        key="",
    )
    return Case(
        name=name,
        task=task,
        batch=None,
        mesh_sd_mm=said.mesh_sd_mm,
        stated=Stated(specimen=said.of_specimen, where="case.toml", name_of=KEYS),
        rig_N_per_mm=said.rig_N_per_mm,
        drift_N_per_min=said.drift_N_per_min,
        notes=notes,
    )


def _left_aside(path: Path, said: CaseSettings) -> tuple[str, ...]:
    """A note for each unknown key; raises BatchRefused for a misspelt known one."""
    notes, problems = [], []
    for key in said.model_extra or {}:
        if hint := nearest(key, CaseSettings.model_fields, "", cutoff=0.75):
            problems.append(Problem(str(path), f'unknown key "{key}"; {hint}'))
        else:
            notes.append(f'case.toml: drupe does not know the key "{key}" and ignored it.')
    if problems:
        raise BatchRefused(problems)
    return tuple(notes)


def _prior(folder: CaseFolder, said: CaseSettings) -> PitPrior | None:
    """The category's prior: required if the case lacks a pit or Poisson's ratio, otherwise optional."""
    prior, why = None, ""
    try:
        prior = load_prior(as_named(folder.root, said.category))
    except ReconFailure as failure:
        if said.category.endswith(".toml"):
            raise refused(folder.settings, f'"category": {failure.detail}') from None
        known = known_categories()
        hint = nearest(said.category.lower(), known, f"known are {', '.join(known)}.", cutoff=0.75)
        why = f", or name a known category: {hint}"
    indented = bool(said.of_specimen.stated) or not folder.fruit_ply.is_file()
    pit = indented or folder.pit_ply.is_file() or (prior is not None and prior.has_pit)
    ratio = said.poisson_ratio is not None or (prior is not None and prior.poisson_ratio is not None)
    missing = [what for what, there in (("pit.ply", pit), ("the key poisson_ratio", ratio)) if not there]
    if missing:
        lacks = f'there is no prior for "{said.category}"' if prior is None else _LEFT.format(prior.category)
        sentence = f'"category": {lacks}; add {" and ".join(missing)}{why or "."}'
        raise refused(folder.settings, sentence)
    return prior


_LEFT = 'the category "{}" has no default'


def _of_batch(root: Path, fruit_id: str, out: Path | None) -> Case:
    """A fruit of a batch as a case, without the effects that its settings confirm; raises BatchRefused."""
    batch = open_batch(root, force=True)
    known = [row.fruit_id for row in batch.rows]
    if fruit_id not in known:
        hint = known_names(fruit_id, known, "fruit", "fruit")
        raise refused(batch.folder.table, f'has no fruit "{fruit_id}"; {hint}')
    if said := implausible(batch, batch.row_of[fruit_id]):
        raise BatchRefused([Problem(str(batch.folder.table), f"{fruit_id}: {said}", fruit_id, True)])
    notes: tuple[str, ...] = ()
    if held := batch.settings.mismatch:
        notes = (_SETTINGS_LEFT_ASIDE.format(", ".join(dict.fromkeys(effect.effect for effect in held))),)
    task = fruit_task(batch, fruit_id, Results(out or batch.folder.default_results))
    task = replace(task, settings=task.settings.model_copy(update={"mismatch": ()}))
    return Case(name=fruit_id, task=task, batch=batch, stated=stated_in_table(task.given), notes=notes)


_SETTINGS_LEFT_ASIDE = (
    "The batch's settings already contain effects ({}); this answer ignores them and uses the "
    "recordings as recorded."
)
