"""Whether the HDF5 library comes to an end on a file's texts and links, in time and with little memory.

A text is kept in a heap whose entries tell where the next one begins; the library follows them without a
limit, in native code that no exception and no signal handler of Python's interrupts.
"""

import hashlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py

from pipeline.files.plain_file import NotReadable, open_plain, size
from tactile.io.limited_process import TrialEnding, tried

PATIENCE_S = 10.0
"""A sound recording's attributes are read in 0.005 s."""
MOST_BYTES = 200_000_000
"""Of memory for the texts and links of a file; a sound recording's take less than 1 MB."""
MOST_LINKS = 100_000
"""Names in a file; a recording has some 30. The library looks at 100,000 in 1 s."""
MOST_HASHED_BYTES = 10_000_000
"""Of a file whose hash is worth the while: it takes 5 to 10 ms then, as does starting a process."""
MANY_NAMES, READ_THROUGH = "many names", "read through"
"""What the process that reads tells."""
_read_through: set[bytes] = set()
"""Hashes of contents that the library came to the end of: one file is opened several times in a run."""


def texts_fault(path: Path, *, patience_s: float = PATIENCE_S) -> str:
    """What is wrong with the texts and names of the file, as the object of "found"; empty where nothing is.

    A process reads the attributes of the file and of its groups, and all names in it. An end with an error is
    no fault here: the reader will say which. Contents that were once read so are not read again.
    """
    digest = _digest(path)
    if digest in _read_through:
        return ""
    trial = tried(lambda tell: _read(path, tell), patience_s=patience_s, most_bytes=MOST_BYTES)
    limits = {
        TrialEnding.TOO_LONG: f"in {patience_s:.0f} s",
        TrialEnding.TOO_LARGE: f"with {size(MOST_BYTES)} of memory",
    }
    if trial.ending in limits:
        return f"texts that the HDF5 library does not come to the end of {limits[trial.ending]}"
    if MANY_NAMES in trial.lines:
        return f"more than {MOST_LINKS} names"
    if digest is not None and READ_THROUGH in trial.lines:
        _read_through.add(digest)
    return ""


def _digest(path: Path) -> bytes | None:
    """SHA-256 of the file; None of one that is too long for it to pay, or that cannot be read."""
    with suppress(OSError, NotReadable), open_plain(path) as file:
        data = file.read(MOST_HASHED_BYTES + 1)
        return hashlib.sha256(data).digest() if len(data) <= MOST_HASHED_BYTES else None
    return None


def link_out(file: h5py.File) -> str:
    """The name of the first link to another file, of at most MOST_LINKS names; empty where there is none.

    No link is followed; a file that was opened through one could be a pipe, or none of the user's.
    """
    return next((name for name, inside in _links(file) if not inside), "")


def _links(file: h5py.File) -> list[tuple[str, bool]]:
    """Names in the file, and whether what they name is in it too; MOST_LINKS + 1 at most."""
    found: list[tuple[str, bool]] = []

    def look(name: bytes, link: Any) -> bool | None:
        inside = link.type in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT)
        found.append((name.decode(errors="replace"), inside))
        return True if len(found) > MOST_LINKS else None

    file.id.links.visit(look, info=True)
    return found


def _read(path: Path, tell: Callable[[str], None]) -> None:
    """Every text of unstated length; links are not followed, and other values are small or refused unread."""
    with h5py.File(path, "r") as file:
        if len(_links(file)) > MOST_LINKS:
            tell(MANY_NAMES)
        for group in (file, *_groups(file)):
            for name in group.attrs:
                text = h5py.check_string_dtype(group.attrs.get_id(name).dtype)
                if text is not None and text.length is None:
                    group.attrs[name]
    tell(READ_THROUGH)


def _groups(file: h5py.File) -> list[Any]:
    pads = child_group(file, "pads")
    if pads is None:
        return []
    return [pads, *(one for name in pads if (one := child_group(pads, name)) is not None)]


def holds(group: Any, name: str, kind: type) -> bool:
    """Whether `group` itself, not by a link, holds an object of this kind (h5py.Group, h5py.Dataset)."""
    return isinstance(group.get(name, getlink=True), h5py.HardLink) and group.get(name, getclass=True) is kind


def child_group(group: Any, name: str) -> Any:
    """The group of that name in `group`; None where there is none, or a link to one."""
    return group[name] if holds(group, name, h5py.Group) else None
