"""Finds files in a batch that look like inputs but that drupe does not read, and gives advice on each kind.

Folders of photos: recon.cameras.unused_photos.
"""

import os
import unicodedata
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from pipeline.batch.fruits_table import SAFE_ID
from pipeline.batch.layout import MESHES, RECORDINGS, BatchFolder, FruitFolder, entries_in, raw_grasp_files
from pipeline.files.plain_file import listed, not_plain
from pipeline.problem import Problem
from recon.cameras.photos import SUFFIXES as PHOTOS

ADVICE = {
    **dict.fromkeys(RECORDINGS, "drupe reads recordings in fruits/<fruit_id>/grasps/; move it there"),
    **dict.fromkeys(
        MESHES,
        f"drupe reads one mesh named fruit and one named pit ({', '.join(MESHES)}) in fruits/<fruit_id>/; "
        "rename it or move it away",
    ),
    **dict.fromkeys(
        (".gltf", ".3mf", ".off", ".step", ".stp", ".pcd", ".xyz", ".las"),
        f"meshes are read as {', '.join(MESHES)}; export a surface in one of these formats, named fruit.ply",
    ),
    **dict.fromkeys(PHOTOS, "drupe reads photos in fruits/<fruit_id>/photos/; move it there"),
    **dict.fromkeys(
        (".webp", ".avif", ".bmp", ".tif", ".tiff", ".gif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf"),
        "drupe reads photos in fruits/<fruit_id>/photos/; convert it to JPEG and move it there",
    ),
    **dict.fromkeys(
        (".avi", ".mp4", ".mov", ".mkv", ".webm"),
        "drupe reads a video only if grasp.toml of a raw grasp names it; move it there",
    ),
    **dict.fromkeys(
        (".csv", ".tsv", ".xls", ".xlsx", ".ods", ".npz", ".npy", ".bag", ".db3", ".mcap", ".parquet"),
        "fruits.csv lists the fruit, recordings are .h5; convert it with `drupe convert`, or move it away",
    ),
    **dict.fromkeys((".zip", ".7z", ".tar", ".gz"), "drupe does not open archives; unpack it"),
}
"""Advice on an input in the wrong place or of an unsupported kind, by its suffix in lower case."""
MOST_NAMED = 3
"""Most files in one sentence."""


def unused_of_fruit(folder: FruitFolder) -> list[Problem]:
    """Remarks on unused files of a fruit's folder that look like inputs; each has the path of its first."""
    unused = [(path, why) for path in _files_in(folder.root) if (why := _why(path))]
    if folder.fruit_ply.suffix.lower() == ".obj":  # its texture
        unused = [(path, why) for path, why in unused if path.suffix.lower() not in PHOTOS]
    for path in _files_in(folder.grasps) if folder.grasps != folder.root else ():
        if path.suffix.lower() not in RECORDINGS:
            unused += [(path, why)] if (why := _why(path)) else []
        elif fault := not_plain(path):
            unused.append((path, f"it {fault}; put the file itself there, or remove it"))
    for place in _folders_in(folder.root):
        if place not in (folder.photos, folder.photos_flipped, folder.grasps) and any(
            map(_why, _files_in(place))
        ):
            why = "a fruit's folders are photos/, photos-flipped/ and grasps/; rename it or move the files"
            unused.append((place, why))
    return _in_sentences(unused, folder.input_files()) if unused else []


def unused_of_batch(folder: BatchFolder, used: Collection[Path]) -> list[Problem]:
    """Such remarks on the batch's own folder and on fruits/, outside the folders of single fruit. `used`:
    files that the settings name.
    """
    known = (folder.settings, folder.table, folder.mat)
    files = [*_files_in(folder.root), *_files_in(folder.fruits)]
    unused = [(path, why) for path in files if path not in known and (why := _why(path))]
    for place in _folders_in(folder.fruits):
        if not SAFE_ID.fullmatch(unicodedata.normalize("NFC", place.name)):
            why = (
                "a fruit_id has letters, digits, dot, dash, underscore and space, and starts with a letter "
                "or digit. Rename the folder, and add a row to fruits.csv"
            )
            unused.append((place, why))
    return _in_sentences(unused, [*used, *_of_raw_grasps(folder)]) if unused else []


def _why(path: Path) -> str:
    return ADVICE.get(path.suffix.lower(), "")


def _in_sentences(unused: Iterable[tuple[Path, str]], used: Iterable[Path]) -> list[Problem]:
    """One remark for all files of a folder with the same advice."""
    known = {os.path.realpath(path) for path in used}
    causes: dict[tuple[Path, str], list[Path]] = defaultdict(list)
    for path, why in unused:
        if os.path.realpath(path) not in known:
            causes[path.parent, why].append(path)
    problems = []
    for (_, why), paths in causes.items():
        names = listed([path.name for path in paths], MOST_NAMED)
        sentence = f"{names} {'is' if len(paths) == 1 else 'are'} not used: {why}."
        problems.append(Problem(str(paths[0]), sentence, remark=True))
    return problems


def _files_in(folder: Path) -> Iterator[Path]:
    return (path for path in entries_in(folder) if not path.is_dir())


def _folders_in(folder: Path) -> Iterator[Path]:
    return filter(Path.is_dir, entries_in(folder))


def _of_raw_grasps(folder: BatchFolder) -> Iterator[Path]:
    """Files of all raw grasps, also those outside their folders."""
    for place in _folders_in(folder.fruits):
        for grasp in FruitFolder(place).raw_grasp_folders():
            yield from raw_grasp_files(grasp)
