"""Opens HDF5 files of unknown origin, with a specific message for each fault of the file as a whole.

The library trusts a file's contents: it follows texts without an end and unpacks any size. Neither exceptions
nor Python's signal handlers interrupt its native code. A separate process therefore first reads everything
but pictures, with limits on time and memory.
"""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import h5py

from pipeline.files.plain_file import (
    LFS_POINTER,
    NO_LFS_FILE,
    NotReadable,
    named_in_utf8,
    open_plain,
    printable,
    size,
)
from tactile.readers.limited_process import lacks_memory, tried
from tactile.readers.pictures import absence
from tactile.tactile_failure import TactileFailure, TactileProblem

MOST_BYTES = 8_000_000_000
"""Largest recording with its images; a larger file is refused before it is opened."""
PATIENCE_S = 20.0
"""Most time to read a file; an intact recording takes 0.05 s for each 10 MB."""
MOST_MEMORY = 500_000_000
"""Most bytes of all fields but pictures at once: two pads of 400 markers for a minute at 30 frames a second
take 70 MB. Grading takes several times as much."""
MOST_HASHED_BYTES = 10_000_000
"""Largest file to hash: it takes 5 to 10 ms, like the start of a process."""
PICTURES = "images"
"""A field of raw frames, which is never read."""
_read_through: set[bytes] = set()
"""Hashes of files that the library read to the end: a run opens one file several times."""
SIGNATURE = b"\x89HDF\r\n\x1a\n"
OPEN_TO_WRITE = 0b101
"""Bits of the consistency flags that a writer sets and clears on closing (HDF5 file format, superblock
versions 2 and 3, byte 11).
"""
COMPLETE, COPY_AGAIN = "a complete HDF5 file", "copy it again from the recorder"
DAMAGED = f"{COPY_AGAIN}: it is cut short or damaged"


def first_line(cause: Exception) -> str:
    """The first line of the HDF5 library's message."""
    return str(cause).splitlines()[0][:120] if str(cause) else type(cause).__name__


