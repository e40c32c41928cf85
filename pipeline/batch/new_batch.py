"""`drupe new`: creates a batch from folders of photos and recordings, and names what is still missing."""

import csv
import io
import re
import shutil
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from itertools import chain
from pathlib import Path

from pipeline.batch.fruits_table import SAFE_ID
from pipeline.batch.layout import BatchFolder, CaseFolder, FruitFolder, in_order
from pipeline.batch.named_priors import own_files
from pipeline.batch.scratch import moved_in, scratch
from pipeline.batch.settings import Settings
from pipeline.batch.settings_file import read_settings
from pipeline.files.plain_file import listed, not_plain
from pipeline.files.toml_text import as_toml, toml_value
from pipeline.files.whole_file import NotWritten
from pipeline.problem import BatchRefused, Problem
from recon.cameras.photos import photo_paths
from recon.cameras.unused_photos import unused_photos
from recon.learned.onnx_file import model_files
from recon.pit.priors import known_categories

TEMPLATE = Path(__file__).with_name("batch_template.toml")
"""Every key of batch.toml, commented out, with its meaning, unit and default."""
COLUMNS = ("fruit_id", "height_mm", "mass_g", "shore_oo", "penetrometer_N", "diameter_mm", "notes")
"""Columns of the new table: those that staff fill in for fruit with photos."""
DEFAULT = "nectarine"
"""The category if none is given."""
FEW = 12
"""Number of photos below which drupe asks for more: half of what the guide recommends."""
SHOWN = 5
"""Most ids in one sentence."""
PARTS = frozenset({"photos", "photos-flipped", "grasps"})
"""Names of subfolders in a fruit's folder."""
STATED = ("lot", "harvest_date", "measured_on")
"""Settings of the day that the command's options state."""
OF_THE_DAY = frozenset({*STATED, "mismatch", "notes", "pulp_temperature_C", "temperature"})
"""Settings of the earlier day, which are not copied. Confirmed effects belong to its fruit, or to its sensors
on that day. [temperature] needs the new day's temperature; `left_out` names it."""


@dataclass(frozen=True, kw_only=True)
class FruitSource:
    """The files to copy for one fruit: its photos, ready mesh and recordings."""

    fruit_id: str
    photos: tuple[Path, ...]
    mesh: tuple[Path, ...]
    recordings: tuple[Path, ...]
    unused: tuple[str, ...] = ()
    """Sentences on pictures that are not read as photos."""


@dataclass(frozen=True, kw_only=True)
class NewBatch:
    """The new batch; `missing`: a sentence for each thing that staff must still do."""

    root: Path
    fruits: tuple[FruitSource, ...]
    missing: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class EarlierBatch:
    """The settings of the batch in `root`, for reuse on another day."""

    root: Path
    settings: Settings

    def written(self, named: Mapping[str, str | date]) -> str:
        """The text of batch.toml, with `named` (category, lot, dates) in place of the earlier day's."""
        kept = self.settings.model_dump(mode="json", exclude_unset=True, exclude=set(OF_THE_DAY))
        head = f"# Settings of {self.root.resolve().name}, by drupe new --like. All keys: docs/formats.md\n\n"
        return head + as_toml({**kept, **named})

    def _named_files(self) -> Iterator[Path]:
        """The mat, and the files inside the batch that the settings name, if they exist."""
        folder = BatchFolder(self.root)
        files = [folder.mat, *own_files(folder, self.settings)]
        if (model := self.settings.recon.geometry_model) is not None:
            files += model_files(self.root / model)
        return (
            path
            for path in files
            if path.is_file() and path.is_relative_to(self.root) and ".." not in path.parts
        )

    def _leaves(self, path: Path) -> bool:
        """Whether links lead from the path out of the batch."""
        return not path.resolve().is_relative_to(self.root.resolve())

    def copy_files(self, batch: Path) -> None:
        """Copies those files, except links that lead out of the batch. Raises OSError."""
        for path in self._named_files():
            if not self._leaves(path):
                target = batch / path.relative_to(self.root)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, target)

    def left_out(self, batch: Path, stated: Mapping[str, str | date]) -> Iterator[str]:
        """Sentences on settings and files that staff must correct in the new batch."""
        settings = self.settings
        lacking = [name for name in STATED if getattr(settings, name) is not None and name not in stated]
        if lacking:
            yield f"{', '.join(lacking)}: write those of the new day into batch.toml"
        if settings.pulp_temperature_C is not None or settings.temperature is not None:
            table = settings.temperature
            values = {} if table is None else table.model_dump()
            numbers = ", ".join(f"{name} = {number:g}" for name, number in values.items())
            again = f", and again [temperature] {numbers}" if numbers else ""
            yield f"pulp_temperature_C: write that of the new day into batch.toml{again}"
        if settings.mismatch:
            names = ", ".join(sorted({effect.effect for effect in settings.mismatch}))
            yield f"confirmed effects ({names}): drupe copies none; run `drupe explain` on the new fruit"
        for path in filter(self._leaves, self._named_files()):
            yield f"{path}: is a link to a file outside {self.root}, which drupe does not copy"
        for name in (settings.category, settings.pit.prior, settings.rig):
            if name and (".." in Path(name).parts or Path(name).is_absolute()):
                place = (batch / name).resolve()
                if place != (self.root / name).resolve():
                    yield f"{name}: lies outside {self.root} and now means {place}; correct it in batch.toml"


