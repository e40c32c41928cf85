"""Paths of the files in a batch and in its results."""

import os
import re
import unicodedata
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.files.manifest import claim, enter, remove, writing_alone
from pipeline.files.plain_file import stands
from pipeline.files.whole_file import put, sweep
from recon.cameras.photos import photo_paths
from recon.cameras.unused_photos import unused_photos
from recon.surface.mesh_file import SUFFIXES
from tactile.readers.raw_grasp import files_of
from tactile.readers.recording import is_of_bare_indenter

MESHES = SUFFIXES
RECORDINGS = (".h5", ".hdf5", ".mat")
"""Suffixes of recordings; MATLAB's files of version 7.3 are HDF5."""
SYSTEM_NAMES = frozenset(
    {
        "thumbs.db",
        "ehthumbs.db",
        "desktop.ini",
        "icon\r",
        "system volume information",
        "network trash folder",
        "temporary items",
        "lost+found",
        "__macosx",
        "__pycache__",
    }
)
"""Files and folders that Windows, macOS, Linux and Python create by themselves, in lower case."""
SYSTEM_STARTS = (".", "@", "#", "$", "~$")
"""First letters of hidden files, of folders of network storage (@eaDir, #recycle, $RECYCLE.BIN), and of the
locks of office programs.
"""


def is_of_the_system(name: str) -> bool:
    """Whether a computer created the file or folder of this name by itself.

    >>> [is_of_the_system(name) for name in ("@eaDir", "Thumbs.db", "._a.jpg", "fruit.ply")]
    [True, True, True, False]
    """
    return name.startswith(SYSTEM_STARTS) or name.lower() in SYSTEM_NAMES


def names_in(folder: Path) -> list[str]:
    """The names in a folder, sorted; empty if it is missing or unreadable."""
    with suppress(OSError):
        return sorted(os.listdir(folder))  # noqa: PTH208 - of thousands of fruit
    return []


def entries_in(folder: Path) -> list[Path]:
    """The entries of a folder, sorted by name, without those that computers create by themselves."""
    return [folder / name for name in names_in(folder) if not is_of_the_system(name)]


def reserved(folder: Path, name: str) -> Path:
    """The entry of `folder` with this lower-case name; else the first that differs only in case."""
    exact = folder / name
    if os.path.lexists(exact):
        return exact
    return next((folder / other for other in names_in(folder) if other.lower() == name), exact)


def ready_mesh(folder: Path, stem: str) -> Path:
    """The mesh with this stem ("fruit", "pit") that drupe reads: STEM.ply if it exists, else the first by
    MESHES. Without a mesh, the path of STEM.ply.
    """
    exact = folder / f"{stem}.ply"
    if os.path.lexists(exact):
        return exact
    paths = (folder / name for name in names_in(folder))
    meshes = (path for path in paths if path.stem.lower() == stem and path.suffix.lower() in MESHES)
    return min(
        meshes,
        key=lambda path: (MESHES.index(path.suffix.lower()), path.name != path.name.lower(), path.name),
        default=exact,
    )


@dataclass(frozen=True)
class ResultPath:
    """An attribute of a folder: the path of this name in its `root`."""

    name: str

    def __get__(self, folder: Any, kind: type) -> Path:
        return Path(folder.root, self.name)


@dataclass(frozen=True)
class InputPath(ResultPath):
    """The path of an input, whose name the user may write in capitals."""

    def __get__(self, folder: Any, kind: type) -> Path:
        """The path in the folder, with the spelling of the file there."""
        return reserved(folder.root, self.name)


