"""Files in a batch's folders that look like inputs and that nothing reads. Every file is used, known to be
no input, or named here with what to do.

Photos folders: recon.cameras.unused_photos.
"""

import os
import unicodedata
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from pipeline.batch.fruits_table import SAFE_ID
from pipeline.batch.input_names import MESHES, RECORDINGS, is_of_the_system, meshes_named, names_in
from pipeline.batch.layout import BatchFolder, FruitFolder, raw_grasp_files
from pipeline.files.plain_file import not_plain
from pipeline.problem import listed
from recon.cameras.photos import SUFFIXES as PHOTOS

KINDS: dict[str, tuple[str, ...]] = {
    "recording": RECORDINGS,
    "mesh": MESHES,
    "other mesh": (".gltf", ".3mf", ".off", ".step", ".stp", ".fbx", ".dae", ".wrl", ".x3d", ".3ds", ".usdz"),
    "point cloud": (".pcd", ".xyz", ".las", ".laz", ".e57", ".pts"),
    "other photo": (".jfif", ".jpe", ".webp", ".avif", ".bmp", ".tif", ".tiff", ".gif", ".heics", ".dng"),
    "raw photo": (".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"),
    "photo": PHOTOS,
    "video": (".avi", ".mp4", ".mov", ".mkv", ".m4v", ".webm"),
    "table": (".csv", ".tsv", ".xls", ".xlsx", ".ods", ".dat"),
    "arrays": (".npz", ".npy", ".pkl", ".pickle", ".bag", ".db3", ".mcap", ".tdms", ".parquet", ".feather"),
    "archive": (".zip", ".rar", ".7z", ".tar", ".gz", ".tgz", ".bz2", ".xz"),
    "notes": (".txt", ".md", ".rst", ".pdf", ".rtf", ".doc", ".docx", ".odt", ".html", ".htm", ".log"),
    "program": (".py", ".ipynb", ".sh", ".bat", ".ps1", ".m", ".r", ".jl", ".lnk", ".url"),
    "copy of an editor": (".bak", ".tmp", ".orig", ".swp", ".lock", ".part"),
    "description": (
        ".toml",
        ".json",
        ".yml",
        ".yaml",
        ".xml",
        ".ini",
        ".cfg",
        ".xmp",
        ".aae",
        ".thm",
        ".mtl",
    ),
    "model": (".onnx",),
}
"""What a file is by its suffix, in lower case."""
KIND_OF = {suffix: kind for kind, suffixes in KINDS.items() for suffix in suffixes}
NO_INPUTS = frozenset({"notes", "program", "copy of an editor", "description", "model"})
"""Kinds that are no inputs, or inputs only where another file names them."""
READ_MES = ("readme", "license", "licence", "notes", "makefile", "changelog")
MOST_NAMED = 3
"""Files that one sentence names."""
MOST_ENTRIES = 1000
"""Entries of a folder of another name that are looked at, so that a link to a whole disk costs nothing."""


@dataclass(frozen=True)
class UnusedFile:
    """The place of the first of some files that nothing reads, and the sentence on all of them."""

    path: Path
    sentence: str


Unused = Iterator[tuple[Path, str]]
"""Files, each with why it is not used and what to do."""


def unused_of_fruit(folder: FruitFolder) -> list[UnusedFile]:
    """Files of a fruit's folder that look like inputs and are not used."""
    unused = [*_in_the_fruit_folder(folder), *_among_grasps(folder)]
    return _in_sentences(unused, lambda: set(folder.input_files()))


def unused_of_batch(folder: BatchFolder, used: Collection[Path]) -> list[UnusedFile]:
    """The same of the batch's own folder and of fruits/, outside the folders of single fruit. `used`: files
    that the settings name.
    """
    unused = [*_in_the_batch_folder(folder), *_among_fruits(folder)]
    return _in_sentences(unused, lambda: {*used, *_of_raw_grasps(folder)})


def unused_inputs(folder: BatchFolder, fruit_ids: Iterable[str], used: Collection[Path]) -> list[UnusedFile]:
    """The same of the batch and of all its fruit."""
    fruit = [unused_file for fruit_id in fruit_ids for unused_file in unused_of_fruit(folder.fruit(fruit_id))]
    return [*unused_of_batch(folder, used), *fruit]


def _in_sentences(unused: Iterable[tuple[Path, str]], used: Callable[[], set[Path]]) -> list[UnusedFile]:
    """One sentence for all files of a folder with one cause. `used` is asked only where there are any."""
    held = list(unused)
    known = {os.path.realpath(path) for path in used()} if held else set()
    causes: dict[tuple[Path, str], list[Path]] = defaultdict(list)
    for path, why in held:
        if os.path.realpath(path) not in known:
            causes[path.parent, why].append(path)
    return [UnusedFile(paths[0], _sentence(paths, why)) for (_, why), paths in causes.items()]


def _sentence(paths: list[Path], why: str) -> str:
    names = listed([path.name for path in paths], MOST_NAMED)
    return f"{names} {'is' if len(paths) == 1 else 'are'} not used: {why}."


def kind_of(path: Path) -> str:
    """What the file is by its name: a key of KINDS, "unknown", or empty where it is no input."""
    kind = KIND_OF.get(path.suffix.lower(), "unknown")
    noted = path.stem.lower().startswith(READ_MES) or path.name.endswith("~")
    return "" if kind in NO_INPUTS or noted else kind


def _files_in(folder: Path) -> Iterator[Path]:
    """Files in `folder`, but for those that computers make by themselves."""
    paths = (folder / name for name in names_in(folder) if not is_of_the_system(name))
    return (path for path in paths if not path.is_dir())


