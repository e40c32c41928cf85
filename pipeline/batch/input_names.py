"""Names that a batch's folders reserve, in any case, and files that operating systems create beside them."""

import os
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
