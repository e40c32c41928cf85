"""Names that a batch's folders reserve, in upper or lower case, and what computers leave beside them."""

import os
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

from recon.surface.mesh_file import SUFFIXES

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
"""Files and folders that Windows, macOS, Linux and Python make by themselves, in lower case."""
SYSTEM_STARTS = (".", "@", "#", "$", "~$")
"""First letters of hidden files, of folders of network storage (@eaDir, #recycle, $RECYCLE.BIN), and of the
locks of office programs.
"""


def is_of_the_system(name: str) -> bool:
    """Whether a computer made the file or folder of this name by itself.

    >>> [is_of_the_system(name) for name in ("@eaDir", "Thumbs.db", "._a.jpg", "fruit.ply")]
    [True, True, True, False]
    """
    return name.startswith(SYSTEM_STARTS) or name.lower() in SYSTEM_NAMES


def names_in(folder: Path) -> list[str]:
    """The names in a folder, sorted; none where it is missing or cannot be read."""
    with suppress(OSError):
        return sorted(os.listdir(folder))  # noqa: PTH208 - of thousands of fruit
    return []


def reserved(folder: Path, name: str) -> Path:
    """The entry of `folder` with this name; without an exact one, the first that differs in case alone."""
    exact = folder / name
    if os.path.lexists(exact):
        return exact
    return next((folder / other for other in names_in(folder) if other.lower() == name), exact)


def meshes_named(folder: Path, stem: str) -> list[Path]:
    """The meshes of this stem ("fruit", "pit") in `folder`: the exact .ply first, then by MESHES."""
    meshes = [folder / name for name in names_in(folder) if _is_named(name, stem, MESHES)]
    return sorted(meshes, key=lambda p: (MESHES.index(p.suffix.lower()), p.name != p.name.lower(), p.name))


def ready_mesh(folder: Path, stem: str) -> Path:
    """The mesh of this stem that is read; where there is none, the place of STEM.ply."""
    exact = folder / f"{stem}.ply"
    if os.path.lexists(exact):
        return exact
    return next(iter(meshes_named(folder, stem)), exact)


def _is_named(name: str, stem: str, suffixes: Collection[str]) -> bool:
    path = Path(name)
    return path.stem.lower() == stem and path.suffix.lower() in suffixes