@dataclass(frozen=True)
class FruitFolder:
    """`fruits/<fruit_id>/`: photos or a ready mesh, and the grasps."""

    root: Path

    photos = InputPath("photos")
    """The folder of multi-view photos."""
    photos_flipped = InputPath("photos-flipped")
    """Optional: photos of the same fruit turned upside down, which show the side that was on the mat."""
    grasps = InputPath("grasps")
    """The folder of recordings and raw grasps."""

    @property
    def fruit_ply(self) -> Path:
        """A ready mesh, used instead of the photos: fruit.ply, or fruit with another mesh's suffix."""
        return ready_mesh(self.root, "fruit")

    @property
    def pit_ply(self) -> Path:
        """A pit that the user placed in the fruit, used instead of the category's prior."""
        return ready_mesh(self.root, "pit")

    def photo_files(self) -> tuple[Path, ...]:
        """Photos, sorted by name."""
        return photo_paths(self.photos)

    def flipped_files(self) -> tuple[Path, ...]:
        """Photos of the fruit upside down, sorted by name."""
        return photo_paths(self.photos_flipped)

    def unused_photos(self) -> list[str]:
        """Sentences on unused files in the folders of photos; empty if a mesh gives the shape."""
        if stands(self.fruit_ply):
            return []
        places = (self.photos, self.photos_flipped)
        return [f"{place.name}/: {said}" for place in places for said in unused_photos(place)]

    def grasp_files(self) -> tuple[Path, ...]:
        """Recordings by name, grasp-2 before grasp-10: the order in which they were made."""
        named = (path for path in entries_in(self.grasps) if path.suffix.lower() in RECORDINGS)
        return tuple(sorted((path for path in named if path.is_file()), key=in_order))

    def raw_grasp_folders(self) -> tuple[Path, ...]:
        """Grasps in the raw form (frames in folders), by name, except those that a recording replaces."""
        ready = {path.stem for path in self.grasp_files()}
        folders = (path for path in entries_in(self.grasps) if path.name not in ready and path.is_dir())
        return tuple(sorted(folders, key=in_order))

    def recordings_by_name(self) -> dict[str, Path]:
        """The recordings by file name without suffix; with the suffix if two names would be the same."""
        files = self.grasp_files()
        often = Counter(path.stem for path in files)
        return {path.stem if often[path.stem] == 1 else path.name: path for path in files}

    def without_shape(self) -> bool:
        """Whether it has only recordings of a bare indenter, no mesh, photos or raw grasps."""
        if stands(self.fruit_ply) or stands(self.photos) or self.raw_grasp_folders():
            return False
        files = self.grasp_files()
        named = [path for path in files if path.suffix.lower() == ".h5"]
        if not all(is_of_bare_indenter(path) for path in named):
            return False
        # Other programs write .hdf5 and .mat too: such a file that is no recording decides nothing.
        return bool(named) or any(is_of_bare_indenter(path) for path in files)

    def input_files(self) -> tuple[Path, ...]:
        """Every file the fruit's result depends on."""
        ready = tuple(p for p in (self.fruit_ply, self.pit_ply) if p.is_file())
        photos = () if self.fruit_ply.is_file() else (*self.photo_files(), *self.flipped_files())
        raw = (path for folder in self.raw_grasp_folders() for path in raw_grasp_files(folder))
        return ready + photos + self.grasp_files() + tuple(raw)


def in_order(path: Path) -> tuple[tuple[str, int], ...]:
    """A sort key of a path that compares numbers in its name by value, other text as text."""
    parts = re.findall(r"(\D*)(\d*)", path.name)
    return tuple((text, int(digits or -1)) for text, digits in parts)


def raw_grasp_files(folder: Path) -> tuple[Path, ...]:
    """Every file of a raw grasp, also those outside that it names; empty if the folder is no raw grasp."""
    if not (folder / "grasp.toml").is_file():  # a link here may lead to a whole disk
        return ()
    return files_of(folder)


@dataclass(frozen=True)
class CaseFolder(FruitFolder):
    """A mismatch case: fruit.ply, pit.ply, case.toml and the recordings, side by side."""

    settings = InputPath("case.toml")

    @property
    def grasps(self) -> Path:  # type: ignore[override]  # both are read alone
        """The recordings lie beside case.toml."""
        return self.root

    def raw_grasp_folders(self) -> tuple[Path, ...]:
        """Empty: a case has only recordings in HDF5."""
        return ()