def _folders_in(folder: Path) -> Iterator[Path]:
    paths = (folder / name for name in names_in(folder) if not is_of_the_system(name))
    return (path for path in paths if path.is_dir())


def _in_the_fruit_folder(folder: FruitFolder) -> Unused:
    """Files in the fruit's own folder, and folders of other names than its parts'."""
    meshes = {folder.fruit_ply: "fruit", folder.pit_ply: "pit"}
    second = {path: mesh for mesh, stem in meshes.items() for path in meshes_named(folder.root, stem)}
    textured = folder.fruit_ply.suffix.lower() == ".obj"
    for path in _files_in(folder.root):
        kind = kind_of(path)
        if path in meshes or not kind or (textured and kind == "photo"):
            continue
        if path in second:
            yield path, f"drupe reads {second[path].name} instead; keep one"
        elif not kind.endswith("photo") or folder.photo_files() or folder.fruit_ply.is_file():
            yield path, _FOR_A_FRUIT.get(kind, _NO_INPUT)  # else photos_elsewhere says it
    parts = (folder.photos, folder.photos_flipped, folder.grasps)
    for place in _folders_in(folder.root):
        if place in parts:
            continue
        inside = [p for p in islice(_files_in(place), MOST_ENTRIES) if kind_of(p) not in ("", "unknown")]
        if inside:
            held = listed([path.name for path in inside], 1)
            why = (
                "but a fruit's folders are photos/, photos-flipped/ and grasps/; rename it or move the files"
            )
            yield place, f"it holds {held}, {why}"


_NO_INPUT = "drupe does not read this kind of file; move it away, or convert it"
_FOR_A_FRUIT = {
    "recording": "drupe reads recordings in grasps/; move it there",
    "mesh": (
        f"drupe reads a mesh under the name fruit ({', '.join(MESHES)}) or pit; rename it or move it away"
    ),
    "other mesh": (
        f"meshes are read as {', '.join(MESHES)}; export it in one of these formats, named fruit.ply"
    ),
    "point cloud": "points are not a surface; mesh them first, and save the mesh as fruit.ply",
    "photo": "photos are read in photos/; move it there",
    "other photo": "photos are read in photos/; move it there and convert it to JPEG",
    "raw photo": "photos are read in photos/; develop it to JPEG and move it there",
    "video": "drupe reads a video only if grasp.toml of a raw grasp names it, in grasps/",
    "table": "a table is not a recording; convert it with `drupe convert`, into grasps/",
    "arrays": "arrays are not a recording; convert them with `drupe convert`, into grasps/",
    "archive": "drupe does not open archives; unpack it",
}


def _among_grasps(folder: FruitFolder) -> Unused:
    """Files in grasps/ that are no recordings, and what has a recording's name but is no file."""
    for path in _files_in(folder.grasps) if folder.grasps != folder.root else ():
        if (kind := kind_of(path)) and kind != "recording":
            yield path, _FOR_GRASPS.get(kind, _NO_RECORDING)
        elif kind and (fault := not_plain(path)):
            yield path, f"it {fault}; put the file itself there, or remove it"


_NO_RECORDING = (
    f"it is neither a recording ({', '.join(RECORDINGS)}) nor a folder of gel frames; convert it "
    "or move it away"
)
_FOR_GRASPS = {
    "table": "a table is not a recording; convert it with `drupe convert`",
    "arrays": "arrays are not a recording; convert them with `drupe convert`",
    "mesh": "drupe reads a mesh beside grasps/, not in it; move it there",
    "video": "drupe reads a video from the folder of a raw grasp, with its grasp.toml; move it there",
    "archive": "drupe does not open archives; unpack it",
}


def _in_the_batch_folder(folder: BatchFolder) -> Unused:
    known_files = {path.name.lower(): path for path in (folder.settings, folder.table, folder.mat)}
    for path in _files_in(folder.root):
        kind, first = kind_of(path), known_files.get(path.name.lower())
        if first is not None and first != path:
            yield path, f"drupe reads {first.name} instead; keep one"
        elif first is None and kind not in ("", "unknown"):
            yield (
                path,
                _FOR_A_BATCH.get(kind, "drupe reads a fruit's inputs in fruits/<fruit_id>/; move it there"),
            )


_FOR_A_BATCH = {
    "table": "fruits.csv lists the fruit; write them there, or move it away",
    "mesh": "drupe reads a fruit's mesh in fruits/<fruit_id>/, and a common pit where [pit] prior names it",
    "archive": "drupe does not open archives; unpack it",
}


def _among_fruits(folder: BatchFolder) -> Unused:
    """Files in fruits/, and folders that can be no fruit's."""
    for path in _files_in(folder.fruits):
        if kind_of(path):
            yield path, "drupe reads a fruit's inputs in its own folder, fruits/<fruit_id>/; move it there"
    for place in _folders_in(folder.fruits):
        if not SAFE_ID.fullmatch(unicodedata.normalize("NFC", place.name)):
            yield (
                place,
                "a fruit_id has letters, digits, dot, dash, underscore and space, and starts with a "
                "letter or digit. Rename the folder, and add a row to fruits.csv",
            )


def _of_raw_grasps(folder: BatchFolder) -> Iterator[Path]:
    """Files that raw grasps of any fruit name, wherever they lie."""
    for place in _folders_in(folder.fruits):
        for grasp in FruitFolder(place).raw_grasp_folders():
            yield from raw_grasp_files(grasp)
