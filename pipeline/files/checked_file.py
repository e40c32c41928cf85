"""Files that end in the SHA-256 of their content: a changed bit is noticed before anything is read.

The last 73 bytes are a line feed, the word `sha256`, a space, 64 hexadecimal digits and a line feed. Readers
of zip files (`.npz`) and of HDF5 ignore bytes behind the end, so other programs can still open such a file.
"""

import hashlib
import os
from pathlib import Path

from pipeline.files.plain_file import NotReadable, open_plain
from pipeline.files.whole_file import put

BEGIN = b"\nsha256 "
TRAILER_BYTES = len(BEGIN) + 64 + 1
"""Bytes behind the content: SHA-256 has 64 hexadecimal digits."""
BLOCK_BYTES = 1 << 20
"""Bytes of a file that are in memory at one time while it is checked."""


def put_checked(path: Path, data: bytes) -> None:
    """Writes `data` and its SHA-256 to `path`, whole or not at all. Raises NotWritten."""
    put(path, data + trailer(data))


def trailer(data: bytes) -> bytes:
    """The bytes that follow `data` in a checked file.

    >>> trailer(b"")[:20], len(trailer(b"abc"))
    (b'\\nsha256 e3b0c44298fc', 73)
    """
    return BEGIN + hashlib.sha256(data).hexdigest().encode() + b"\n"


def read_checked(path: Path) -> bytes | None:
    """The content of a checked file; None where it is missing, no plain file, unreadable or damaged."""
    try:
        with open_plain(path) as file:
            held = file.read()
    except (OSError, NotReadable):
        return None
    data = held[:-TRAILER_BYTES]
    return data if held[-TRAILER_BYTES:] == trailer(data) else None


def is_whole(path: Path) -> bool:
    """Whether `path` is a checked file without damage. Reads it in blocks, whatever its size."""
    try:
        with open_plain(path) as file:
            left = os.fstat(file.fileno()).st_size - TRAILER_BYTES
            digest = hashlib.sha256()
            while left > 0 and (block := file.read(min(left, BLOCK_BYTES))):
                digest.update(block)
                left -= len(block)
            end = BEGIN + digest.hexdigest().encode() + b"\n"
            return left == 0 and file.read() == end
    except (OSError, NotReadable):
        return False