@dataclass(frozen=True)
class BatchFolder:
    """The files and folders of a batch."""

    root: Path

    settings = InputPath("batch.toml")
    table = InputPath("fruits.csv")
    mat = InputPath("mat.json")
    """mat.json, if the fruit were photographed on a marker mat."""

    @property
    def fruits(self) -> Path:
        """The folder that has one folder for each fruit."""
        return reserved(self.root, "fruits")

    default_results = ResultPath("results")
    """Where results go without --out."""

    def fruit(self, fruit_id: str) -> FruitFolder:
        """The folder of one fruit; its name may be decomposed (NFD), as some systems write accents."""
        composed = self.fruits / fruit_id
        apart = composed.parent / unicodedata.normalize("NFD", fruit_id)
        return FruitFolder(apart if apart.is_dir() and not composed.is_dir() else composed)


@dataclass(frozen=True)
class FruitResults:
    """`OUT/fruits/<fruit_id>/`."""

    root: Path

    record = ResultPath("record.json")
    """Everything known of the fruit."""
    fruit_ply = ResultPath("fruit.ply")
    """The mesh in mm (with a mat: in the mat's frame)."""
    pit_ply = ResultPath("pit.ply")
    """The embedded pit, in the frame of fruit.ply."""
    photo = ResultPath("photo.jpg")
    """A small photo for the report, with the outline that was used."""
    outlines = ResultPath("outlines.jpg")
    """All photos that were used, with their outlines."""
    picture = ResultPath("mesh.webp")
    """The picture of mesh, pit and pad contacts."""
    scene = ResultPath("fruit.glb")
    """Skin, pit and contact patches in three dimensions (glTF)."""
    surface_sd = ResultPath("surface-sd.webp")
    """The map of the standard deviation of the skin's place."""
    traceback = ResultPath("traceback.txt")
    """The traceback of an internal error of drupe."""
    mismatch = ResultPath("mismatch.json")
    """The result of `drupe explain`."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that may be written here, the record first."""
        named = (var for var in vars(FruitResults).values() if isinstance(var, ResultPath))
        return tuple(self.root / result_path.name for result_path in named)

    def claim(self) -> None:
        """Creates the list of files written here; drupe never replaces or removes a file outside it."""
        claim(self.root)

    def forget(self) -> None:
        """Removes an earlier run's files except mismatch.json. The record goes first, so that none stands
        beside files of another run.
        """
        for path in self.files:
            if path != self.mismatch:
                remove(path)

    def sweep(self) -> None:
        """Removes unfinished files of killed runs."""
        for folder in (self.root, self.cache):
            sweep(folder)

    @property
    def cache(self) -> Path:
        """Results of the stages, each under the hash of its inputs (pipeline.batch.cache)."""
        return self.root / ".cache"


@dataclass(frozen=True)
class Results:
    """The results folder of a batch."""

    root: Path

    ranking = ResultPath("ranking.csv")
    ranking_json = ResultPath("ranking.json")
    report = ResultPath("report.html")
    firmness = ResultPath("firmness.csv")
    firmness_page = ResultPath("firmness.html")
    """Table and page of `drupe firmness`."""
    provenance = ResultPath("batch.json")
    verdicts = ResultPath("verdicts.jsonl")
    """People's verdicts on fruit (pipeline.batch.verdicts); no command removes them."""
    run = ResultPath(".run.json")
    """The mark of the last run (pipeline.batch.provenance.write_run)."""

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of the batch as a whole."""
        return (self.ranking, self.ranking_json, self.report, self.provenance)

    def claim(self) -> None:
        """Creates the list of files written here."""
        claim(self.root)

    def fruit(self, fruit_id: str) -> FruitResults:
        """The results of one fruit."""
        return FruitResults(self.root / "fruits" / fruit_id)


def write_whole(path: Path, content: bytes | str) -> None:
    """Writes `content` to `path` so that a reader, or a run killed meanwhile, never sees half a file.

    In a results folder, drupe adds the file to its list of written files. There, drupe waits for other
    processes, and does not replace a file that it did not write. Bytes in the text that are not UTF-8 are
    escaped.
    Raises NotWritten.
    """
    data = content.encode(errors="backslashreplace") if isinstance(content, str) else content
    with writing_alone(path.parent):
        enter(path, data)
        put(path, data)
