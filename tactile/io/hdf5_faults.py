"""What is wrong with an HDF5 file as a whole, before any field of it is read, each cause in words of its own.

A text is kept in a heap whose entries tell where the next one begins; the library follows them without a
limit, in native code that no exception and no signal handler of Python's interrupts. So a process of its own
reads the texts and links first, in time and with little memory.

Column-major programs write dimensions in the opposite order: MATLAB's h5write turns an array of T x N x 3
into a dataset of (3, N, T).
"""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py

from pipeline.files.plain_file import LFS_POINTER, NO_LFS_FILE, NotReadable, open_plain, printable, size
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
REVERSED = "the dimensions of all fields are reversed, as MATLAB writes them: (3, N, T) was read as (T, N, 3)"
SIGNATURE = b"\x89HDF\r\n\x1a\n"
OPEN_TO_WRITE = 0b101
"""Bits of the consistency flags that a writer sets and clears on closing (HDF5 file format, superblock
versions 2 and 3, byte 11).
"""
FILTERS = {
    4: "SZIP", 5: "N-bit", 6: "scale-offset", 305: "LZO", 307: "bzip2", 32000: "LZF", 32001: "Blosc",
    32004: "LZ4", 32008: "bitshuffle", 32013: "ZFP", 32015: "Zstandard", 32017: "SZ", 32026: "Blosc2",
}  # fmt: skip
"""Names by numbers, as The HDF Group registers them."""


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
    links: list[tuple[str, bool]] = []

    def look(name: bytes, link: Any) -> bool | None:
        inside = link.type in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT)
        links.append((name.decode(errors="replace"), inside))
        return True if len(links) > MOST_LINKS else None

    file.id.links.visit(look, info=True)
    return links


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
    return [pads, *(child for name in pads if (child := child_group(pads, name)) is not None)]


def holds(group: Any, name: str, kind: type) -> bool:
    """Whether `group` itself, not by a link, holds an object of this kind (h5py.Group, h5py.Dataset)."""
    return isinstance(group.get(name, getlink=True), h5py.HardLink) and group.get(name, getclass=True) is kind


def child_group(group: Any, name: str) -> Any:
    """The group of that name in `group`; None where there is none, or a link to one."""
    return group[name] if holds(group, name, h5py.Group) else None


def has_reversed_dimensions(file: Any) -> bool:
    """Whether every field of the pads, and the wrench, has the reverse of its shape, and one of them not the
    shape itself. T is the length of time_s, N that of each pad's rest_mm; links are not followed.
    """
    pairs = list(_shapes(file))
    return (
        bool(pairs)
        and all(_is(held[::-1], want) for held, want in pairs)
        and not all(_is(held, want) for held, want in pairs)
    )


def _is(held: tuple[int, ...], want: tuple[int | None, ...]) -> bool:
    """Whether it is this shape, None: any length, 0 too."""
    return len(held) == len(want) and all(n in (None, length) for length, n in zip(held, want, strict=True))


def _shapes(file: Any) -> Iterator[tuple[tuple[int, ...], tuple[int | None, ...]]]:
    """The shape of each field of two dimensions or more, and the one that it should have."""
    time, wrench = _dataset(file, "time_s"), _dataset(file, "wrench_N")
    frames = None if time is None else max(time, default=0)
    if wrench is not None:
        yield wrench, (frames, 6)
    pads = child_group(file, "pads")
    for name in pads or ():
        pad = child_group(pads, name)
        rest = None if pad is None else _dataset(pad, "rest_mm")
        markers = max(rest, default=0) if rest is not None and len(rest) == 2 else None
        wanted: dict[str, tuple[int | None, ...]] = {"pose": (frames, 4, 4), "rest_mm": (markers, 3)}
        wanted |= dict.fromkeys(("displacement_mm", "force_N"), (frames, markers, 3))
        for field, want in wanted.items() if pad is not None else ():
            if (held := _dataset(pad, field)) is not None:
                yield held, want


def _dataset(group: Any, name: str) -> tuple[int, ...] | None:
    """The shape of a dataset; None where there is none, or it holds no array."""
    return group[name].shape if holds(group, name, h5py.Dataset) else None


def fault_of(path: Path, said: str) -> tuple[str, str, str] | None:
    """What was found, what was expected and what to do, where the cause can be told from the first bytes or
    from what the library `said`; None where it cannot.
    """
    with path.open("rb") as file:
        first = file.read(512)
    if first.startswith(LFS_POINTER):
        return f"that it {NO_LFS_FILE}", "an HDF5 recording", "then check again"
    if "unable to lock file" in said.lower():
        return "a file that another program holds open", "a closed file", "end the recorder, then try again"
    if first.startswith(SIGNATURE):
        in_use = len(first) > 11 and first[8] >= 2 and bool(first[11] & OPEN_TO_WRITE)
        return _STILL_OPEN if in_use or "already open for write" in said else None
    if first.startswith(b"MATLAB 5.0"):
        fault = "a MATLAB file of a version before 7.3"
        return fault, "HDF5", "write the recording with h5create, h5write and h5writeatt"
    if "signature not found" in said and not first:
        return "an empty file", "an HDF5 recording", "copy it again from the recorder"
    if "signature not found" in said and not first.startswith(bytes(8)):
        fault = f"no HDF5 file (it begins with {printable(repr(first[:12]))})"
        return fault, "an HDF5 recording", "copy it again, or make a recording of it with `drupe convert`"
    return None


_STILL_OPEN = (
    "a file that its writer has not closed (the mark is in its first bytes)",
    "a closed HDF5 file",
    "close it in the recorder; if the recorder has ended, run `h5clear -s FILE` on a copy",
)


def unknown_filter(data: Any) -> str:
    """The filter, by name and number, that this dataset needs and the library lacks; empty: none."""
    steps: Any = data.id.get_create_plist()
    for k in range(steps.get_nfilters()):
        number, _, _, name = steps.get_filter(k)
        if not h5py.h5z.filter_avail(number):
            known = FILTERS.get(number) or printable(name.decode("utf-8", "replace"))[:40] or "without a name"
            return f"{known} (number {number})"
    return ""
