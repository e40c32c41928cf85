"""Why the HDF5 library cannot read a file, told from the file itself: each cause in words of its own."""

from pathlib import Path
from typing import Any

import h5py

from pipeline.files.plain_file import LFS_POINTER, NO_LFS_FILE, printable

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
        found = "a MATLAB file of a version before 7.3"
        return found, "HDF5", "write the recording with h5create, h5write and h5writeatt"
    if "signature not found" in said and not first:
        return "an empty file", "an HDF5 recording", "copy it again from the recorder"
    if "signature not found" in said and not first.startswith(bytes(8)):
        found = f"no HDF5 file (it begins with {printable(repr(first[:12]))})"
        return found, "an HDF5 recording", "copy it again, or make a recording of it with `drupe convert`"
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