def unreadable(path: Path, field: str, fault: str, expected: str, advice: str) -> TactileFailure:
    """The failure sentence of this format: where, what was found, what was expected, what to do."""
    fault = fault if len(fault) <= 200 else f"{fault[:197]}..."
    detail = f"{path.name}: {field}: found {fault}, expected {expected}; {advice}."
    return TactileProblem.UNREADABLE_RECORDING.failure(printable(detail))


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The open file; errors of the HDF5 library inside the block become a TactileFailure."""
    if not named_in_utf8(path):
        fault, expected = "a name that is not UTF-8", "letters, digits, - and _"
        raise unreadable(path, "the file", fault, expected, "rename it")
    if missing := absence(path):
        advice = "record the grasp again or correct the name"
        raise unreadable(path, "the file", missing, "an HDF5 recording", advice)
    if (length := path.stat().st_size) > MOST_BYTES:
        fault = f"{length / 1e9:.1f} GB"
        advice = "divide the recording, or leave its images out"
        raise unreadable(path, "the file", fault, f"at most {size(MOST_BYTES)}", advice)
    require_end(path)
    try:
        file = h5py.File(path, "r")
    except (OSError, RuntimeError, KeyError, TypeError, ValueError) as cause:
        raise _damaged(path, cause) from cause
    # The fields' readers handle TypeError and ValueError: here these would hide faults of this program.
    with file:
        try:
            yield file
        except (OSError, RuntimeError, KeyError) as cause:
            raise _damaged(path, cause) from cause


def require_end(path: Path, *, patience_s: float = PATIENCE_S) -> None:
    """Raises TactileFailure (unreadable-recording) if reading the file exceeds the limits of time or memory.

    An error of the library is no fault here, since the reader will report it. Contents that were read to the
    end once are not read again.
    """
    digest = _digest(path)
    if digest in _read_through:
        return
    trial = tried(lambda tell: _read(path, tell), patience_s=patience_s, most_bytes=MOST_MEMORY)
    if not trial.exceeded:
        _read_through.update([] if digest is None else [digest])
        return
    fault = f"contents that are damaged, or take more than {trial.exceeded} to read"
    raise unreadable(path, trial.lines[-1] if trial.lines else "the file", fault, COMPLETE, DAMAGED)


def _digest(path: Path) -> bytes | None:
    """SHA-256 of the file; None if it is longer than MOST_HASHED_BYTES or cannot be read."""
    with suppress(OSError, NotReadable), open_plain(path) as file:
        data = file.read(MOST_HASHED_BYTES + 1)
        return hashlib.sha256(data).digest() if len(data) <= MOST_HASHED_BYTES else None
    return None


def _read(path: Path, tell: Callable[[str], None]) -> None:
    """Reads every attribute and field but pictures, and keeps them all; links are not followed."""
    held = []
    with h5py.File(path, "r") as file:
        pads = child_group(file, "pads")
        for group in (file, pads, *(child_group(pads, name) for name in _names(pads))):
            for name in _names(group and group.attrs):
                tell(f"attribute {name}")
                held.append(_value(group.attrs, name))
            for name in _names(group):
                if name != PICTURES and _holds(group, name, h5py.Dataset):
                    tell(group[name].name.lstrip("/"))
                    held.append(_value(group[name], ()))


def _names(container: Any) -> list[str]:
    with suppress(OSError, RuntimeError, KeyError, TypeError):
        return list(container)
    return []


def _value(container: Any, key: Any) -> Any:
    """The value; None if the library raises an error, which the reader will report.

    Raises MemoryError also if a filter fails: the library reports too little memory in no other way.
    """
    try:
        return container[key]
    except Exception as cause:
        if lacks_memory(cause) or "filter returned failure" in str(cause):
            raise MemoryError from cause
        return None


def _holds(group: Any, name: str, kind: type) -> bool:
    """Whether `group` has an object of this kind (h5py.Group or Dataset), without links, in this file."""
    with suppress(TypeError, ValueError):
        hard = isinstance(group.get(name, getlink=True), h5py.HardLink)
        return hard and group.get(name, getclass=True) is kind and not is_elsewhere(group[name])
    return False


def is_elsewhere(data: Any) -> bool:
    """Whether a dataset's values are in another file."""
    return isinstance(data, h5py.Dataset) and bool(data.external or data.is_virtual)


def child_group(group: Any, name: str) -> Any:
    """The group of that name in `group`; None if it is missing or a link."""
    return group[name] if _holds(group, name, h5py.Group) else None


def _damaged(path: Path, cause: Exception) -> TactileFailure:
    said = "" if isinstance(cause, KeyError) else first_line(cause)
    return unreadable(path, "the file", *_fault(path, said))


def _fault(path: Path, said: str) -> tuple[str, str, str]:
    """What was found, expected and advised, by the first bytes and the library's message `said`."""
    with path.open("rb") as file:
        first = file.read(512)
    if first.startswith(LFS_POINTER):
        return f"that it {NO_LFS_FILE}", "an HDF5 recording", "then check again"
    if "unable to lock file" in said.lower():
        return "a file that another program holds open", "a closed file", "end the recorder, then try again"
    written = first.startswith(SIGNATURE) and len(first) > 11 and first[8] >= 2 and first[11] & OPEN_TO_WRITE
    if written or "already open for write" in said:
        fault = "a file that its writer has not closed (the mark is in its first bytes)"
        advice = "close it in the recorder; if the recorder has ended, run `h5clear -s FILE` on a copy"
        return fault, "a closed HDF5 file", advice
    if first.startswith(b"MATLAB 5.0"):
        fault = "a MATLAB file of a version before 7.3"
        return fault, "HDF5", "write the recording with h5create, h5write and h5writeatt"
    if "signature not found" in said and not first:
        return "an empty file", "an HDF5 recording", COPY_AGAIN
    if "signature not found" in said and not first.startswith(bytes(8)):
        fault = f"no HDF5 file (it begins with {printable(repr(first[:12]))})"
        return fault, "an HDF5 recording", "copy it again, or make a recording of it with `drupe convert`"
    if "truncated file" in said:
        return "one that is cut short, or that its writer did not close", COMPLETE, COPY_AGAIN
    return f"no readable HDF5 ({said})" if said else "no readable HDF5", COMPLETE, DAMAGED
