"""What libraries log, warn and print is hidden: the terminal shows drupe's own sentences alone."""

import io
import logging
import os
import sys
from typing import Any


def hide_libraries() -> None:
    """For the rest of this process. DRUPE_DEBUG=1 shows what libraries say.

    Native libraries write to the file descriptors 1 and 2. These lead to nowhere, and Python's own streams to
    where the descriptors led before.
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