def make_batch(
    root: Path,
    folders: Sequence[Path],
    *,
    stated: Mapping[str, str | date | None],
    like: Path | None = None,
) -> NewBatch:
    """Creates the batch in `root`, a new or empty folder, with copies of photos, meshes and recordings.
    `stated`: settings of the new batch, None where they are not known. `like`: an earlier batch, whose
    settings it takes except those of the day (OF_THE_DAY).

    A folder is one fruit if it holds photos, a mesh or recordings, also in photos/ and grasps/. Otherwise
    each folder in it is one. Raises BatchRefused with every fault before it writes anything, and NotWritten.
    """
    earlier = None
    if like is not None:
        earlier = EarlierBatch(root=like, settings=read_settings(BatchFolder(like).settings))
    category = str(stated.get("category") or (DEFAULT if earlier is None else earlier.settings.category))
    named = {name: value for name, value in {**stated, "category": category}.items() if value}
    sources = [list(_sources(folder)) if folder.is_dir() else [] for folder in folders]
    fruits = sorted(chain(*sources), key=lambda source: in_order(Path(source.fruit_id)))
    problems = []
    if earlier is None and not folders:
        problems.append(Problem("drupe new", "needs --photos FOLDER, --like BATCH, or both."))
    if category not in (known := known_categories()) and not category.endswith(".toml"):
        said = (
            f'drupe knows no category "{category}"; known: {", ".join(known)}. You can also name '
            "your own file."
        )
        problems.append(Problem("drupe new", said))
    if root.is_symlink() or (root.exists() and (not root.is_dir() or any(root.iterdir()))):
        problems.append(Problem(str(root), "exists already and is not empty; name a new folder."))
    for folder, of_folder in zip(folders, sources, strict=True):
        if not folder.is_dir():
            problems.append(Problem(str(folder), "is not a folder; name a folder of photos."))
        elif not of_folder:
            sentence = "holds no photos (JPEG, PNG, HEIC), meshes or recordings; nor do its subfolders."
            problems.append(Problem(str(folder), sentence))
    problems += _wrong_names([fruit.fruit_id for fruit in fruits])
    if problems:
        raise BatchRefused(problems)
    target = root.resolve()
    with scratch(near=target) as unfinished:
        try:
            _write(unfinished / "batch", fruits, named, earlier)
            moved_in(unfinished / "batch", target)
        except OSError as error:
            raise NotWritten(root, error) from error
    mat = BatchFolder(root).mat.is_file()
    missing = list(_missing(root, fruits, mat=mat))
    if earlier is not None:
        missing += earlier.left_out(root, named)
    return NewBatch(root=root, fruits=tuple(fruits), missing=tuple(missing))


def _wrong_names(names: Sequence[str]) -> Iterator[Problem]:
    """Problems of folders whose names are no fruit_id or occur twice."""
    for name, count in Counter(names).items():
        if name.lower() in PARTS:
            sentence = (
                f'the folder "{name}" does not name a fruit; give the folder above it, or '
                "rename it after the fruit."
            )
            yield Problem("--photos", sentence)
        if not SAFE_ID.fullmatch(name):
            sentence = (
                f'"{name}" is not a valid fruit_id (letters, digits, . _ - and spaces); rename the folder.'
            )
            yield Problem("a folder's name", sentence)
        if count > 1:
            sentence = (
                f'two folders have the name "{name}"; rename one, because every fruit needs its own id.'
            )
            yield Problem("drupe new", sentence)


