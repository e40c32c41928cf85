"""Opening an HDF5 file of unknown origin, each fault of the file as a whole in words of its own.

The library believes what a file says of itself: it follows texts without an end and unpacks any size, in
native code that no exception and no signal handler of Python's interrupts. So a process of its own reads
everything but pictures first, in time and with little memory.
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
"""Of a recording with its images; a larger file is refused before it is opened."""
PATIENCE_S = 20.0
"""A sound recording is read in 0.05 s for each 10 MB."""
MOST_MEMORY = 500_000_000
"""Of all fields but pictures, held at once: two pads of 400 markers for a minute at 30 frames a second take
70 MB. Grading takes some times as much."""
MOST_HASHED_BYTES = 10_000_000
"""Of a file whose hash is worth the while: it takes 5 to 10 ms then, as does starting a process."""
PICTURES = "images"
"""A field of raw frames, which is never read."""
_read_through: set[bytes] = set()
"""Hashes of contents that the library came to the end of: one file is opened several times in a run."""
SIGNATURE = b"\x89HDF\r\n\x1a\n"
OPEN_TO_WRITE = 0b101
"""Bits of the consistency flags that a writer sets and clears on closing (HDF5 file format, superblock
versions 2 and 3, byte 11).
"""
COMPLETE, COPY_AGAIN = "a complete HDF5 file", "copy it again from the recorder"
DAMAGED = f"{COPY_AGAIN}: it is cut short or damaged"


def first_line(cause: Exception) -> str:
    """What the HDF5 library says, without the lines below it."""
    return str(cause).splitlines()[0][:120] if str(cause) else type(cause).__name__


def unreadable(path: Path, field: str, fault: str, expected: str, advice: str) -> TactileFailure:
    """The failure sentence of this format: where, what was found, what was expected, what to do."""
    fault = fault if len(fault) <= 200 else f"{fault[:197]}..."
    detail = f"{path.name}: {field}: found {fault}, expected {expected}; {advice}."
    return TactileProblem.UNREADABLE_RECORDING.failure(printable(detail))


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The open file; every complaint of the HDF5 library inside the block becomes a TactileFailure."""
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
    # The fields' readers answer for TypeError and ValueError: here they would hide mistakes of this program.
    with file:
        try:
            yield file
        except (OSError, RuntimeError, KeyError) as cause:
            raise _damaged(path, cause) from cause


def require_end(path: Path, *, patience_s: float = PATIENCE_S) -> None:
    """Refuses a file that the library does not come to the end of in time and memory.

    An end with an error is no fault here: the reader will say which. Contents that were once read so are not
    read again.
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
    """SHA-256 of the file; None of one that is too long for it to pay, or that cannot be read."""
    with suppress(OSError, NotReadable), open_plain(path) as file:
        data = file.read(MOST_HASHED_BYTES + 1)
        return hashlib.sha256(data).digest() if len(data) <= MOST_HASHED_BYTES else None
    return None


def _read(path: Path, tell: Callable[[str], None]) -> None:
    """Every attribute and field but pictures, of which all is held; links are not followed."""
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
    """What the library reads; None where it complains, which the reader will hear too.

    Raises MemoryError where a filter fails: the library says no more where there is no room to unpack.
    """
    try:
        return container[key]
    except Exception as cause:
        if lacks_memory(cause) or "filter returned failure" in str(cause):
            raise MemoryError from cause
        return None


def _holds(group: Any, name: str, kind: type) -> bool:
    """Whether `group` itself, not by a link, holds an object of this kind (h5py.Group, h5py.Dataset)."""
    with suppress(TypeError, ValueError):
        hard = isinstance(group.get(name, getlink=True), h5py.HardLink)
        return hard and group.get(name, getclass=True) is kind and not is_elsewhere(group[name])
    return False


def is_elsewhere(data: Any) -> bool:
    """Whether a dataset's values are in another file."""
    return isinstance(data, h5py.Dataset) and bool(data.external or data.is_virtual)


def child_group(group: Any, name: str) -> Any:
    """The group of that name in `group`; None where there is none, or a link to one."""
    return group[name] if _holds(group, name, h5py.Group) else None


def _damaged(path: Path, cause: Exception) -> TactileFailure:
    said = "" if isinstance(cause, KeyError) else first_line(cause)
    return unreadable(path, "the file", *_fault(path, said))


def _fault(path: Path, said: str) -> tuple[str, str, str]:
    """What was found, expected and is to be done, by the first bytes and what the library `said`."""
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
