"""What libraries log, warn and print goes to drupe's log, and the terminal shows drupe's own sentences alone.

Native libraries write to the file descriptors 1 and 2. These lead to a file of this process, and Python's own
streams to where the descriptors led before. `--verbose` shows the lines on the terminal, `--log` keeps them.
"""

import fcntl
import io
import logging
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pipeline import interruption

FORMAT = "%(name)s: %(message)s"
"""A record of Python's logging: the library, and what it says with its traceback."""
MOST_BYTES = 2**20
"""Of what libraries write between two calls of `hand_over_native` or `LinesOf.new`; the rest is dropped."""
_listeners: list[Callable[[str], None]] = []
_native: list[int] = []
"""The descriptor of the file that native libraries write to; none in a process that did not ask for it."""


def tell_to(listener: Callable[[str], None]) -> None:
    """`listener` alone gets each line of a library from now on."""
    _listeners[:] = [listener]


def pass_on(text: str) -> None:
    """Hands over what a library said; without a listener DRUPE_DEBUG shows it, else it is dropped."""
    if _listeners:
        _listeners[0](text)
    elif os.environ.get("DRUPE_DEBUG"):
        sys.stderr.write(f"{text}\n")


class _Handler(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        pass_on(self.format(record))


@contextmanager
def logs_apart() -> Iterator[None]:
    """Inside the block Python's logs and warnings are handed to the listener; afterwards there is none."""
    handler, root = _Handler(), logging.getLogger()
    handler.setFormatter(logging.Formatter(FORMAT))
    root.addHandler(handler)
    logging.captureWarnings(True)
    try:
        yield
    finally:
        hand_over_native()
        _listeners.clear()
        logging.captureWarnings(False)
        root.removeHandler(handler)


def native_apart() -> None:
    """For the rest of this process, native libraries write to a file that `hand_over_native` reads."""
    sys.stdout.flush()
    sys.stderr.flush()
    _native[:] = [_nameless_file()]
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        terminal = os.dup(descriptor)
        os.dup2(_native[0], descriptor)
        setattr(sys, name, _stream(terminal, like=getattr(sys, name)))
        if descriptor == interruption.STANDARD_ERROR:
            interruption.terminal = terminal


def hand_over_native() -> None:
    """Hands over what native libraries have written since the last call."""
    if not _native:
        return
    said = b""
    with suppress(OSError):
        said = os.pread(_native[0], MOST_BYTES, 0)
        if said:
            os.ftruncate(_native[0], 0)
    for line in said.decode(errors="replace").splitlines():
        if line.strip():
            pass_on(line)


def write_into(path: Path) -> None:
    """In a fruit's process: all that libraries write, log and warn is added to a file for the rest of it."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    os.dup2(descriptor, 1)
    os.dup2(descriptor, 2)
    os.close(descriptor)
    logging.basicConfig(format=FORMAT, stream=sys.stderr)
    logging.captureWarnings(True)


class LinesOf:
    """Lines that another process adds to a file, which is emptied as soon as it is larger than MOST_BYTES."""

    def __init__(self, path: Path) -> None:
        self.path, self._at = path, 0

    def new(self) -> list[str]:
        """The whole lines since the last call, from the last MOST_BYTES; none where there is no file."""
        try:
            with self.path.open("r+b") as file:
                end = file.seek(0, os.SEEK_END)
                self._at = file.seek(max(self._at, end - MOST_BYTES))
                said = file.read(MOST_BYTES)
                whole = said[: said.rfind(b"\n") + 1]
                self._at += len(whole)
                if self._at > MOST_BYTES:
                    file.truncate(0)  # the other process adds to the end, wherever that is
                    self._at = 0
        except FileNotFoundError:
            return []
        return whole.decode(errors="replace").replace("\r\n", "\n").replace("\r", "\n").split("\n")[:-1]


def _nameless_file() -> int:
    """The descriptor of a file in memory, or of one in the folder of temporary files, that is added to."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("drupe-libraries")
    else:
        with tempfile.TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    fcntl.fcntl(descriptor, fcntl.F_SETFL, fcntl.fcntl(descriptor, fcntl.F_GETFL) | os.O_APPEND)
    return descriptor


def _stream(descriptor: int, *, like: Any) -> io.TextIOWrapper:
    return io.TextIOWrapper(
        os.fdopen(descriptor, "wb"),
        encoding=like.encoding,
        errors=like.errors,
        line_buffering=like.line_buffering,
        write_through=like.write_through,
    )
