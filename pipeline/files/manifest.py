"""A results folder's list of the files that drupe wrote into it: nothing else in it is ever touched.

`.written.json` holds, for each file, the SHA-256 of what was written. It is brought up to date before the
file is, so that a run killed between the two leaves nothing that the next one does not know. Of two processes
that write into one folder one waits for the other, by a lock on `.written.lock`.
"""

import errno
import hashlib
import json
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from pipeline.files.lock_file import WAIT_S, lock_of
from pipeline.files.plain_file import NotReadable, json_of, read_text, stands
from pipeline.files.whole_file import NotWritten, put

MANIFEST = ".written.json"
LIST_LOCK = ".written.lock"
FORMAT = "drupe-written"
MOST_BYTES = 20_000_000
"""Of a JSON file or page that is not on the list of what drupe wrote: batch.json of 2000 fruit with 72 photos
each, at 110 bytes a photo, is 16 MB."""


class NotOurs(NotWritten):
    """A file stands in the way that drupe did not write, or that was changed since."""

    def __str__(self) -> str:
        return f"{self._path}: {STRANGER}"


STRANGER = (
    "was not written by drupe, or was changed since, and is not overwritten; move it away, or choose another "
    "place for the results."
)


def is_claimed(folder: Path) -> bool:
    """Whether `folder` is one that drupe keeps a list of."""
    return _read(folder) is not None


def in_the_way(targets: Iterable[Path]) -> Iterator[Path]:
    """Of the places of files that drupe is to write: folders and files that are links, files that drupe did
    not write or that were changed since, and what stands where a list would be and is none.
    """
    by_folder: dict[Path, list[Path]] = {}
    for path in targets:
        by_folder.setdefault(path.parent, []).append(path)
    for folder, paths in by_folder.items():
        if folder.is_symlink():
            yield folder
            continue
        if not is_claimed(folder) and stands(folder / MANIFEST):
            yield folder / MANIFEST
        yield from (path for path in paths if stands(path) and not is_ours(path))


def json_in(path: Path) -> Any:
    """What a JSON file that drupe wrote holds; None where it is no plain file, a link, or broken.

    Nothing is waited for: a named pipe or a device in its place is not opened. What is listed as drupe's and
    unchanged since is read whatever its size: frames of raw grasps may be millions of inputs.
    """
    most_bytes = MOST_BYTES
    with suppress(OSError):
        if (length := path.lstat().st_size) > MOST_BYTES and is_ours(path):
            most_bytes = length
    return _json(path, most_bytes=most_bytes)


def _json(path: Path, *, most_bytes: int) -> Any:
    try:
        return json_of(read_text(path, most_bytes=most_bytes)) if _is_plain(path) else None
    except NotReadable:
        return None


def claim(folder: Path) -> None:
    """Begins the list of `folder`, unless it has one. Raises NotWritten."""
    if is_claimed(folder):
        return
    with suppress(OSError):  # what cannot be made is said where the list is written
        folder.mkdir(parents=True, exist_ok=True)
    with _alone(folder):
        if not is_claimed(folder):
            _write(folder, {})


@contextmanager
def writing_alone(folder: Path) -> Iterator[None]:
    """Inside the block no other process changes the files of `folder`, where it has a list; where the file
    system has no locks, they are not kept apart. Not to be nested.
    """
    with _alone(folder) if is_claimed(folder) else nullcontext():
        yield


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """After WAIT_S the file is written all the same: a stopped process holds up nobody for good."""
    with ExitStack() as stack:
        with suppress(OSError):
            stack.enter_context(lock_of(folder / LIST_LOCK, wait_s=WAIT_S))
        yield


def is_ours(path: Path) -> bool:
    """Whether `path` is a plain file that holds what drupe wrote there."""
    listed = (_read(path.parent) or {}).get(path.name, [])
    return bool(listed) and _is_plain(path) and _hash(path) in listed


def was_ours(path: Path) -> bool:
    """Whether drupe wrote a plain file there that somebody has changed since."""
    listed = (_read(path.parent) or {}).get(path.name, [])
    return bool(listed) and _is_plain(path) and _hash(path) not in listed


def why_damaged(path: Path) -> str:
    """Why a file in a folder with a list does not hold what drupe wrote there, a sentence without its end;
    empty where it does, and where the folder has no list (of an earlier version, or copied without it).
    """
    if not is_claimed(path.parent) and stands(path.parent / MANIFEST):
        return f"cannot be checked: {MANIFEST} beside it, with the SHA-256 of what drupe wrote, is damaged"
    listed = _read(path.parent)
    if listed is None or (_is_plain(path) and _hash(path) in listed.get(path.name, [])):
        return ""
    return f"does not have the SHA-256 that {MANIFEST} beside it gives: it is damaged or was changed"


def enter(path: Path, data: bytes) -> None:
    """Lists `data` as what is about to be written to `path`, in a block of `writing_alone` that the writing
    belongs to. Raises NotOurs where a stranger's file is.
    """
    listed = _read(path.parent)
    if listed is None:
        return
    present = []
    if stands(path):
        if not is_ours(path):
            raise NotOurs(path, OSError(errno.EEXIST, os.strerror(errno.EEXIST)))
        present = [_hash(path)]
    hashes = list(dict.fromkeys([*present, hashlib.sha256(data).hexdigest()]))
    if listed.get(path.name) != hashes:
        _write(path.parent, {**listed, path.name: hashes})


def remove(path: Path) -> None:
    """Removes `path` where it is ours; anything else stays."""
    with writing_alone(path.parent):
        if is_ours(path):
            path.unlink(missing_ok=True)


def _read(folder: Path) -> dict[str, list[str]] | None:
    said = _json(folder / MANIFEST, most_bytes=MOST_BYTES)
    try:
        if said["format"] != FORMAT:
            return None
        return {str(name): [str(hash_) for hash_ in hashes] for name, hashes in said["files"].items()}
    except (KeyError, TypeError, AttributeError):
        return None


def _write(folder: Path, listed: dict[str, list[str]]) -> None:
    content = {"format": FORMAT, "version": 1, "files": dict(sorted(listed.items()))}
    put(folder / MANIFEST, (json.dumps(content, indent=1) + "\n").encode())


def _is_plain(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def _hash(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""