def _sources(folder: Path) -> Iterator[FruitSource]:
    """The folder as one fruit, else the folders in it that are fruit."""
    source = _source(folder)
    if source is not None:
        yield source
        return
    for inside in sorted((p for p in folder.iterdir() if p.is_dir() and not p.is_symlink()), key=in_order):
        if (inside_source := _source(inside)) is not None:
            yield inside_source


def _source(folder: Path) -> FruitSource | None:
    """The folder as one fruit; None if it has no photos, mesh or recordings."""
    fruit_folder = FruitFolder(folder)
    place = fruit_folder.photos if photo_paths(fruit_folder.photos) else folder
    photos = photo_paths(place)
    mesh = tuple(path for path in (fruit_folder.fruit_ply, fruit_folder.pit_ply) if not not_plain(path))
    recordings = sorted((*CaseFolder(folder).grasp_files(), *fruit_folder.grasp_files()), key=in_order)
    if not photos and not mesh and not recordings:
        return None
    name = unicodedata.normalize("NFC", folder.resolve().name)
    unused = unused_photos(place, pictures_alone=place == folder)
    return FruitSource(
        fruit_id=name, photos=tuple(photos), mesh=mesh, recordings=tuple(recordings), unused=tuple(unused)
    )


def _write(
    batch: Path,
    fruits: Sequence[FruitSource],
    named: Mapping[str, str | date],
    earlier: EarlierBatch | None,
) -> None:
    folder = BatchFolder(batch)
    batch.mkdir()
    folder.settings.write_text(_settings(named, earlier), encoding="utf-8")
    columns: tuple[str, ...] = COLUMNS
    if earlier is not None:
        earlier.copy_files(batch)
        columns = (*COLUMNS, *earlier.settings.columns)
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([fruit.fruit_id, *[""] * (len(columns) - 1)] for fruit in fruits)
    folder.table.write_text(table.getvalue(), encoding="utf-8")
    for fruit in fruits:
        fruit_folder = folder.fruit(fruit.fruit_id)
        for place, files in (
            (fruit_folder.photos, fruit.photos),
            (fruit_folder.root, fruit.mesh),
            (fruit_folder.root / "grasps", fruit.recordings),
        ):
            place.mkdir(parents=True, exist_ok=True)
            for path in files:
                shutil.copyfile(path, place / path.name)


def _settings(named: Mapping[str, str | date], earlier: EarlierBatch | None) -> str:
    """The text of batch.toml: the earlier batch's, or the template with the values in `named`."""
    if earlier is not None:
        return earlier.written(named)
    template = TEMPLATE.read_text(encoding="utf-8")
    text = template.format(category=named["category"], known=", ".join(known_categories()))
    for name in ("cultivar", *STATED):
        if name in named:
            line = f"{name} = {toml_value(named[name])}\n".replace("\\", r"\\")
            text = re.sub(rf"^# {name} = .*\n", line, text, count=1, flags=re.MULTILINE)
    return text


def _missing(root: Path, fruits: Sequence[FruitSource], *, mat: bool) -> Iterator[str]:
    """Sentences on what grading needs and these folders lack."""
    if not fruits:
        yield (
            f"fruit: for each fruit, put photos/ and grasps/ into {root}/fruits/<fruit_id>, and add a row to "
            "fruits.csv"
        )
    photographed = [fruit for fruit in fruits if fruit.photos and not fruit.mesh]
    if photographed and not mat:
        yield (
            "scale: write height_mm of each fruit into fruits.csv, or copy the mat's mat.json into "
            f"{root}, or name a coin under [photos] in batch.toml"
        )
    yield from (
        f"photos of {source.fruit_id}: {said.rstrip('.')}"
        for source in photographed
        for said in source.unused
    )
    few = [source.fruit_id for source in photographed if len(source.photos) < FEW]
    if few:
        yield (
            f"photos: {_named(few)} fewer than {FEW} photos; take 20 to 36 from all around, at two heights"
        )
    bare = [fruit.fruit_id for fruit in fruits if not fruit.photos and not fruit.mesh]
    if bare:
        yield f"shape: {_named(bare)} no photos and no fruit.ply"
    ungrasped = [fruit.fruit_id for fruit in fruits if not fruit.recordings]
    if ungrasped:
        yield (
            f"grasps: {_named(ungrasped)} no recording; put .h5 files or folders of frames into "
            f"{root}/fruits/<fruit_id>/grasps (`drupe convert` reads sensor files)"
        )


def _named(names: Sequence[str]) -> str:
    return f"{listed(names, SHOWN)} {'has' if len(names) == 1 else 'have'}"
