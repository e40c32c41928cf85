"""The list of files that drupe wrote into a results folder. drupe replaces and removes only these.

`.written.json` holds, for each file, the SHA-256 of its content. drupe updates it before it writes the file,
so that a run killed in between leaves no file that the next run does not know. A lock on `.written.lock`
makes one process wait while another writes into the folder.
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

from pipeline.files.plain_file import NotReadable, json_of, read_text, stands
from pipeline.files.whole_file import WAIT_S, NotWritten, lock_of, put

MANIFEST = ".written.json"
LIST_LOCK = ".written.lock"
FORMAT = "drupe-written"
MOST_BYTES = 20_000_000
"""Most bytes of the list, and of a JSON file or page that is not on it. With 2000 fruit, 72 photos each and
110 bytes a photo, batch.json has 16 MB."""


class NotOurs(NotWritten):
    """Raised if drupe did not write the file at the target, or if somebody has changed it since."""

    def __str__(self) -> str:
        return f"{self._path}: {not_ours_sentence('choose another place for the results')}"


def not_ours_sentence(advice: str) -> str:
    """The sentence on a file that drupe must not replace. `advice`: what to do if the file stays there."""
    return (
        "was not written by drupe, or was changed since, so it is not overwritten; "
        f"move it away, or {advice}."
    )


def is_claimed(folder: Path) -> bool:
    """Whether `folder` has a list of the files that drupe wrote."""
    return _read(folder) is not None


def in_the_way(targets: Iterable[Path]) -> Iterator[Path]:
    """What prevents drupe from writing `targets`: links, and files that drupe did not write or that somebody
    changed since. Also a file with the list's name that is no list.
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
    """The content of a JSON file that drupe wrote; None if it is no plain file, a link, too large or invalid.

    Never blocks: it opens no named pipe or device. A listed, unchanged file may have any size: frames of raw
    grasps may be millions of inputs.
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
    """Creates the list of `folder`, unless it has one. Raises NotWritten."""
    if is_claimed(folder):
        return
    with suppress(OSError):  # writing the list reports why it cannot be made
        folder.mkdir(parents=True, exist_ok=True)
    with _alone(folder):
        if not is_claimed(folder):
            _write(folder, {})


@contextmanager
def writing_alone(folder: Path) -> Iterator[None]:
    """Inside the block no other process of drupe changes the files of `folder`, if the folder has a list.
    File systems without locks do not exclude other processes. Must not be nested.
    """
    with _alone(folder) if is_claimed(folder) else nullcontext():
        yield


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Holds the folder's lock; goes on without it after WAIT_S: a stopped process must not block others."""
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
    """Why a file does not have the content that drupe wrote, as a predicate without a full stop; empty if it
    has. Also empty if the folder has no list (from an earlier version, or copied without it).
    """
    if not is_claimed(path.parent) and stands(path.parent / MANIFEST):
        return f"cannot be checked: {MANIFEST} beside it, with the SHA-256 of what drupe wrote, is damaged"
    listed = _read(path.parent)
    if listed is None or (_is_plain(path) and _hash(path) in listed.get(path.name, [])):
        return ""
    return f"does not have the SHA-256 that {MANIFEST} beside it gives: it is damaged or was changed"


def enter(path: Path, data: bytes) -> None:
    """Lists the hash of `data` before the caller writes it to `path` in the same block of `writing_alone`.
    Without a list it does nothing. Raises NotWritten, and NotOurs if drupe did not write the present file.
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
    """Removes `path` if drupe wrote it and nobody has changed it; other files stay."""
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
