"""Hides the log, warnings and output of libraries, so that the terminal shows only drupe's messages."""

import io
import logging
import os
import sys
from typing import Any


def hide_libraries() -> None:
    """Hides libraries' output for the rest of this process, unless DRUPE_DEBUG is set.

    Native libraries write to the file descriptors 1 and 2. These now lead to the null device, and Python's
    own streams to the former targets of the descriptors.
    """
    if os.environ.get("DRUPE_DEBUG"):
        return
    logging.getLogger().addHandler(logging.NullHandler())
    logging.captureWarnings(True)
    sys.stdout.flush()
    sys.stderr.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for name, descriptor in (("stdout", 1), ("stderr", 2)):
        terminal = os.dup(descriptor)
        os.dup2(nowhere, descriptor)
        setattr(sys, name, _stream(terminal, like=getattr(sys, name)))
    os.close(nowhere)


def _stream(descriptor: int, *, like: Any) -> io.TextIOWrapper:
    return io.TextIOWrapper(
        os.fdopen(descriptor, "wb"),
        encoding=like.encoding,
        errors=like.errors,
        line_buffering=like.line_buffering,
        write_through=like.write_through,
    )
